//! Every run as a line of CSV, unrounded.

use metric_evaluation::Score;

use crate::report::failure_mark;
use crate::{Column, Report, Run};

/// One line per run: where it belongs, every figure unrounded (empty where there is none), what failed, and its keys.
pub fn csv(report: &Report) -> anyhow::Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let keys = ["model", "renders", "metrics"];
    let lead = ["protocol", "method", "scene", "seed"].into_iter().map(String::from);
    let figures = Column::all().map(|column| column.key().to_owned());
    let trail = ["failure".to_owned()].into_iter().chain(keys.map(|port| format!("{port}_key")));
    writer.write_record(lead.chain(figures).chain(trail))?;
    for run in &report.runs {
        let protocol = group_name(report, run);
        let lead = [protocol, run.row.clone(), run.scene.clone(), run.seed.clone()].into_iter();
        let figures = Column::all().map(|column| {
            let value = run.figures.get(&column).and_then(Score::value).filter(|value| value.is_finite());
            value.map(|value| value.to_string()).unwrap_or_default()
        });
        let failure = run.failure.as_ref().map(|failure| failure_mark(failure.kind).to_owned()).unwrap_or_default();
        let keys = keys.map(|port| run.action_keys.get(port).cloned().unwrap_or_default());
        writer.write_record(lead.chain(figures).chain([failure]).chain(keys))?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// The group that a run was measured in; empty where it was not measured.
fn group_name(report: &Report, run: &Run) -> String {
    let is_in = |group: &&crate::Group| {
        run.protocol.as_ref() == Some(&group.protocol) && run.judged_by.as_ref() == Some(&group.judged_by)
    };
    report.groups.iter().find(is_in).map(|group| group.name.clone()).unwrap_or_default()
}
