//! The machines on which times were measured.

use std::collections::BTreeMap;

use super::content::Content;
use crate::collect::Machine;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};

/// One table with a column per kind of work and machine.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let mut counts: BTreeMap<(&String, String), (&Machine, usize)> = BTreeMap::new();
    for (work, machine) in content.report.runs.iter().flat_map(|run| &run.machines) {
        let key = (work, format!("{} {:?} {:?}", machine.line(), machine.sources, machine.system));
        counts.entry(key).or_insert((machine, 0)).1 += 1;
    }
    let columns: Vec<[(&str, String); 11]> = counts.values().map(|(machine, n_runs)| card(machine, *n_runs)).collect();
    let Some(first) = columns.first() else { return Vec::new() };
    let header: Vec<String> =
        [String::new()].into_iter().chain(counts.keys().map(|(work, _)| (*work).clone())).collect();
    let n_columns = header.len();
    let mut table = Table::new("Machines on which times were measured", header).with_text_columns(n_columns);
    for (at, (name, _)) in first.iter().enumerate() {
        let values = columns.iter().map(|column| Text::plain(&column[at].1));
        table.rows.push([Text::plain(*name)].into_iter().chain(values).collect());
    }
    table.remarks.push(
        "FPS raster: the rasteriser alone; FPS model: with the motion model; FPS delivered: with conversion to 8 bits \
         and encoding; all are medians. Training seconds exclude evaluation. Sources: digest of the program's source \
         code."
            .into(),
    );
    vec![Block::Table(table)]
}

fn card(machine: &Machine, n_runs: usize) -> [(&'static str, String); 11] {
    let text = |value: &Option<String>| value.clone().unwrap_or_else(|| NONE.into());
    let whole = |value: Option<u64>| value.map_or(NONE.into(), |value| value.to_string());
    [
        ("runs", n_runs.to_string()),
        ("device", machine.device.clone()),
        ("threads used", whole(machine.threads)),
        ("processor", text(&machine.cpu)),
        ("cores", whole(machine.cores)),
        ("hardware threads", whole(machine.hardware_threads)),
        ("memory", machine.memory_bytes.map_or(NONE.into(), |bytes| format!("{} GB", number(bytes / 1e9, 1)))),
        ("system", text(&machine.system)),
        ("program", text(&machine.program)),
        ("sources", text(&machine.sources)),
        ("compiler", text(&machine.built_with)),
    ]
}
