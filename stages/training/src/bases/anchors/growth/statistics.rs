//! Statistics of anchors and their Gaussians over the renders since the last decision about them.

use serde::{Deserialize, Serialize};
use shaders::pointwise;
use shaders::pointwise::add;
use shaders::tape::{Tape, Tensor};

use crate::bases::gaussians::{self, GRADIENT_SUM, SEEN_COUNT};
use crate::method::{Parents, ScreenStats};

pointwise! {
    /// y = sum + term / count where count > 0, otherwise sum.
    fn add_mean(sum, term, count) -> y {
        return select(sum, sum + term / max(count, 1.0), count > 0.0);
    }
    gradients(dy) {
        sum: { return dy; }
        term: { return select(0.0, dy / max(count, 1.0), count > 0.0); }
        count: { return 0.0 * dy; }
    }
}

/// Sums per anchor and per Gaussian (slot), K slots per anchor. They stay on the device that renders until they are
/// read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Saved", into = "Saved")]
pub(crate) struct Statistics {
    per_anchor: usize,
    /// Statistics of the N·K slots.
    gaussians: gaussians::Statistics,
    /// [N, 1]: per step, the summed opacity of the anchor's Gaussians, averaged over the renders that have the anchor in view;
    /// summed over steps.
    opacity_sum: Tensor<f32>,
    /// [N, 1] number of steps with the anchor in view.
    view_count: Tensor<f32>,
}

/// Statistics in a checkpoint.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Saved {
    per_anchor: usize,
    /// [N·K] sums of the norms of the gradients with respect to projected means, normalised device coordinates.
    gradient_sum: Vec<f32>,
    /// [N·K] number of steps in which the Gaussian is visible.
    seen_count: Vec<u32>,
    /// [N] sums of opacities.
    opacity_sum: Vec<f32>,
    /// [N] number of steps with the anchor in view.
    view_count: Vec<u32>,
}

impl From<Saved> for Statistics {
    fn from(saved: Saved) -> Self {
        let Saved { per_anchor, gradient_sum, seen_count, opacity_sum, view_count } = saved;
        // The radii of the Gaussians of anchors are not used.
        let row = |(sum, count): (f32, u32)| [sum, count as f32, 0.0];
        let rows: Vec<f32> = gradient_sum.into_iter().zip(seen_count).flat_map(row).collect();
        let view_count = view_count.into_iter().map(|count| count as f32).collect();
        Self { per_anchor, gaussians: rows.into(), opacity_sum: column(opacity_sum), view_count: column(view_count) }
    }
}

impl From<Statistics> for Saved {
    fn from(statistics: Statistics) -> Self {
        let rows = statistics.gaussians.rows();
        Self {
            per_anchor: statistics.per_anchor,
            gradient_sum: rows.iter().map(|row| row[GRADIENT_SUM]).collect(),
            seen_count: rows.iter().map(|row| row[SEEN_COUNT] as u32).collect(),
            opacity_sum: statistics.opacity_sum.as_slice().to_vec(),
            view_count: statistics.view_count.as_slice().iter().map(|count| *count as u32).collect(),
        }
    }
}

impl Default for Statistics {
    fn default() -> Self {
        Saved::default().into()
    }
}

impl Statistics {
    /// Whether there are no statistics yet.
    pub(crate) fn is_empty(&self) -> bool {
        self.view_count.is_empty()
    }

    /// Adds one step's renders, on the device that rendered.
    pub(crate) fn observe(&mut self, stats: &ScreenStats<'_>, per_anchor: usize) {
        self.per_anchor = per_anchor;
        self.resize(stats.rows() / per_anchor);
        self.gaussians.observe(stats);
        self.add_views(stats);
    }

    /// Adds the views of one step. An anchor counts once, whatever the number of renders that have it in view.
    fn add_views(&mut self, stats: &ScreenStats<'_>) {
        let Some((first, others)) = stats.parents().split_first() else { return };
        let mut tape = Tape::new(first.in_view.device());
        let [mut views, mut opacity] = [&first.in_view, &first.opacity].map(|tensor| tape.constant(tensor.clone()));
        for Parents { in_view, opacity: of_render } in others {
            let [in_view, of_render] = [in_view, of_render].map(|tensor| tape.constant(tensor.clone()));
            (views, opacity) = (add(&mut tape, views, in_view), add(&mut tape, opacity, of_render));
        }
        let sums = [&self.opacity_sum, &self.view_count].map(|tensor| tape.constant(tensor.clone()));
        let opacity_sum = add_mean(&mut tape, sums[0], opacity, views);
        let view_count = add_mean(&mut tape, sums[1], views, views);
        [self.opacity_sum, self.view_count] = [opacity_sum, view_count].map(|sum| tape.value(sum).clone());
    }

    /// [N·K] the mean gradient of every Gaussian that is visible in more than `needed` steps.
    pub(crate) fn mean_gradients(&self, needed: f64) -> Vec<Option<f32>> {
        self.gaussians.rows().iter().map(|row| mean(row[GRADIENT_SUM], row[SEEN_COUNT], needed)).collect()
    }

    /// [N] the mean opacity, summed over its Gaussians, of every anchor that is in view in more than `needed` steps.
    pub(crate) fn mean_opacities(&self, needed: f64) -> Vec<Option<f32>> {
        let rows = self.opacity_sum.as_slice().iter().zip(self.view_count.as_slice());
        rows.map(|(&sum, &count)| mean(sum, count, needed)).collect()
    }

    /// Resets the statistics of the Gaussians with a value in [`Statistics::mean_gradients`].
    pub(crate) fn reset_gradients(&mut self, needed: f64) {
        self.gaussians.reset_gradients(|_, row| f64::from(row[SEEN_COUNT]) > needed);
    }

    /// Resets the statistics of the anchors with a value in [`Statistics::mean_opacities`].
    pub(crate) fn reset_opacities(&mut self, needed: f64) {
        for (sum, count) in self.opacity_sum.make_mut().iter_mut().zip(self.view_count.make_mut()) {
            if f64::from(*count) > needed {
                (*sum, *count) = (0.0, 0.0);
            }
        }
    }

    /// Resizes to a number of anchors; new ones have no statistics.
    pub(crate) fn resize(&mut self, anchors: usize) {
        self.gaussians.resize(anchors * self.per_anchor);
        for sums in [&mut self.opacity_sum, &mut self.view_count].into_iter().filter(|sums| sums.len() != anchors) {
            let mut values = sums.as_slice().to_vec();
            values.resize(anchors, 0.0);
            *sums = column(values);
        }
    }

    /// Removes the anchors whose flag is false.
    pub(crate) fn keep(&mut self, keep: &[bool]) {
        let of_slots: Vec<bool> = keep.iter().flat_map(|&keep| std::iter::repeat_n(keep, self.per_anchor)).collect();
        self.gaussians.keep(&of_slots);
        for sums in [&mut self.opacity_sum, &mut self.view_count] {
            let kept = sums.as_slice().iter().zip(keep).filter(|(_, keep)| **keep);
            *sums = column(kept.map(|(value, _)| *value).collect());
        }
    }
}

/// The mean, if the count is larger than `needed`.
fn mean(sum: f32, count: f32, needed: f64) -> Option<f32> {
    (f64::from(count) > needed).then(|| sum / count)
}

fn column(values: Vec<f32>) -> Tensor<f32> {
    Tensor::from_vec([values.len(), 1], values)
}
