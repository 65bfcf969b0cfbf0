//! The influence of every loss on one training.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use training::PhaseInfluence;

use super::costs::LossShare;

/// The loss that the others are compared with.
const PHOTOMETRIC: &str = "photometric";

/// The gradient and the cost of one loss of a training.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossInfluence {
    /// The name.
    pub loss: String,
    /// The effect that it belongs to, if any.
    pub effect: Option<String>,
    /// The reason why it is kept even if it is inert.
    pub stays: Option<String>,
    /// By group of tensors: the norm of its gradient, relative to that of the photometric loss, weighted by the share
    /// of steps in which it acts; the largest of all phases. `None` if it is the only loss that moves the group. A
    /// group that its gradient does not reach is absent.
    pub shares: BTreeMap<String, Option<f64>>,
    /// Sampled steps: none if the loss is never part of a step with others.
    pub samples: usize,
    /// Estimated seconds of its forward pass, where measured, and of its backward pass.
    pub secs: Option<f64>,
}

/// The influence of every loss of a training but the photometric one.
pub(super) fn influence(
    phases: &BTreeMap<String, PhaseInfluence>,
    costs: &BTreeMap<String, LossShare>,
) -> Vec<LossInfluence> {
    let mut found: BTreeMap<&String, LossInfluence> = BTreeMap::new();
    for (phase, (name, loss)) in phases.values().flat_map(|phase| phase.losses.iter().map(move |loss| (phase, loss))) {
        if name == PHOTOMETRIC {
            continue;
        }
        let own = found.entry(name).or_default();
        own.effect.clone_from(&loss.effect);
        own.stays.clone_from(&loss.stays);
        own.samples += loss.iterations.len();
        for share in phase.shares(name) {
            let finite = Some(share.share).filter(|share| share.is_finite());
            let known = own.shares.entry(share.group).or_insert(finite);
            *known = known.zip(finite).map(|(known, share)| known.max(share));
        }
    }
    let complete = |(name, influence): (&String, LossInfluence)| {
        let secs = costs.get(name).and_then(|cost| {
            Some(cost.forward_secs.unwrap_or(0.0) + cost.backward_secs?) //
        });
        LossInfluence { loss: name.clone(), secs, ..influence }
    };
    found.into_iter().map(complete).collect()
}
