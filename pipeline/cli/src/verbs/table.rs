//! `table`: prints the latest table, checks it against a committed one, or writes such a file.

use std::path::Path;

use anyhow::Context;
use engine::{Failure, FailureKind, exit};

use crate::args::{TableArgs, TableFormat};
use crate::checked::{CheckedTable, Findings};
use crate::error::CliError;
use crate::measured;
use crate::output::{count, names, print};
use crate::partial::PartialReport;
use crate::session::Session;

pub(crate) fn table(store: &Path, args: &TableArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.recipe)?;
    match (&args.check, &args.write_check) {
        (Some(file), _) => check(&session, file),
        (None, Some(file)) => write_check(&session, file),
        (None, None) => print_tables(store, &session, args),
    }
}

fn print_tables(store: &Path, session: &Session, args: &TableArgs) -> Result<u8, CliError> {
    let file = match args.format {
        TableFormat::Md => "report.md",
        TableFormat::Latex => "report.tex",
        TableFormat::Csv => "report.csv",
        TableFormat::Json => "report.json",
    };
    let reports = session.required_reports()?;
    if matches!(args.format, TableFormat::Csv | TableFormat::Json) {
        let names: Vec<&str> = reports.iter().map(|&index| session.plan.nodes[index].name.as_str()).collect();
        require_one(&names, file, &args.recipe.command("show", store))?;
    }
    for index in reports {
        let text = match args.partial {
            true => {
                let report = PartialReport::make(session, index)?;
                let path = report.dir().join(file);
                std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?
            }
            false => session.store.read_file(&session.record(index)?.content, file)?,
        };
        print(&String::from_utf8(text).with_context(|| format!("{file} is not UTF-8"))?)?;
    }
    Ok(exit::OK)
}

/// Refuses several reports in a format of which two documents in a row are no document. `show` is the command that shows
/// the results of the recipe.
fn require_one(reports: &[&str], file: &str, show: &str) -> Result<(), CliError> {
    let [first, _, ..] = reports else { return Ok(()) };
    let (number, listed) = (count(reports.len(), "report"), names(reports.iter().copied()));
    let message = format!("the recipe has {number} ({listed}), but one {file} holds one report");
    let hint = format!("`{show} {first} --path` prints the folder of a report, which contains its {file}");
    Err(CliError::Input(Failure::new(FailureKind::BadInput, message).hint(hint).into()))
}

fn write_check(session: &Session, file: &Path) -> Result<u8, CliError> {
    let existing = file.exists().then(|| CheckedTable::read(file)).transpose()?;
    let runs = measured::current(session)?;
    let text = CheckedTable::of(&session.plan.recipe, &runs, existing.as_ref()).to_text()?;
    std::fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))?;
    Ok(exit::OK)
}

fn check(session: &Session, file: &Path) -> Result<u8, CliError> {
    let expected = CheckedTable::read(file)?;
    let Findings { deviations, compared, nearest } = expected.check(&session.plan.recipe, &measured::current(session)?);
    let mut text: String = deviations.iter().map(|line| format!("DEVIATES: {line}\n")).collect();
    match &deviations[..] {
        [] => text += &format!("{} within tolerance: {}\n", count(compared, "value"), file.display()),
        some => text += &format!("{} from {}\n", count(some.len(), "deviation"), file.display()),
    }
    text += &nearest
        .map(|(share, line)| format!("closest to its tolerance ({:.0} %): {line}\n", 100.0 * share))
        .unwrap_or_default();
    print(&text)?;
    Ok(if deviations.is_empty() { exit::OK } else { exit::DIFFERS })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_reports_are_no_document() {
        assert!(require_one(&["report"], "report.json", "pipeline show r.toml").is_ok());
        let refused = require_one(&["report", "report-val"], "report.json", "pipeline show r.toml").unwrap_err();
        insta::assert_snapshot!(refused.to_string(), @r"
        error: the recipe has 2 reports (report, report-val), but one report.json holds one report
        hint: `pipeline show r.toml report --path` prints the folder of a report, which contains its report.json
        ");
    }
}
