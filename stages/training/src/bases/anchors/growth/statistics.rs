//! What renders said about anchors and their Gaussians since they were last judged.

use serde::{Deserialize, Serialize};
use shaders::pointwise;
use shaders::pointwise::add;
use shaders::tape::{Tape, Tensor};

use crate::bases::gaussians::{self, GRADIENT_SUM, SEEN_COUNT};
use crate::method::{Parents, ScreenStats};

pointwise! {
    /// y = sum + term where count > 0, else the sum as it was.
    fn add_where_counted(sum, term, count) -> y {
        return select(sum, sum + term, count > 0.0);
    }
    gradients(dy) {
        sum: { return dy; }
        term: { return select(0.0, dy, count > 0.0); }
        count: { return 0.0; }
    }
}

/// Sums per anchor and per place of a Gaussian (slot), K slots per anchor; on the device that renders, until somebody judges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Saved", into = "Saved")]
pub(crate) struct Statistics {
    per_anchor: usize,
    /// Of the N·K slots.
    gaussians: gaussians::Statistics,
    /// [N, 1] opacities of all Gaussians of the anchor.
    opacity_sum: Tensor<f32>,
    /// [N, 1] renders that looked at the anchor.
    look_count: Tensor<f32>,
}

/// Statistics in a checkpoint.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Saved {
    per_anchor: usize,
    /// [N·K] norms of the gradients of projected means, normalised device coordinates.
    gradient_sum: Vec<f32>,
    /// [N·K] steps that drew the Gaussian where a render sees it.
    seen_count: Vec<u32>,
    /// [N].
    opacity_sum: Vec<f32>,
    /// [N].
    look_count: Vec<u32>,
}

impl From<Saved> for Statistics {
    fn from(saved: Saved) -> Self {
        let Saved { per_anchor, gradient_sum, seen_count, opacity_sum, look_count } = saved;
        // Nobody asks how large the Gaussians of anchors are on the screen.
        let row = |(sum, count): (f32, u32)| [sum, count as f32, 0.0];
        let rows: Vec<f32> = gradient_sum.into_iter().zip(seen_count).flat_map(row).collect();
        let look_count = look_count.into_iter().map(|count| count as f32).collect();
        Self { per_anchor, gaussians: rows.into(), opacity_sum: column(opacity_sum), look_count: column(look_count) }
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
            look_count: statistics.look_count.as_slice().iter().map(|count| *count as u32).collect(),
        }
    }
}

impl Default for Statistics {
    fn default() -> Self {
        Saved::default().into()
    }
}

impl Statistics {
    /// Whether nothing was seen yet.
    pub(crate) fn is_empty(&self) -> bool {
        self.look_count.is_empty()
    }

    /// Adds one step's renders, on the device that rendered.
    pub(crate) fn observe(&mut self, stats: &ScreenStats<'_>, per_anchor: usize) {
        self.per_anchor = per_anchor;
        self.resize(stats.rows() / per_anchor);
        self.gaussians.observe(stats);
        self.look(stats);
    }

    /// Adds the looks of one step at anchors; opacities count where any of its renders looked.
    fn look(&mut self, stats: &ScreenStats<'_>) {
        let Some((first, others)) = stats.parents().split_first() else { return };
        let mut tape = Tape::new(first.in_view.device());
        let [mut looks, mut opacity] = [&first.in_view, &first.opacity].map(|tensor| tape.constant(tensor.clone()));
        for Parents { in_view, opacity: of_render } in others {
            let [in_view, of_render] = [in_view, of_render].map(|tensor| tape.constant(tensor.clone()));
            (looks, opacity) = (add(&mut tape, looks, in_view), add(&mut tape, opacity, of_render));
        }
        let sums = [&self.opacity_sum, &self.look_count].map(|tensor| tape.constant(tensor.clone()));
        let opacity_sum = add_where_counted(&mut tape, sums[0], opacity, looks);
        let look_count = add(&mut tape, sums[1], looks);
        [self.opacity_sum, self.look_count] = [opacity_sum, look_count].map(|sum| tape.value(sum).clone());
    }

    /// [N·K] the mean gradient of every Gaussian that was seen in more than `needed` steps.
    pub(crate) fn mean_gradients(&self, needed: f64) -> Vec<Option<f32>> {
        self.gaussians.rows().iter().map(|row| mean(row[GRADIENT_SUM], row[SEEN_COUNT], needed)).collect()
    }

    /// [N] the mean opacity, summed over its Gaussians, of every anchor that more than `needed` renders looked at.
    pub(crate) fn mean_opacities(&self, needed: f64) -> Vec<Option<f32>> {
        let rows = self.opacity_sum.as_slice().iter().zip(self.look_count.as_slice());
        rows.map(|(&sum, &count)| mean(sum, count, needed)).collect()
    }

    /// Starts anew for the Gaussians that [`Statistics::mean_gradients`] judged.
    pub(crate) fn forget_seen(&mut self, needed: f64) {
        self.gaussians.forget_gradients(|row| f64::from(row[SEEN_COUNT]) > needed);
    }

    /// Starts anew for the anchors that [`Statistics::mean_opacities`] judged.
    pub(crate) fn forget_looks(&mut self, needed: f64) {
        for (sum, count) in self.opacity_sum.make_mut().iter_mut().zip(self.look_count.make_mut()) {
            if f64::from(*count) > needed {
                (*sum, *count) = (0.0, 0.0);
            }
        }
    }

    /// Room for so many anchors; new ones were never seen.
    pub(crate) fn resize(&mut self, anchors: usize) {
        self.gaussians.resize(anchors * self.per_anchor);
        for sums in [&mut self.opacity_sum, &mut self.look_count].into_iter().filter(|sums| sums.len() != anchors) {
            let mut values = sums.as_slice().to_vec();
            values.resize(anchors, 0.0);
            *sums = column(values);
        }
    }

    /// Drops the anchors whose flag is false.
    pub(crate) fn keep(&mut self, keep: &[bool]) {
        let of_slots: Vec<bool> = keep.iter().flat_map(|&keep| std::iter::repeat_n(keep, self.per_anchor)).collect();
        self.gaussians.keep(&of_slots);
        for sums in [&mut self.opacity_sum, &mut self.look_count] {
            let kept = sums.as_slice().iter().zip(keep).filter(|(_, keep)| **keep);
            *sums = column(kept.map(|(value, _)| *value).collect());
        }
    }
}

/// The mean of what was counted more than `needed` times.
fn mean(sum: f32, count: f32, needed: f64) -> Option<f32> {
    (f64::from(count) > needed).then(|| sum / count)
}

fn column(values: Vec<f32>) -> Tensor<f32> {
    Tensor::from_vec([values.len(), 1], values)
}
