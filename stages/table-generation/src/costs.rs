//! Where the time of a training goes: milliseconds per iteration by phase, what each loss weighs and takes, and the
//! work that nothing called for.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::document::{Table, Text};
use crate::format::{NONE, number};
use crate::report::{Group, Row};

/// What trainings measured, beside their sum.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Costs {
    /// Milliseconds per iteration by phase (`coarse`, `fine`) and activity (`motion`, `backward`).
    pub ms_per_iteration_by_phase: BTreeMap<String, BTreeMap<String, f64>>,
    /// By the loss's name.
    pub loss_shares: BTreeMap<String, LossShare>,
    /// By what was left out: how much of how much.
    pub skipped_work: BTreeMap<String, [u64; 2]>,
}

/// What one loss contributes, and what it takes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossShare {
    /// Of the sum of all weighted values over all steps.
    pub value_share: f64,
    /// Seconds of its forward pass, where its method clocks it.
    pub forward_secs: Option<f64>,
}

impl Costs {
    /// Means over several runs; what was left out is summed.
    pub fn mean<'a>(runs: impl Iterator<Item = &'a Self> + Clone) -> Self {
        let mut total = Self::default();
        for run in runs.clone() {
            for (phase, activities) in &run.ms_per_iteration_by_phase {
                let count = runs.clone().filter(|other| other.ms_per_iteration_by_phase.contains_key(phase)).count();
                let sums = total.ms_per_iteration_by_phase.entry(phase.clone()).or_default();
                for (activity, ms) in activities {
                    *sums.entry(activity.clone()).or_default() += ms / count as f64;
                }
            }
            for (name, share) in &run.loss_shares {
                let count = runs.clone().filter(|other| other.loss_shares.contains_key(name)).count() as f64;
                let sum = total.loss_shares.entry(name.clone()).or_default();
                sum.value_share += share.value_share / count;
                if let Some(secs) = share.forward_secs {
                    *sum.forward_secs.get_or_insert(0.0) += secs / count;
                }
            }
            for (what, [skipped, of]) in &run.skipped_work {
                let sum = total.skipped_work.entry(what.clone()).or_default();
                sum[0] += skipped;
                sum[1] += of;
            }
        }
        total
    }

    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        let times = self.ms_per_iteration_by_phase.values().flat_map(BTreeMap::values);
        let shares = self.loss_shares.values().flat_map(|share| [share.value_share, share.forward_secs.unwrap_or(0.0)]);
        times.copied().chain(shares).all(f64::is_finite)
    }
}

/// The tables of one group; those without rows are left out.
pub fn cost_tables(group: &Group) -> impl Iterator<Item = Table> {
    [iteration_table(group), loss_table(group), skipped_table(group)].into_iter().filter(|table| !table.rows.is_empty())
}

/// Milliseconds per iteration: a row per method and phase, a column per activity.
fn iteration_table(group: &Group) -> Table {
    let phases = |row: &Row| row.costs.ms_per_iteration_by_phase.clone();
    let names: BTreeSet<String> =
        group.rows.iter().flat_map(|row| phases(row).into_values().flat_map(BTreeMap::into_keys)).collect();
    let header = ["method · phase".into(), "all".into()].into_iter().chain(names.iter().cloned()).collect();
    let caption = format!("Protocol {}: milliseconds per iteration by phase, mean over runs", group.name);
    let mut table = Table::new(caption, header);
    for row in &group.rows {
        for (phase, activities) in phases(row) {
            let all: f64 = activities.values().sum();
            let cells = names.iter().map(|name| activities.get(name).map_or(NONE.into(), |ms| number(*ms, 2)));
            let cells = [format!("{} · {phase}", row.name), number(all, 2)].into_iter().chain(cells);
            table.rows.push(cells.map(Text::plain).collect());
        }
    }
    table
}

/// What each loss weighs in the sum, and how long its forward pass takes.
fn loss_table(group: &Group) -> Table {
    let header = ["method · loss", "share of the value (%)", "forward (s)"].map(String::from);
    let mut table = Table::new(format!("Protocol {}: losses, mean over runs", group.name), header.into());
    // A method with one loss has nothing to share.
    for row in group.rows.iter().filter(|row| row.costs.loss_shares.len() > 1) {
        for (name, share) in &row.costs.loss_shares {
            let secs = share.forward_secs.map_or(NONE.into(), |secs| number(secs, 2));
            let cells = [format!("{} · {name}", row.name), number(100.0 * share.value_share, 2), secs];
            table.rows.push(cells.map(Text::plain).into());
        }
    }
    table
}

/// What was left out because nothing called for it.
fn skipped_table(group: &Group) -> Table {
    let header = ["method · work", "left out", "of", "share (%)"].map(String::from);
    let caption = format!("Protocol {}: work that no scene called for, sum over runs", group.name);
    let mut table = Table::new(caption, header.into());
    for row in &group.rows {
        for (what, [skipped, of]) in &row.costs.skipped_work {
            let share = 100.0 * *skipped as f64 / (*of).max(1) as f64;
            let cells = [format!("{} · {what}", row.name), skipped.to_string(), of.to_string(), number(share, 1)];
            table.rows.push(cells.map(Text::plain).into());
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn costs(ms: f64, skipped: u64) -> Costs {
        Costs {
            ms_per_iteration_by_phase: [("fine".into(), [("motion".into(), ms)].into())].into(),
            loss_shares: [("flow".into(), LossShare { value_share: 0.01 * ms, forward_secs: Some(ms) })].into(),
            skipped_work: [("still Gaussians".into(), [skipped, 10])].into(),
        }
    }

    #[test]
    fn times_are_averaged_and_counts_are_summed() {
        let runs = [costs(2.0, 3), costs(4.0, 5), Costs::default()];
        let mean = Costs::mean(runs.iter());
        assert_eq!(mean.ms_per_iteration_by_phase["fine"]["motion"], 3.0, "over the runs that have the phase");
        assert_eq!(mean.loss_shares["flow"].forward_secs, Some(3.0));
        assert_eq!(mean.skipped_work["still Gaussians"], [8, 20]);
        assert!(mean.is_finite() && !costs(f64::NAN, 0).is_finite());
    }
}
