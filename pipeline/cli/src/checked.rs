//! A committed table: the values that a recipe once produced, and how far a reproduction may deviate.
//!
//! A training gives equal bytes for any number of threads, but not on every processor: other vector widths sum matrix
//! products in another order. Therefore a table is reproduced within tolerances, which the file states.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;

use engine::{Failure, FailureKind};
use metric_evaluation::Metric;
use serde::{Deserialize, Serialize};
use table_generation::{Column, Run};

use crate::amount::Amount;
use crate::error::CliError;
use crate::measured::{name, value};

/// Tolerances of a new file; rewriting a file keeps those that it has. They are smaller than any relevant difference,
/// and larger than the effect of rounding on a short training.
const NEW_TOLERANCES: [(Column, Amount); 3] = [
    (Column::PSNR, Amount::Absolute(0.25)),
    (Column::Metric(Metric::Ssim), Amount::Absolute(0.01)),
    (Column::Gaussians, Amount::Percent(5.0)),
];

/// Tolerance of loss shares in a new file. It is wide because rounding alone changes the share of a loss that few
/// pixels or rare large values dominate.
const NEW_LOSS_TOLERANCE: Amount = Amount::Percent(75.0);

/// The content of the file. Only metrics that have a tolerance are stored and compared.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CheckedTable {
    /// The recipe's name.
    recipe: String,
    /// Largest deviation by metric: in its unit, or as a share of the stored value (e.g. `"5%"`).
    tolerances: BTreeMap<Column, Amount>,
    /// Largest deviation of each loss's share of the total loss. A loss that appears or disappears always deviates.
    loss_share_tolerance: Amount,
    /// Runs by protocol.
    #[serde(default, rename = "table")]
    tables: Vec<OneProtocol>,
    /// Runs without values.
    #[serde(default)]
    failed: Vec<Failed>,
}

/// The runs under one protocol.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct OneProtocol {
    protocol: String,
    judged_by: String,
    #[serde(rename = "run")]
    runs: Vec<CheckedRun>,
}

#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
struct CheckedRun {
    row: String,
    scene: String,
    seed: String,
    /// Values by metric.
    #[serde(flatten)]
    values: BTreeMap<Column, Expected>,
    /// Each loss's share of the sum of all weighted losses.
    #[serde(default)]
    loss_shares: BTreeMap<String, f64>,
}

#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(untagged, expecting = "expected a number, or text that says why there is none")]
enum Expected {
    Value(f64),
    /// The reason why the metric is undefined.
    Undefined(String),
}

#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Failed {
    row: String,
    scene: String,
    seed: String,
    kind: FailureKind,
}

/// The result of a check.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Findings {
    /// One line for each value, run or protocol that deviates.
    pub(crate) deviations: Vec<String>,
    /// Number of values that were compared.
    pub(crate) compared: usize,
    /// The value that comes closest to its tolerance, with the share of the tolerance that it uses.
    pub(crate) nearest: Option<(f64, String)>,
}

impl CheckedTable {
    /// The table of a recipe's runs, with the tolerances of the existing file if there is one.
    pub(crate) fn of(recipe: &str, runs: &[Run], existing: Option<&Self>) -> Self {
        let tolerances = existing.map_or_else(|| NEW_TOLERANCES.into(), |file| file.tolerances.clone());
        let loss_share_tolerance = existing.map_or(NEW_LOSS_TOLERANCE, |file| file.loss_share_tolerance);
        let mut tables: Vec<OneProtocol> = Vec::new();
        let mut failed = Vec::new();
        for run in runs {
            let Some([protocol, judged_by]) = run.protocol_lines() else {
                failed.extend(Failed::of(run));
                continue;
            };
            let known = tables.iter().position(|table| table.protocol == protocol && table.judged_by == judged_by);
            let at = known.unwrap_or_else(|| {
                tables.push(OneProtocol { protocol, judged_by, runs: Vec::new() });
                tables.len() - 1
            });
            tables[at].runs.push(CheckedRun::of(run, &tolerances));
        }
        Self { recipe: recipe.into(), tolerances, loss_share_tolerance, tables, failed }
    }

    /// Reads the file; a file that cannot be read or parsed is bad input. Only regular files are read: a device or a pipe
    /// may have no end.
    pub(crate) fn read(path: &Path) -> Result<Self, CliError> {
        let bad = |message: String| {
            CliError::of_input(Failure::new(FailureKind::BadInput, message).at(path).into()) //
        };
        if path.exists() && !path.is_file() {
            return Err(bad("not a regular file, so it cannot hold a table to check against".into()));
        }
        let hint = "write one with `pipeline table RECIPE --write-check FILE`";
        let text =
            std::fs::read_to_string(path).map_err(|error| bad(format!("cannot read the file ({error}); {hint}")))?;
        toml::from_str(&text).map_err(|error| {
            let place = error.span().map(|span| place(&text, span)).unwrap_or_default();
            bad(format!("not a table to check against: {place}{}; {hint}", error.message()))
        })
    }

    /// The file's text.
    pub(crate) fn to_text(&self) -> Result<String, CliError> {
        let body = toml::to_string_pretty(self).map_err(anyhow::Error::from)?;
        Ok(format!(
            "# Values that the recipe produced when this file was written, and how far a reproduction may deviate.\n\
             # Check: pipeline table RECIPE --check FILE. Rewrite: --write-check FILE (tolerances are kept).\n\n{body}"
        ))
    }

    /// Compares runs with the file.
    pub(crate) fn check(&self, recipe: &str, runs: &[Run]) -> Findings {
        let mut findings = Findings::default();
        if recipe != self.recipe {
            findings.deviations.push(format!("the file belongs to the recipe {}, not {recipe}", self.recipe));
        }
        for table in &self.tables {
            for want in &table.runs {
                self.check_run(table, want, runs, &mut findings);
            }
        }
        let failures = self.failed.iter().filter_map(|want| want.deviation(runs));
        findings.deviations.extend(failures);
        let measured = self.tables.iter().flat_map(|table| &table.runs).map(|run| [&run.row, &run.scene, &run.seed]);
        let failed = self.failed.iter().map(|run| [&run.row, &run.scene, &run.seed]);
        let expected: BTreeSet<[&String; 3]> = measured.chain(failed).collect();
        let extra = runs.iter().filter(|run| !expected.contains(&[&run.row, &run.scene, &run.seed]));
        findings.deviations.extend(extra.map(|run| format!("{} is not in the file", name(run))));
        findings
    }

    fn check_run(&self, table: &OneProtocol, want: &CheckedRun, runs: &[Run], findings: &mut Findings) {
        let CheckedRun { row, scene, seed, .. } = want;
        let Some(run) = find(runs, [row, scene, seed]) else {
            findings.deviations.push(format!("{row} on {scene}, seed {seed} is missing"));
            return;
        };
        match run.protocol_lines() {
            Some([protocol, judged_by]) if protocol == table.protocol && judged_by == table.judged_by => {
                want.check_values(run, &self.tolerances, findings);
                want.check_losses(run, self.loss_share_tolerance, findings);
            }
            Some([protocol, judged_by]) => findings.deviations.push(format!(
                "{} has another protocol: {protocol} ({judged_by}), expected {} ({})",
                name(run),
                table.protocol,
                table.judged_by
            )),
            None => {
                let reason = run.failure.as_ref().map_or("no reason is recorded", |failure| &failure.message);
                findings.deviations.push(format!("{} has no values: {reason}", name(run)));
            }
        }
    }
}

/// "line N (`TEXT`): " for a place in a text; errors about the whole text have an empty place at its start.
fn place(text: &str, at: Range<usize>) -> String {
    if at.end == 0 {
        return String::new();
    }
    let before = text.get(..at.start).unwrap_or_default();
    let line = text[before.rfind('\n').map_or(0, |end| end + 1)..].lines().next().unwrap_or_default();
    format!("line {} (`{}`): ", before.matches('\n').count() + 1, line.trim())
}

fn find<'a>(runs: &'a [Run], key: [&String; 3]) -> Option<&'a Run> {
    runs.iter().find(|run| key == [&run.row, &run.scene, &run.seed])
}

impl Failed {
    fn of(run: &Run) -> Option<Self> {
        let kind = run.failure.as_ref()?.kind;
        Some(Self { row: run.row.clone(), scene: run.scene.clone(), seed: run.seed.clone(), kind })
    }

    /// A line if the run did not fail in the expected way.
    fn deviation(&self, runs: &[Run]) -> Option<String> {
        let Self { row, scene, seed, kind } = self;
        let found = find(runs, [row, scene, seed]).and_then(Self::of);
        let line = || format!("{row} on {scene}, seed {seed} was expected to fail ({kind:?}) and did not");
        (found.as_ref() != Some(self)).then(line)
    }
}

impl CheckedRun {
    fn of(run: &Run, tolerances: &BTreeMap<Column, Amount>) -> Self {
        let expected = |&column: &Column| {
            let found = match value(run, column) {
                Ok(value) => Expected::Value(rounded(value, column)),
                Err(reason) => Expected::Undefined(reason),
            };
            (column, found)
        };
        let values = tolerances.keys().map(expected).collect();
        let (row, scene, seed) = (run.row.clone(), run.scene.clone(), run.seed.clone());
        Self { row, scene, seed, values, loss_shares: loss_shares(run) }
    }

    fn check_values(&self, run: &Run, tolerances: &BTreeMap<Column, Amount>, findings: &mut Findings) {
        for (&column, tolerance) in tolerances {
            let key = column.key();
            match (self.values.get(&column), value(run, column)) {
                (Some(Expected::Value(want)), Ok(found)) => {
                    findings.compare(&format!("{}: {key}", name(run)), *want, found, *tolerance);
                }
                (Some(Expected::Undefined(_)), Err(_)) => (),
                (Some(Expected::Value(want)), Err(reason)) => {
                    findings.deviations.push(format!("{}: {key} is undefined ({reason}), expected {want}", name(run)));
                }
                (Some(Expected::Undefined(reason)), Ok(found)) => {
                    findings.deviations.push(format!("{}: {key} is {found}, expected none ({reason})", name(run)));
                }
                (None, _) => findings.deviations.push(format!("{}: the file has no {key}", name(run))),
            }
        }
    }

    /// Compares the shares of losses by name. A loss with weight 0 counts as absent.
    fn check_losses(&self, run: &Run, tolerance: Amount, findings: &mut Findings) {
        let found = loss_shares(run);
        for (loss, want) in &self.loss_shares {
            match found.get(loss) {
                Some(share) => {
                    findings.compare(&format!("{}: share of loss {loss}", name(run)), *want, *share, tolerance);
                }
                None => findings.deviations.push(format!("{}: loss {loss} is missing", name(run))),
            }
        }
        let new = found.keys().filter(|loss| !self.loss_shares.contains_key(*loss));
        findings.deviations.extend(new.map(|loss| format!("{}: loss {loss} is not in the file", name(run))));
    }
}

impl Findings {
    fn compare(&mut self, what: &str, want: f64, found: f64, tolerance: Amount) {
        self.compared += 1;
        let allowed = tolerance.of(want);
        let off = (found - want).abs();
        let line = format!("{what} is {found:.6}, expected {want} ± {tolerance}: off by {off:.6}");
        // Written so that NaN deviates.
        if !(off <= allowed) {
            self.deviations.push(line);
        } else if allowed > 0.0 && self.nearest.as_ref().is_none_or(|(share, _)| off / allowed > *share) {
            self.nearest = Some((off / allowed, line));
        }
    }
}

/// The shares of all losses with a positive share, rounded to four digits.
fn loss_shares(run: &Run) -> BTreeMap<String, f64> {
    let shares = run.costs.loss_shares.iter().filter(|(_, share)| share.value_share > 0.0);
    let rounded = |share: f64| format!("{share:.3e}").parse().unwrap_or(share);
    shares.map(|(loss, share)| (loss.clone(), rounded(share.value_share))).collect()
}

/// Rounds to two decimals more than tables show: finer than any sensible tolerance, and readable in a diff.
fn rounded(value: f64, column: Column) -> f64 {
    let unit = 10_f64.powi(column.decimals() as i32 + 2);
    (value * unit).round() / unit
}

#[cfg(test)]
mod tests;
