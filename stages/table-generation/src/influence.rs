//! The contribution of every loss and every effect of a row: its gradient, the effect of leaving it out, and its seconds.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use training::INERT_SHARE;

use crate::column::Column;
use crate::difference::Difference;

/// Maximum half-width, in dB, of the interval of a difference in PSNR that shows an effect to be inert.
pub(crate) const PRECISE_DB: f64 = 0.3;

/// The influence of one loss or effect on the trainings of a row.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Influence {
    /// The loss, or the effect without a loss of its name.
    pub part: String,
    /// The effect that a loss belongs to.
    pub effect: Option<String>,
    /// The reason why it is kept even if it is inert; `None` if it has to act.
    pub stays: Option<String>,
    /// Whether it is a loss.
    pub is_loss: bool,
    /// By group of tensors: the gradient relative to the photometric one, median over runs; none where the loss is the
    /// only one that moves the group. A group that its gradient does not reach is absent.
    pub shares: BTreeMap<String, Option<f64>>,
    /// Sampled steps of all runs; 0 for an effect, and for a loss that is never part of a step with others.
    pub samples: usize,
    /// PSNR and the metrics of tasks (`Column::TASKS`) without it minus those with it, over the scenes that both have; empty if
    /// not measured.
    pub left_out: BTreeMap<Column, Difference>,
    /// Seconds per training: of a loss, estimated; of an effect, the difference when it is left out.
    pub secs: Option<f64>,
    /// Those seconds as a share of the training.
    pub secs_share: Option<f64>,
    /// Whether it has no measurable effect; see `Influence::judged`.
    pub is_inert: bool,
}

impl Influence {
    /// The group with the largest share, among those that the photometric loss moves too; none without such a group.
    pub(crate) fn largest_share(&self) -> Option<(&str, f64)> {
        let shared = self.shares.iter().filter_map(|(group, share)| Some((group.as_str(), (*share)?)));
        shared.max_by(|(_, a), (_, b)| a.total_cmp(b))
    }

    /// The groups that this loss moves, but the photometric one does not.
    pub(crate) fn alone_in(&self) -> Vec<&str> {
        self.shares.iter().filter(|(_, share)| share.is_none()).map(|(group, _)| group.as_str()).collect()
    }

    /// Whether it was sampled, and its gradient is negligible wherever the photometric loss has one.
    pub(crate) fn is_faint(&self) -> bool {
        self.samples > 0 && self.largest_share().is_none_or(|(_, share)| share < INERT_SHARE)
    }

    /// A loss or an effect is inert if leaving it out changes nothing, measured precisely; a loss also if its gradient is too
    /// small in every group and leaving it out changes no value that was measured. A loss that alone moves a group, e.g. a
    /// head, is not: renders and these metrics do not show it.
    pub(crate) fn judged(self) -> Self {
        let moves_nothing = self.is_faint() && !self.changes_a_value();
        let is_inert = self.alone_in().is_empty() && (moves_nothing || self.changes_nothing());
        Self { is_inert, ..self }
    }

    /// Whether leaving it out changes PSNR or a metric of a task, measured with several seeds.
    fn changes_a_value(&self) -> bool {
        self.left_out.values().any(|difference| difference.half_width.is_some() && !difference.is_noise())
    }

    /// Whether leaving it out changes no value, and PSNR was measured precisely.
    pub fn changes_nothing(&self) -> bool {
        let width = self.left_out.get(&Column::PSNR).and_then(|difference| difference.half_width);
        width.is_some_and(|width| width <= PRECISE_DB) && !self.changes_a_value()
    }
}
