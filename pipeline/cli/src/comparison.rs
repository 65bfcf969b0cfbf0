//! Compares two results in pairs of runs with the same scene and seed, so that differences between scenes and seeds
//! cancel.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use engine::names_hint;
use serde::Serialize;
use table_generation::{Column, Run, distinct, half_width, sample_std};

use crate::amount::Amount;
use crate::error::CliError;
use crate::measured::{name, value};
use crate::output::count;

/// The comparison of result B with result A.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Comparison {
    /// The pairs of runs by protocol, in order of appearance.
    pub(crate) protocols: Vec<UnderOneProtocol>,
    /// Runs of A without a partner in B.
    pub(crate) only_in_a: Vec<String>,
    /// Runs of B without a partner in A.
    pub(crate) only_in_b: Vec<String>,
    /// Values of runs of A without a partner in B: metric → runs. If rows are paired by name, only those of these rows.
    pub(crate) without_partner: BTreeMap<Column, Vec<String>>,
    /// The reason why times are left out, if they are.
    pub(crate) without_times: Option<String>,
}

/// Pairs measured under one protocol, whose values may be averaged.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct UnderOneProtocol {
    /// The protocol's name, hash and content on one line.
    pub(crate) protocol: String,
    /// The evaluated images and the metric definitions.
    pub(crate) judged_by: String,
    /// One entry per pair of table rows.
    pub(crate) rows: Vec<ComparedRow>,
    /// All pairs together, if there are several rows.
    pub(crate) all: Option<ComparedRow>,
}

/// A table row of A compared with a table row of B.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct ComparedRow {
    /// The row's name in A.
    pub(crate) a: String,
    /// The row's name in B.
    pub(crate) b: String,
    /// The metrics that both sides have.
    pub(crate) metrics: BTreeMap<Column, Paired>,
    /// Values that A has and B lacks: metric → runs, each with the reason.
    pub(crate) lost: BTreeMap<Column, Vec<String>>,
    /// Values that B has and A lacks: metric → runs, each with the reason.
    pub(crate) gained: BTreeMap<Column, Vec<String>>,
    /// Pairs that no mean contains, because their seed has no value in another scene: metric → runs.
    pub(crate) left_out: BTreeMap<Column, Vec<String>>,
}

/// What an interval is taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Unit {
    /// The mean differences of the scenes.
    Scenes,
    /// The differences of the seeds of a single scene.
    Seeds,
}

/// One metric over all pairs in which both sides have a value, of the seeds that have one in every scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Paired {
    /// Number of pairs: scenes × seeds (× rows for [`UnderOneProtocol::all`]).
    pub(crate) pairs: usize,
    /// Mean of A: the mean over scenes of each scene's mean or, for a single scene, the mean over seeds.
    pub(crate) mean_a: f64,
    /// Mean of B, averaged like [`Self::mean_a`].
    pub(crate) mean_b: f64,
    /// Mean of B − A.
    pub(crate) difference: f64,
    /// Student's 95 % confidence interval for the mean of B − A, from the spread over scenes or, for a single scene,
    /// over seeds: runs that share a scene are not independent. None for a single scene and seed.
    pub(crate) interval: Option<[f64; 2]>,
    /// What the interval is taken over.
    pub(crate) over: Unit,
    /// Number of scenes or seeds that the interval is taken over.
    pub(crate) n: usize,
    /// Number of seeds of the pairs.
    pub(crate) seeds: usize,
    /// Number of pairs in which B is better.
    pub(crate) better: usize,
    /// Number of pairs in which B is worse.
    pub(crate) worse: usize,
}

/// A run of A, and the values of it and of its partner in B.
type ValuePair<'r> = (&'r Run, [f64; 2]);

/// A pair of runs with different protocols, whose values must not be compared.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ProtocolsDiffer {
    run: String,
    a: [String; 2],
    b: [String; 2],
}

impl std::error::Error for ProtocolsDiffer {}

impl fmt::Display for ProtocolsDiffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { run, a, b } = self;
        write!(f, "{run} was measured under different protocols, so its values are not comparable")?;
        let lines = a.iter().zip(b).filter(|(a, b)| a != b);
        lines.into_iter().try_for_each(|(a, b)| write!(f, "\n  A: {a}\n  B: {b}"))
    }
}

/// Pairs the runs of two results and compares them. `rows` pairs rows of A with rows of B; if it is empty, rows of
/// equal names are paired, or the only row of A with the only row of B.
pub(crate) fn compare(a: &[Run], b: &[Run], rows: &[(String, String)]) -> Result<Comparison, ProtocolsDiffer> {
    let is_wanted = |run: &Run| rows.is_empty() || rows.iter().any(|(row_a, _)| run.row == *row_a);
    let rows = if rows.is_empty() { matching_rows(a, b) } else { rows.to_vec() };
    let mut partners = Vec::new();
    for (row_a, row_b) in &rows {
        for run_a in a.iter().filter(|run| run.row == *row_a) {
            let is_partner = |run: &&Run| run.row == *row_b && run.scene == run_a.scene && run.seed == run_a.seed;
            partners.extend(b.iter().find(is_partner).map(|run_b| (run_a, run_b)));
        }
    }
    partners.iter().try_for_each(|(a, b)| check_protocols(a, b))?;
    let without_times = different_machines(&partners);
    let mut keys = Vec::new();
    for key in partners.iter().filter_map(common_protocol) {
        if !keys.contains(&key) {
            keys.push(key);
        }
    }
    let under = |key: [String; 2]| {
        let own: Vec<_> =
            partners.iter().copied().filter(|pair| common_protocol(pair).as_ref() == Some(&key)).collect();
        under_one_protocol(key, &rows, &own, without_times.is_none())
    };
    let protocols = keys.into_iter().map(under).collect();
    let only_in_a = || a.iter().filter(|run| !partners.iter().any(|(a, _)| std::ptr::eq(*a, *run)));
    let only_in_b = b.iter().filter(|run| !partners.iter().any(|(_, b)| std::ptr::eq(*b, *run)));
    let mut without_partner: BTreeMap<Column, Vec<String>> = BTreeMap::new();
    for run in only_in_a().filter(|run| is_wanted(run)) {
        for column in compared_columns(without_times.is_none()).filter(|&column| value(run, column).is_ok()) {
            without_partner.entry(column).or_default().push(name(run));
        }
    }
    Ok(Comparison {
        protocols,
        only_in_a: only_in_a().map(name).collect(),
        only_in_b: only_in_b.map(name).collect(),
        without_partner,
        without_times,
    })
}

/// Compares the pairs of one protocol; `key` is its line and the evaluated images.
fn under_one_protocol(
    key: [String; 2],
    rows: &[(String, String)],
    pairs: &[(&Run, &Run)],
    with_times: bool,
) -> UnderOneProtocol {
    let of_rows = |(row_a, row_b): &(String, String)| {
        let own: Vec<_> = pairs.iter().copied().filter(|(a, b)| a.row == *row_a && b.row == *row_b).collect();
        (!own.is_empty()).then(|| compared_row((row_a, row_b), &own, with_times))
    };
    let compared: Vec<ComparedRow> = rows.iter().filter_map(of_rows).collect();
    let all = (compared.len() > 1).then(|| compared_row(("all", "all"), pairs, with_times));
    let [protocol, judged_by] = key;
    UnderOneProtocol { protocol, judged_by, rows: compared, all }
}

/// The rows of a side, in order of appearance.
pub(crate) fn row_names(runs: &[Run]) -> Vec<String> {
    distinct(runs.iter().map(|run| run.row.as_str()).filter(|row| !row.is_empty()))
}

/// Refuses pairs of rows that name a row that its side does not have.
pub(crate) fn check_rows(a: &[Run], b: &[Run], rows: &[(String, String)]) -> Result<(), CliError> {
    let of_sides = rows.iter().flat_map(|(row_a, row_b)| [("A", a, row_a), ("B", b, row_b)]);
    for (side, runs, row) in of_sides {
        let known = row_names(runs);
        if !known.contains(row) {
            let hint = names_hint(row, known.iter().map(String::as_str));
            return Err(CliError::nothing(format!("{side} has no row `{row}`"), hint));
        }
    }
    Ok(())
}

/// Pairs of rows with equal names or, if there are none, the only row of each side.
fn matching_rows(a: &[Run], b: &[Run]) -> Vec<(String, String)> {
    let (names_a, names_b) = (row_names(a), row_names(b));
    let pair = |a: &String, b: &String| (a.clone(), b.clone());
    let common: Vec<_> = names_a.iter().filter(|name| names_b.contains(name)).map(|name| pair(name, name)).collect();
    match (&common[..], &names_a[..], &names_b[..]) {
        ([], [only_a], [only_b]) => vec![pair(only_a, only_b)],
        _ => common,
    }
}

/// The protocol of a comparable pair; none if neither run was measured.
fn common_protocol((a, b): &(&Run, &Run)) -> Option<[String; 2]> {
    a.protocol_lines().or_else(|| b.protocol_lines())
}

/// Refuses a pair whose protocols, evaluated images or metric definitions differ.
fn check_protocols(a: &Run, b: &Run) -> Result<(), ProtocolsDiffer> {
    match (a.protocol_lines(), b.protocol_lines()) {
        (Some(of_a), Some(of_b)) if of_a != of_b => Err(ProtocolsDiffer { run: name(a), a: of_a, b: of_b }),
        _ => Ok(()),
    }
}

/// The reason why times are not comparable, if the machines of a pair differ.
fn different_machines(partners: &[(&Run, &Run)]) -> Option<String> {
    let on = |run: &Run| {
        let machines = run.machines.iter().map(|(work, machine)| format!("{work} on {}", machine.line()));
        machines.collect::<Vec<_>>().join("; ")
    };
    let differ = partners.iter().find(|(a, b)| !a.machines.is_empty() && !b.machines.is_empty() && on(a) != on(b));
    differ.map(|(a, b)| format!("times are left out: A was measured {}, B {}", on(a), on(b)))
}

/// The columns that a comparison covers.
fn compared_columns(with_times: bool) -> impl Iterator<Item = Column> {
    Column::all().filter(move |column| with_times || !column.is_timing())
}

fn compared_row(names: (&str, &str), pairs: &[(&Run, &Run)], with_times: bool) -> ComparedRow {
    let (metrics, lost, gained, left_out) = Default::default();
    let mut row = ComparedRow { a: names.0.into(), b: names.1.into(), metrics, lost, gained, left_out };
    for column in compared_columns(with_times) {
        let mut values = Vec::new();
        for (a, b) in pairs {
            match (value(a, column), value(b, column)) {
                (Ok(value_a), Ok(value_b)) => values.push((*a, [value_a, value_b])),
                (Ok(_), Err(reason)) => {
                    row.lost.entry(column).or_default().push(format!("{}: {reason}", name(b)));
                }
                (Err(reason), Ok(_)) => {
                    row.gained.entry(column).or_default().push(format!("{}: {reason}", name(a)));
                }
                (Err(_), Err(_)) => (),
            }
        }
        let (values, left_out) = whole_seeds(values);
        if !left_out.is_empty() {
            row.left_out.insert(column, left_out.into_iter().map(|(run, _)| name(run)).collect());
        }
        row.metrics.extend(paired(&values, column).map(|paired| (column, paired)));
    }
    row
}

/// The pairs of the seeds that have a value in every scene of their row, and all others. As in tables, a seed that lacks a
/// scene is in no mean: the means of the scenes would be over different seeds.
fn whole_seeds<'r>(pairs: Vec<ValuePair<'r>>) -> (Vec<ValuePair<'r>>, Vec<ValuePair<'r>>) {
    let (mut of_row, mut of_seed) = (BTreeMap::<_, BTreeSet<_>>::new(), BTreeMap::<_, BTreeSet<_>>::new());
    for (run, _) in &pairs {
        of_row.entry(run.row.as_str()).or_default().insert(run.scene.as_str());
        of_seed.entry((run.row.as_str(), run.seed.as_str())).or_default().insert(run.scene.as_str());
    }
    let is_whole =
        |(run, _): &ValuePair<'r>| of_seed.get(&(run.row.as_str(), run.seed.as_str())) == of_row.get(run.row.as_str());
    pairs.into_iter().partition(is_whole)
}

/// Means, interval and counts over at least one pair of values.
fn paired(pairs: &[ValuePair<'_>], column: Column) -> Option<Paired> {
    let (over, values) = independent(pairs)?;
    let [mean_a, mean_b] = mean_pair(values.iter())?;
    let sign = if column.higher_is_better() { 1.0 } else { -1.0 };
    let count_where = |holds: &dyn Fn(f64) -> bool| pairs.iter().filter(|(_, [a, b])| holds(sign * (b - a))).count();
    Some(Paired {
        pairs: pairs.len(),
        mean_a,
        mean_b,
        difference: mean_b - mean_a,
        interval: interval(&values, mean_b - mean_a),
        over,
        n: values.len(),
        seeds: pairs.iter().map(|(run, _)| &run.seed).collect::<BTreeSet<_>>().len(),
        better: count_where(&|gain| gain > 0.0),
        worse: count_where(&|gain| gain < 0.0),
    })
}

/// The mean values of each scene or, if there is a single scene, of each seed. None without pairs.
fn independent(pairs: &[ValuePair<'_>]) -> Option<(Unit, Vec<[f64; 2]>)> {
    let (first, _) = pairs.first()?;
    let over = if pairs.iter().all(|(run, _)| run.scene == first.scene) { Unit::Seeds } else { Unit::Scenes };
    let mut by_unit = BTreeMap::<&str, Vec<[f64; 2]>>::new();
    for (run, values) in pairs {
        let unit = match over {
            Unit::Scenes => &run.scene,
            Unit::Seeds => &run.seed,
        };
        by_unit.entry(unit).or_default().push(*values);
    }
    Some((over, by_unit.values().filter_map(|values| mean_pair(values.iter())).collect()))
}

fn mean_pair<'a>(values: impl ExactSizeIterator<Item = &'a [f64; 2]>) -> Option<[f64; 2]> {
    let count = values.len() as f64;
    let [a, b] = values.fold([0.0; 2], |[sum_a, sum_b], [a, b]| [sum_a + a, sum_b + b]);
    (count > 0.0).then(|| [a / count, b / count])
}

/// The 95 % interval of the mean of the differences (Student).
fn interval(values: &[[f64; 2]], mean: f64) -> Option<[f64; 2]> {
    let differences: Vec<f64> = values.iter().map(|[a, b]| b - a).collect();
    let half = half_width(sample_std(&differences)?, differences.len())?;
    Some([mean - half, mean + half])
}

impl Paired {
    /// What the interval is taken over, e.g. `3 seeds`. Scenes with a single seed are marked: such a difference may be noise.
    pub(crate) fn scope(&self) -> String {
        match self.over {
            Unit::Scenes if self.seeds == 1 => format!("{} (one seed)", count(self.n, "scene")),
            Unit::Scenes => count(self.n, "scene"),
            Unit::Seeds => count(self.n, "seed"),
        }
    }
}

impl Comparison {
    /// Whether any metric has a value on both sides.
    pub(crate) fn has_values(&self) -> bool {
        self.protocols.iter().flat_map(|under| &under.rows).any(|row| !row.metrics.is_empty())
    }

    /// One line for each violated limit: a row whose mean in B is worse than in A by more than the limit, a run of which B
    /// lacks a value that A has or the whole run, or a limit on a metric that no row has. [`UnderOneProtocol::all`] is
    /// not checked.
    pub(crate) fn violations(&self, limits: &[(Column, Amount)]) -> Vec<String> {
        let rows = || self.protocols.iter().flat_map(|under| &under.rows);
        let is_present =
            |column: &Column| rows().any(|row| row.metrics.contains_key(column) || row.lost.contains_key(column));
        let unchecked = limits.iter().filter(|(column, _)| !is_present(column));
        let mut found: Vec<String> = unchecked
            .map(|(column, _)| format!("{} cannot be checked: no row has it in A and B", column.key()))
            .collect();
        for row in rows() {
            for (column, amount) in limits {
                found.extend(row.violation(*column, *amount));
                let lost = row.lost.get(column).into_iter().flatten();
                found.extend(lost.map(|run| format!("{} is missing in B: {run}", column.key())));
            }
        }
        for (column, _) in limits {
            let runs = self.without_partner.get(column).into_iter().flatten();
            found.extend(runs.map(|run| format!("{} is missing in B: {run}: no such run", column.key())));
        }
        found
    }
}

impl ComparedRow {
    /// The row's name, or both names if they differ.
    pub(crate) fn name(&self) -> String {
        if self.a == self.b { self.a.clone() } else { format!("{} → {}", self.a, self.b) }
    }

    fn violation(&self, column: Column, amount: Amount) -> Option<String> {
        let Paired { mean_a, mean_b, difference, .. } = self.metrics.get(&column)?;
        let loss = if column.higher_is_better() { -difference } else { *difference };
        // Written so that NaN is a violation.
        let holds = loss <= amount.of(*mean_a);
        (!holds).then(|| {
            format!(
                "{}: {} went from {mean_a:.4} to {mean_b:.4}, worse by {loss:.4} where {amount} is allowed",
                self.name(),
                column.key()
            )
        })
    }
}

#[cfg(test)]
mod tests;
