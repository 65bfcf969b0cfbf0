//! `compare`: compares two results, paired by row, scene and seed.

use std::collections::BTreeMap;
use std::path::Path;

use engine::exit;
use metric_evaluation::Metric;
use serde_json::json;
use table_generation::{Column, number, signed};

use crate::args::CompareArgs;
use crate::comparison::{self, ComparedRow, Comparison, Paired};
use crate::error::CliError;
use crate::measured;
use crate::output::{count, names, print, print_json};

/// The metrics to print if none is named.
const DEFAULT_METRICS: [Column; 3] = [Column::PSNR, Column::Metric(Metric::Ssim), Column::TrainingSecs];

pub(crate) fn compare(store: &Path, args: &CompareArgs) -> Result<u8, CliError> {
    let [a, b] = [&args.a, &args.b].map(|named| measured::open(store, named, &args.with));
    let (a, b) = (a?, b?);
    comparison::check_rows(&a, &b, &args.rows)?;
    let comparison = comparison::compare(&a, &b, &args.rows).map_err(|differ| CliError::Input(differ.into()))?;
    if comparison.protocols.is_empty() {
        let [of_a, of_b] = [&a, &b].map(|runs| names(comparison::row_names(runs).iter().map(String::as_str)));
        let hint = format!("pair rows by name, e.g. --rows static3dgs=mcgs; A has {of_a}, and B has {of_b}");
        return Err(CliError::nothing("no measured run of A has a partner in B: same row, scene and seed", hint));
    }
    let violations = comparison.violations(&args.fail_if_worse);
    let wanted = if args.metrics.is_empty() { &DEFAULT_METRICS[..] } else { &args.metrics[..] };
    if args.json {
        print_json(&json!({ "comparison": comparison, "violations": violations }))?;
    } else {
        print(&text(args, &comparison, wanted, &violations))?;
    }
    match (&violations[..], comparison.has_values()) {
        ([], true) => Ok(exit::OK),
        ([], false) => {
            let hint = "`pipeline status RECIPE` lists failed and missing jobs";
            Err(CliError::nothing("no pair of runs has values on both sides: nothing was compared", hint))
        }
        _ => Ok(exit::DIFFERS),
    }
}

fn text(args: &CompareArgs, comparison: &Comparison, wanted: &[Column], violations: &[String]) -> String {
    let mut text = format!("A: {}\nB: {}\n", args.a.display(), args.b.display());
    for under in &comparison.protocols {
        text += &format!("\n{} · {}\n\n", under.protocol, under.judged_by);
        text += "| row | metric | pairs | A | B | B − A | 95 % interval | over | B better | B worse |\n";
        text += "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n";
        for row in under.rows.iter().chain(&under.all) {
            for column in wanted {
                text += &row.metrics.get(column).map(|paired| line(row, *column, paired)).unwrap_or_default();
            }
        }
    }
    text += "\n95 % interval: Student, over the scenes, or over the seeds of a single scene; in tables, always over seeds. With \
             one seed, it lacks the spread over seeds.\n";
    let mut notes: Vec<String> = comparison.without_times.iter().cloned().collect();
    for (side, alone) in [("A", &comparison.only_in_a), ("B", &comparison.only_in_b)] {
        if let Some(first) = alone.first() {
            notes.push(format!("{} only in {side}, e.g. {first}", count(alone.len(), "run")));
        }
    }
    let absent = absent(comparison, wanted);
    if !absent.is_empty() {
        notes.push(format!("no pair of runs has {} in A and B", absent.join(" or ")));
    }
    notes.extend(left_out(comparison, wanted));
    notes.extend(gained(comparison, wanted));
    notes.iter().for_each(|note| text += &format!("note: {note}\n"));
    for (run, metrics) in lost(comparison, wanted) {
        text += &format!("MISSING in B: {} of {run}\n", metrics.join(", "));
    }
    violations.iter().for_each(|violation| text += &format!("WORSE: {violation}\n"));
    text
}

/// The metrics to print that no row has, and whose absence has no other note.
fn absent(comparison: &Comparison, wanted: &[Column]) -> Vec<&'static str> {
    let rows = || comparison.protocols.iter().flat_map(|under| &under.rows);
    let is_printed =
        |column: &Column| rows().any(|row| row.metrics.contains_key(column) || row.lost.contains_key(column));
    let has_note = |column: &Column| column.is_timing() && comparison.without_times.is_some();
    wanted.iter().filter(|column| !is_printed(column) && !has_note(column)).map(|column| column.key()).collect()
}

/// One note for each printed metric of a row from which pairs are left out.
fn left_out<'a>(comparison: &'a Comparison, wanted: &'a [Column]) -> impl Iterator<Item = String> + 'a {
    let rows = comparison.protocols.iter().flat_map(|under| &under.rows);
    let of_row = move |row: &'a ComparedRow| {
        wanted.iter().filter_map(move |column| {
            let runs = row.left_out.get(column)?;
            let what = count(runs.len(), "pair");
            let first = runs.first()?;
            Some(format!("{}: {what} left out, as the seed lacks a scene, e.g. {first}", column.key()))
        })
    };
    rows.flat_map(of_row)
}

/// One note for each printed metric of a row that only B has for some runs.
fn gained<'a>(comparison: &'a Comparison, wanted: &'a [Column]) -> impl Iterator<Item = String> + 'a {
    let rows = comparison.protocols.iter().flat_map(|under| &under.rows);
    let of_row = move |row: &'a ComparedRow| {
        wanted.iter().filter_map(move |column| {
            let runs = row.gained.get(column)?;
            let (what, first) = (count(runs.len(), "value"), runs.first()?);
            Some(format!("{}: {what} only in B, which no mean contains; A lacks e.g. {first}", column.key()))
        })
    };
    rows.flat_map(of_row)
}

/// The printed metrics that B lacks: run with reason → metrics.
fn lost<'a>(comparison: &'a Comparison, wanted: &[Column]) -> BTreeMap<&'a str, Vec<&'static str>> {
    let mut lost: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for row in comparison.protocols.iter().flat_map(|under| &under.rows) {
        for column in wanted {
            let runs = row.lost.get(column).into_iter().flatten();
            runs.for_each(|run| lost.entry(run).or_default().push(column.key()));
        }
    }
    lost
}

fn line(row: &ComparedRow, column: Column, paired: &Paired) -> String {
    let Paired { pairs, mean_a, mean_b, difference, interval, better, worse, .. } = paired;
    let decimals = column.decimals();
    let interval = match interval {
        Some([low, high]) => format!("{} … {}", signed(*low, decimals), signed(*high, decimals)),
        None => "–".into(),
    };
    format!(
        "| {} | {} | {pairs} | {} | {} | {} | {interval} | {} | {better} | {worse} |\n",
        row.name(),
        column.heading(),
        number(*mean_a, decimals),
        number(*mean_b, decimals),
        signed(*difference, decimals),
        paired.scope(),
    )
}

#[cfg(test)]
mod tests {
    use metric_evaluation::Score;
    use table_generation::Run;

    use super::*;

    fn run(scene_name: &str, psnr: Option<f64>) -> Run {
        let figures = psnr.map(|psnr| (Column::PSNR, Score::Value(psnr))).into_iter().collect();
        let [dataset, split, resize, background, time] = ["d", "s", "none", "white", "t"].map(str::to_owned);
        let protocol = Some(scene::Protocol { dataset, split, width: 8, height: 8, resize, background, time });
        let measured = Run { row: "m".into(), scene: scene_name.into(), seed: "0".into(), ..Run::default() };
        Run { figures, protocol, judged_by: Some("test".into()), ..measured }
    }

    #[test]
    fn values_that_only_b_has_are_noted() {
        let (a, b) = ([run("x", Some(20.0)), run("y", None)], [run("x", Some(20.0)), run("y", Some(30.0))]);
        let notes = |a: &[Run], b: &[Run]| -> Vec<String> {
            let comparison = comparison::compare(a, b, &[]).unwrap();
            gained(&comparison, &DEFAULT_METRICS).collect()
        };
        let note = "psnr: 1 value only in B, which no mean contains; A lacks e.g. m on y, seed 0: not measured";
        assert_eq!(notes(&a, &b), [note]);
        assert_eq!(notes(&b, &b), Vec::<String>::new());
    }
}
