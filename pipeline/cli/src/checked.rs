//! A committed table: the values that a recipe once came to, and how far they may be off elsewhere.
//!
//! A training gives equal bytes for any number of threads, but not on any processor: other vector widths sum matrix
//! products in another order. So a table is reproduced within tolerances, and the file says which.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use engine::{Failure, FailureKind};
use metric_evaluation::Metric;
use serde::{Deserialize, Serialize};
use table_generation::{Column, Run};

use crate::amount::Amount;
use crate::error::CliError;
use crate::measured::{figure, name};

/// What a new file allows; a file that is written again keeps its own. Shorter than any difference that a reader of a
/// table would call one, longer than what rounding of sums does to a short training.
const NEW_TOLERANCES: [(Column, Amount); 3] = [
    (Column::PSNR, Amount::Absolute(0.25)),
    (Column::Metric(Metric::Ssim), Amount::Absolute(0.01)),
    (Column::Gaussians, Amount::Percent(5.0)),
];

/// Shares of losses that are driven by few pixels or by rare large values change much from rounding alone.
const NEW_LOSS_TOLERANCE: Amount = Amount::Percent(75.0);

/// The content of the file. Only metrics that have a tolerance are kept and compared.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedTable {
    /// The recipe's name.
    recipe: String,
    /// Largest difference by metric: in its unit, or as `"5%"` of the value here.
    tolerances: BTreeMap<Column, Amount>,
    /// The same for each loss's share of the sum of all; a loss that comes or goes always deviates.
    loss_share_tolerance: Amount,
    /// Runs by protocol.
    #[serde(default, rename = "table")]
    tables: Vec<OneProtocol>,
    /// Runs that have no numbers.
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
    /// A metric that is undefined says why.
    #[serde(flatten)]
    figures: BTreeMap<Column, Figure>,
    /// By loss: its share of the sum of all weighted values.
    #[serde(default)]
    loss_shares: BTreeMap<String, f64>,
}

#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(untagged)]
enum Figure {
    Value(f64),
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

/// What a check found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    /// One line for each number, run or protocol that is not as expected.
    pub deviations: Vec<String>,
    /// Numbers that were compared.
    pub compared: usize,
    /// The number that comes nearest to its tolerance, with its share of it.
    pub nearest: Option<(f64, String)>,
}

impl CheckedTable {
    /// The runs of a recipe, with the tolerances of `earlier` if there is such a file.
    pub fn of(recipe: &str, runs: &[Run], earlier: Option<&Self>) -> Self {
        let tolerances = earlier.map_or_else(|| NEW_TOLERANCES.into(), |file| file.tolerances.clone());
        let loss_share_tolerance = earlier.map_or(NEW_LOSS_TOLERANCE, |file| file.loss_share_tolerance);
        let mut tables: Vec<OneProtocol> = Vec::new();
        let mut failed = Vec::new();
        for run in runs {
            let Some((protocol, judged_by)) = lines(run) else {
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

    /// Reads the file.
    pub fn read(path: &Path) -> Result<Self, CliError> {
        let bad = |message: String| {
            CliError::of_input(Failure::new(FailureKind::BadInput, message).at(path).into()) //
        };
        let text = std::fs::read_to_string(path).map_err(|error| bad(format!("cannot read the file ({error})")))?;
        let hint = "write it with `pipeline table RECIPE --write-check FILE`";
        toml::from_str(&text).map_err(|error| bad(format!("not a table to check against: {}; {hint}", error.message())))
    }

    /// The file's text.
    pub fn to_text(&self) -> Result<String, CliError> {
        let body = toml::to_string_pretty(self).map_err(anyhow::Error::from)?;
        Ok(format!(
            "# What this recipe came to when the file was written, and how far the numbers may be off.\n\
             # Compare: pipeline table RECIPE --check FILE; write again: --write-check FILE (tolerances stay).\n\n{body}"
        ))
    }

    /// Compares runs with the file.
    pub fn check(&self, recipe: &str, runs: &[Run]) -> Findings {
        let mut findings = Findings::default();
        if recipe != self.recipe {
            findings.deviations.push(format!("the file is about the recipe {}, not {recipe}", self.recipe));
        }
        let mut expected = BTreeSet::new();
        for table in &self.tables {
            for want in &table.runs {
                let key = [&want.row, &want.scene, &want.seed];
                expected.insert(key);
                let Some(run) = runs.iter().find(|run| key == [&run.row, &run.scene, &run.seed]) else {
                    findings.deviations.push(format!("{} on {}, seed {} is missing", key[0], key[1], key[2]));
                    continue;
                };
                match lines(run) {
                    Some((protocol, judged_by)) if protocol == table.protocol && judged_by == table.judged_by => {
                        want.check(run, &self.tolerances, &mut findings);
                        want.check_losses(run, self.loss_share_tolerance, &mut findings);
                    }
                    Some((protocol, judged_by)) => findings.deviations.push(format!(
                        "{} has another protocol: {protocol} ({judged_by}), expected {} ({})",
                        name(run),
                        table.protocol,
                        table.judged_by
                    )),
                    None => {
                        let why = run.failure.as_ref().map_or("no reason is known", |failure| &failure.message);
                        findings.deviations.push(format!("{} has no numbers: {why}", name(run)));
                    }
                }
            }
        }
        for want in &self.failed {
            expected.insert([&want.row, &want.scene, &want.seed]);
            let found =
                runs.iter().find(|run| [&want.row, &want.scene, &want.seed] == [&run.row, &run.scene, &run.seed]);
            if found.and_then(Failed::of).as_ref() != Some(want) {
                let Failed { row, scene, seed, kind } = want;
                let line = format!("{row} on {scene}, seed {seed} was expected to fail ({kind:?}) and did not so");
                findings.deviations.push(line);
            }
        }
        let extra = runs.iter().filter(|run| !expected.contains(&[&run.row, &run.scene, &run.seed]));
        findings.deviations.extend(extra.map(|run| format!("{} is not in the file", name(run))));
        findings
    }
}

/// The protocol and the judge of a run that has numbers.
fn lines(run: &Run) -> Option<(String, String)> {
    Some((run.protocol.as_ref()?.line(), run.judged_by.clone()?))
}

impl Failed {
    fn of(run: &Run) -> Option<Self> {
        let kind = run.failure.as_ref()?.kind;
        Some(Self { row: run.row.clone(), scene: run.scene.clone(), seed: run.seed.clone(), kind })
    }
}

impl CheckedRun {
    fn of(run: &Run, tolerances: &BTreeMap<Column, Amount>) -> Self {
        let figure_of = |&column: &Column| {
            let found = match figure(run, column) {
                Ok(value) => Figure::Value(rounded(value, column)),
                Err(reason) => Figure::Undefined(reason),
            };
            (column, found)
        };
        let figures = tolerances.keys().map(figure_of).collect();
        let (row, scene, seed) = (run.row.clone(), run.scene.clone(), run.seed.clone());
        Self { row, scene, seed, figures, loss_shares: loss_shares(run) }
    }

    /// Losses by name: a loss without weight is none.
    fn check_losses(&self, run: &Run, tolerance: Amount, findings: &mut Findings) {
        let found = loss_shares(run);
        for (loss, want) in &self.loss_shares {
            match found.get(loss) {
                Some(share) => {
                    findings.compared += 1;
                    findings.compare(&format!("{}: share of loss {loss}", name(run)), *want, *share, tolerance);
                }
                None => findings.deviations.push(format!("{}: loss {loss} is gone", name(run))),
            }
        }
        let new = found.keys().filter(|loss| !self.loss_shares.contains_key(*loss));
        findings.deviations.extend(new.map(|loss| format!("{}: loss {loss} is not in the file", name(run))));
    }

    fn check(&self, run: &Run, tolerances: &BTreeMap<Column, Amount>, findings: &mut Findings) {
        for (&column, tolerance) in tolerances {
            let key = column.key();
            match (self.figures.get(&column), figure(run, column)) {
                (Some(Figure::Value(want)), Ok(found)) => {
                    findings.compared += 1;
                    findings.compare(&format!("{}: {key}", name(run)), *want, found, *tolerance);
                }
                (Some(Figure::Undefined(_)), Err(_)) => (),
                (Some(Figure::Value(want)), Err(reason)) => {
                    findings.deviations.push(format!("{}: {key} is undefined ({reason}), expected {want}", name(run)));
                }
                (Some(Figure::Undefined(reason)), Ok(found)) => {
                    findings.deviations.push(format!("{}: {key} is {found}, expected none ({reason})", name(run)));
                }
                (None, _) => findings.deviations.push(format!("{}: the file has no {key}", name(run))),
            }
        }
    }
}

impl Findings {
    fn compare(&mut self, what: &str, want: f64, found: f64, tolerance: Amount) {
        let allowed = tolerance.of(want);
        let off = (found - want).abs();
        let line = format!("{what} is {found:.6}, expected {want} ± {tolerance}: off by {off:.6}");
        // Written so that a value that is no number deviates.
        if !(off <= allowed) {
            self.deviations.push(line);
        } else if allowed > 0.0 && self.nearest.as_ref().is_none_or(|(share, _)| off / allowed > *share) {
            self.nearest = Some((off / allowed, line));
        }
    }
}

/// The losses that weighed anything, with four digits.
fn loss_shares(run: &Run) -> BTreeMap<String, f64> {
    let shares = run.costs.loss_shares.iter().filter(|(_, share)| share.value_share > 0.0);
    let rounded = |share: f64| format!("{share:.3e}").parse().unwrap_or(share);
    shares.map(|(loss, share)| (loss.clone(), rounded(share.value_share))).collect()
}

/// Two decimals more than tables show: finer than any sensible tolerance, and readable in a diff.
fn rounded(value: f64, column: Column) -> f64 {
    let unit = 10_f64.powi(column.decimals() as i32 + 2);
    (value * unit).round() / unit
}

#[cfg(test)]
mod tests {
    use metric_evaluation::Score;
    use table_generation::RunFailure;

    use super::*;

    fn run(row: &str, scene: &str, psnr: f64) -> Run {
        let protocol = scene::Protocol {
            dataset: "d".into(),
            split: "s".into(),
            width: 9,
            height: 9,
            resize: "none".into(),
            background: "white".into(),
            time: "t".into(),
        };
        let mut run = Run { row: row.into(), scene: scene.into(), seed: "0".into(), ..Run::default() };
        (run.protocol, run.judged_by) = (Some(protocol), Some("test images".into()));
        run.figures = [
            (Column::PSNR, Score::Value(psnr)),
            (Column::Metric(Metric::Ssim), Score::undefined("too small")),
            (Column::Gaussians, Score::Value(200.0)),
            (Column::TrainingSecs, Score::Value(7.0)),
        ]
        .into();
        set_loss(&mut run, "l1", 0.8);
        set_loss(&mut run, "flow", 0.2);
        set_loss(&mut run, "off", 0.0);
        run
    }

    fn set_loss(run: &mut Run, name: &str, value_share: f64) {
        run.costs.loss_shares.entry(name.into()).or_default().value_share = value_share;
    }

    fn failed(kind: FailureKind) -> Run {
        let failure = RunFailure { producer: "train".into(), kind, message: "no".into() };
        Run { row: "f".into(), scene: "a".into(), seed: "0".into(), failure: Some(failure), ..Run::default() }
    }

    fn runs() -> Vec<Run> {
        vec![run("m", "a", 20.123_456_7), run("m", "b", 25.0), failed(FailureKind::Diverged)]
    }

    fn deviations(found: &[Run]) -> Vec<String> {
        let text = CheckedTable::of("r", &runs(), None).to_text().unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        CheckedTable::read(file.path()).unwrap().check("r", found).deviations
    }

    #[test]
    fn a_table_agrees_with_itself_and_keeps_no_times() {
        assert_eq!(deviations(&runs()), Vec::<String>::new());
        let table = CheckedTable::of("r", &runs(), None);
        assert_eq!(table.check("r", &runs()).compared, 2 * 2 + 2 * 2);
        let text = table.to_text().unwrap();
        assert!(text.contains("psnr = 20.1235") && !text.contains("secs"), "{text}");
        assert!(table.check("other", &runs()).deviations[0].contains("other"));
    }

    #[test]
    fn every_kind_of_deviation_is_named() {
        let changed = |change: fn(&mut Vec<Run>)| {
            let mut runs = runs();
            change(&mut runs);
            deviations(&runs).join("\n")
        };
        let within = changed(|runs| runs[1] = run("m", "b", 25.2));
        assert_eq!(within, "");
        let off = changed(|runs| runs[1] = run("m", "b", 25.3));
        assert_eq!(off, "m on b, seed 0: psnr is 25.300000, expected 25 ± 0.25: off by 0.300000");
        assert!(changed(|runs| runs[1] = run("m", "b", f64::NAN)).contains("not finite"));
        assert!(changed(|runs| drop(runs.remove(0))).contains("m on a, seed 0 is missing"));
        assert!(changed(|runs| runs.push(run("n", "a", 1.0))).contains("n on a, seed 0 is not in the file"));
        assert!(changed(|runs| runs[0].protocol.iter_mut().for_each(|protocol| protocol.width = 8)).contains("8×9"));
        assert!(changed(|runs| runs[2] = failed(FailureKind::Crashed)).contains("expected to fail (Diverged)"));
        assert!(changed(|runs| runs[2] = run("f", "a", 20.0)).contains("expected to fail"));
        let defined = changed(|runs| drop(runs[0].figures.insert(Column::Metric(Metric::Ssim), Score::Value(0.5))));
        assert!(defined.contains("ssim is 0.5, expected none"), "{defined}");
        assert_eq!(changed(|runs| set_loss(&mut runs[0], "flow", 0.3)), "");
        assert!(changed(|runs| set_loss(&mut runs[0], "flow", 0.04)).contains("share of loss flow is 0.040000"));
        assert!(changed(|runs| set_loss(&mut runs[0], "flow", 0.0)).contains("loss flow is gone"));
        assert!(changed(|runs| set_loss(&mut runs[0], "new", 0.1)).contains("loss new is not in the file"));
        let mut nothing = runs();
        nothing[0].protocol = None;
        assert!(deviations(&nothing)[0].contains("has no numbers"));
    }

    #[test]
    fn written_again_a_file_keeps_its_tolerances() {
        let mut earlier = CheckedTable::of("r", &runs(), None);
        earlier.tolerances = [(Column::PSNR, Amount::Percent(50.0))].into();
        let again = CheckedTable::of("r", &runs(), Some(&earlier));
        assert_eq!(again.tolerances, earlier.tolerances);
        assert!(again.tables[0].runs[0].figures.len() == 1);
        assert!(
            again
                .check("r", &[run("m", "a", 29.0), run("m", "b", 14.0), failed(FailureKind::Diverged)])
                .deviations
                .is_empty()
        );
    }

    #[test]
    fn other_files_are_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        for wrong in
            ["", "recipe = 3", "recipe = \"r\"\n[tolerances]\npsnr = -1.0", "recipe = \"r\"\n[tolerances]\npsnrr = 1"]
        {
            std::fs::write(file.path(), wrong).unwrap();
            let refused = CheckedTable::read(file.path()).unwrap_err();
            assert_eq!(refused.exit_code(), 3, "{wrong}");
        }
    }

    #[test]
    fn damaged_files_never_panic() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("table.toml");
        std::fs::write(&path, CheckedTable::of("r", &runs(), None).to_text().unwrap()).unwrap();
        let read = |path: &Path| CheckedTable::read(path).map(|table| drop(table.check("r", &runs())));
        let refused = scene::mangle::refused(&path, 400, read);
        assert!(refused >= 100, "only {refused} of 400 damaged files were refused");
    }
}
