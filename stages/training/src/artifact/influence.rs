//! The influence of every loss: the norm of its gradient per group of tensors, sampled over each phase.

use std::collections::{BTreeMap, BTreeSet};

use scene::statistics::median;
use serde::{Deserialize, Serialize};

/// The loss that all others are compared with.
pub(crate) const PHOTOMETRIC: &str = "photometric";

/// Below this share of the photometric gradient in every group of tensors, a loss is inert: a thousand of its steps
/// weigh less than one of the photometric loss.
pub const INERT_SHARE: f64 = 1e-3;

/// Minimum number of samples without any gradient after which a group counts as stalled.
const STALLED_SAMPLES: usize = 3;

/// The influence of all losses in one phase of a training.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseInfluence {
    /// Completed steps.
    pub steps: u64,
    /// By loss.
    pub losses: BTreeMap<String, LossInfluence>,
    /// By loss, the measured weight at which its gradient was as large as the photometric one at the start.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub units: BTreeMap<String, f64>,
}

/// The influence of one loss in one phase.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossInfluence {
    /// The effect that it belongs to, if any.
    pub effect: Option<String>,
    /// The reason why it is kept even if it is inert; `None` if it has to act.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stays: Option<String>,
    /// Steps whose objective it was part of.
    pub acted: u64,
    /// The sampled steps, counted from 1 within the phase; a step with a single loss is never sampled.
    pub iterations: Vec<u64>,
    /// The L2 norm of the gradient of the weighted loss with respect to all tensors of a group, one per sampled step. A
    /// group that no gradient of the loss reached is absent: its norms are 0.
    pub norms: BTreeMap<String, Vec<f64>>,
}

/// The gradient of a loss in one group of tensors, relative to that of the photometric loss.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupShare {
    /// The group, e.g. `positions`.
    pub group: String,
    /// The median over the sampled steps of the ratio of both norms, times the share of the steps in which the loss
    /// acted. Infinite if the loss is the only one that moves the group.
    pub share: f64,
}

/// Groups that gradients reached at first, but no more until the end of a phase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Stalled {
    /// The groups, in alphabetical order.
    pub groups: Vec<String>,
    /// The last sampled step with a gradient.
    pub last: u64,
    /// Sampled steps after it, and of the phase.
    pub samples: [usize; 2],
}

/// The largest share of a loss in any phase and group, infinite where it is the only one; `None` if it was never
/// sampled or is the photometric loss.
pub fn largest_share(phases: &BTreeMap<String, PhaseInfluence>, loss: &str) -> Option<f64> {
    let is_sampled = |phase: &&PhaseInfluence| phase.losses.get(loss).is_some_and(|own| !own.iterations.is_empty());
    let sampled = phases.values().filter(is_sampled).filter(|_| loss != PHOTOMETRIC);
    let largest = sampled.map(|phase| phase.shares(loss).first().map_or(0.0, |largest| largest.share));
    largest.max_by(f64::total_cmp)
}

impl PhaseInfluence {
    /// Counts one step with these losses.
    pub(crate) fn count<'n>(&mut self, losses: impl IntoIterator<Item = &'n str>) {
        self.steps += 1;
        losses.into_iter().for_each(|loss| self.loss_mut(loss).acted += 1);
    }

    /// Adds the sample of one loss: the squared norm of its gradient by tensor.
    pub(crate) fn add_sample<'n>(
        &mut self,
        loss: &str,
        iteration: u64,
        squared_norms: impl IntoIterator<Item = (&'n str, f64)>,
    ) {
        let mut squared_by_group: BTreeMap<String, f64> = BTreeMap::new();
        for (tensor, squared) in squared_norms {
            *squared_by_group.entry(group_of(tensor)).or_default() += squared;
        }
        let LossInfluence { iterations, norms, .. } = self.loss_mut(loss);
        squared_by_group.retain(|group, squared| *squared != 0.0 || norms.contains_key(group));
        for group in squared_by_group.keys() {
            norms.entry(group.clone()).or_insert_with(|| vec![0.0; iterations.len()]);
        }
        for (group, norms) in norms {
            norms.push(rounded(squared_by_group.get(group).copied().unwrap_or(0.0).sqrt()));
        }
        iterations.push(iteration);
    }

    /// The shares of a loss in every group that its gradient reached, largest first; empty without samples.
    pub fn shares(&self, loss: &str) -> Vec<GroupShare> {
        let (Some(own), Some(photometric)) = (self.losses.get(loss), self.losses.get(PHOTOMETRIC)) else {
            return Vec::new();
        };
        let acted = own.acted as f64 / self.steps.max(1) as f64;
        let share = |(group, norms): (&String, &Vec<f64>)| {
            let reference = |iteration| photometric.norm_at(group, iteration);
            let ratios = norms.iter().zip(&own.iterations).map(|(norm, at)| ratio(*norm, reference(*at)));
            GroupShare { group: group.clone(), share: acted * median(ratios).unwrap_or(0.0) }
        };
        let mut shares: Vec<GroupShare> = own.norms.iter().map(share).collect();
        shares.sort_by(|a, b| b.share.total_cmp(&a.share));
        shares
    }

    /// The groups that stopped receiving gradients, by the last sampled step with one.
    pub(crate) fn stalled(&self) -> Vec<Stalled> {
        let sampled: BTreeSet<u64> = self.losses.values().flat_map(|loss| loss.iterations.iter().copied()).collect();
        let mut last_by_group: BTreeMap<&str, u64> = BTreeMap::new();
        for loss in self.losses.values() {
            for (group, norms) in &loss.norms {
                let with_gradient = loss.iterations.iter().zip(norms).filter(|(_, norm)| **norm > 0.0);
                let last = with_gradient.map(|(&iteration, _)| iteration).max().unwrap_or(0);
                let known = last_by_group.entry(group).or_default();
                *known = last.max(*known);
            }
        }
        let mut groups_by_last: BTreeMap<u64, Vec<String>> = BTreeMap::new();
        for (group, last) in last_by_group {
            groups_by_last.entry(last).or_default().push(group.to_owned());
        }
        let stalled = |(last, groups)| {
            let later = sampled.range(last + 1..).count();
            (last > 0 && later >= STALLED_SAMPLES).then_some(Stalled { groups, last, samples: [later, sampled.len()] })
        };
        groups_by_last.into_iter().filter_map(stalled).collect()
    }

    /// Records the known units of losses.
    pub(crate) fn record_units<'n>(&mut self, units: impl Iterator<Item = (&'n str, f64)>) {
        self.units = units.map(|(loss, unit)| (loss.to_owned(), rounded(unit))).collect();
    }

    fn loss_mut(&mut self, loss: &str) -> &mut LossInfluence {
        if !self.losses.contains_key(loss) {
            self.losses.insert(loss.into(), LossInfluence::default());
        }
        self.losses.get_mut(loss).expect("just inserted")
    }
}

impl LossInfluence {
    /// The norm in a group at the last sampled step up to `iteration`, else at the first one.
    fn norm_at(&self, group: &str, iteration: u64) -> f64 {
        let later = self.iterations.partition_point(|&at| at <= iteration);
        self.norms.get(group).and_then(|norms| norms.get(later.saturating_sub(1))).copied().unwrap_or(0.0)
    }
}

/// The group that a tensor belongs to: an attribute of the Gaussians, e.g. `positions`; elsewhere the part of a
/// network, e.g. `network.trunk`, or the field of a plane.
fn group_of(tensor: &str) -> String {
    let (population, rest) = tensor.split_once('.').unwrap_or((tensor, ""));
    let part = match rest.split('.').next().expect("a split has a first part") {
        "opacity_logits" => "opacities",
        "sh_dc" => "colours",
        "sh_rest" => "harmonics",
        part if part.starts_with("log_scales") || part.starts_with("log_thick") => "scales",
        part if part.starts_with("rotations") => "rotations",
        part if part.starts_with("plane_") => "planes",
        part => part,
    };
    match (population, part) {
        ("gaussians", part) => part.into(),
        (population, "") => population.into(),
        (population, part) => format!("{population}.{part}"),
    }
}

/// `norm` / `reference`: 0 without a gradient, infinite without a reference.
fn ratio(norm: f64, reference: f64) -> f64 {
    if norm == 0.0 { 0.0 } else { norm / reference }
}

/// Four significant digits: measurements of samples need no more, and records stay small. A norm whose square is too
/// large for f32 becomes the largest number, because JSON has no infinity.
fn rounded(value: f64) -> f64 {
    let value = value.min(1e300);
    format!("{value:.3e}").parse().expect("a formatted number")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_relative_to_photometric_and_weighed_by_steps() {
        let mut phase = PhaseInfluence::default();
        for iteration in 1..=4 {
            phase.count([PHOTOMETRIC]);
            phase.add_sample(PHOTOMETRIC, iteration, [("gaussians.positions", 4.0), ("gaussians.sh_dc", 1.0)]);
        }
        phase.losses.get_mut(PHOTOMETRIC).unwrap().acted = 4;
        phase.loss_mut("rigid").acted = 2;
        phase.add_sample("rigid", 2, [("gaussians.positions", 1.0)]);
        phase.add_sample("rigid", 4, [("gaussians.positions", 1.0), ("nodes.gates", 9.0), ("gaussians.sh_dc", 0.0)]);
        let share = |group: &str, share| GroupShare { group: group.into(), share };
        assert_eq!(phase.shares("rigid"), [share("nodes.gates", f64::INFINITY), share("positions", 0.25)]);
        assert_eq!(phase.losses["rigid"].norms["nodes.gates"], [0.0, 3.0]);
        assert_eq!(phase.shares("absent"), []);
        let phases = [("fine".to_owned(), phase)].into();
        let largest = ["rigid", "absent", PHOTOMETRIC].map(|loss| largest_share(&phases, loss));
        assert_eq!(largest, [Some(f64::INFINITY), None, None]);
    }

    #[test]
    fn groups_that_no_gradient_reaches_any_more_are_stalled() {
        let mut phase = PhaseInfluence::default();
        for iteration in 1..=5 {
            let trunk = if iteration <= 2 { 4.0 } else { 0.0 };
            let head = if iteration <= 3 { 1.0 } else { 0.0 };
            let norms =
                [("network.trunk.0.weight", trunk), ("network.head.weight", head), ("gaussians.positions", 1.0)];
            phase.add_sample(PHOTOMETRIC, iteration, norms);
        }
        let stalled = |last, later| Stalled { groups: vec!["network.trunk".into()], last, samples: [later, 5] };
        assert_eq!(phase.stalled(), [stalled(2, 3)], "two samples without a gradient may be chance");
        // Another loss reaches the group later.
        phase.add_sample("rigid", 4, [("network.trunk.0.weight", 1.0)]);
        assert_eq!(phase.stalled(), []);
    }

    #[test]
    fn tensors_are_grouped_by_attribute_and_by_part_of_a_network() {
        let groups = [
            ("gaussians.log_scales_time", "scales"),
            ("foreground.sh_dc", "foreground.colours"),
            ("field.plane_0_xy", "field.planes"),
            ("network.position.0.weight", "network.position"),
            ("embedding", "embedding"),
        ];
        groups.into_iter().for_each(|(tensor, group)| assert_eq!(group_of(tensor), group));
    }
}
