//! Statistics of Gaussians over the renders since the last round of density control.

use serde::{Deserialize, Serialize};
use shaders::rasteriser::screen::{COLUMNS, StepGradient};
use shaders::tape::Tensor;

use crate::method::{ScreenGradients, ScreenStats};

/// Sums per Gaussian since the last round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Vec<f32>", into = "Vec<f32>")]
pub(crate) struct Statistics {
    /// [N, 3] from [`shaders::rasteriser::screen::observe`]: the sum of the gradients' norms, the number of steps in
    /// which the Gaussian is visible, and its largest radius in pixels.
    rows: Tensor<f32>,
}

/// Column of the sum of the gradients' norms.
pub(crate) const GRADIENT_SUM: usize = 0;
/// Column of the number of steps in which the Gaussian is visible.
pub(crate) const SEEN_COUNT: usize = 1;
/// Column of the largest radius in pixels.
pub(crate) const RADIUS_PX: usize = 2;

impl Default for Statistics {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl From<Vec<f32>> for Statistics {
    fn from(values: Vec<f32>) -> Self {
        Self { rows: Tensor::from_vec([values.len() / COLUMNS, COLUMNS], values) }
    }
}

impl From<Statistics> for Vec<f32> {
    fn from(statistics: Statistics) -> Self {
        statistics.rows.into_vec()
    }
}

impl Statistics {
    /// The statistics of each Gaussian, on the host.
    pub(crate) fn rows(&self) -> &[[f32; COLUMNS]] {
        self.rows.as_slice().as_chunks().0
    }

    /// Adds the renders of one step with the gradient of their sum, on the GPU that rendered them if there is one.
    pub(crate) fn observe(&mut self, stats: &ScreenStats<'_>) {
        self.observe_gradient(stats, StepGradient::OfSum);
    }

    /// Adds the renders of one step, on the GPU that rendered them if there is one.
    pub(crate) fn observe_gradient(&mut self, stats: &ScreenStats<'_>, gradient: StepGradient) {
        self.resize(stats.rows());
        match (stats.observe_on_gpu(gradient, &self.rows), gradient) {
            (Some(rows), _) => self.rows = rows,
            (None, StepGradient::OfSum) => self.add(stats.on_host()),
            (None, StepGradient::MeanOverViews) => self.add_mean(stats.by_view()),
        }
    }

    /// Resizes to a number of Gaussians; new ones have no statistics.
    pub(crate) fn resize(&mut self, count: usize) {
        if self.rows.rows() != count {
            let mut values = std::mem::take(self).rows.into_vec();
            values.resize(COLUMNS * count, 0.0);
            *self = values.into();
        }
    }

    /// Adds the renders of one step on the host.
    fn add(&mut self, screen: &ScreenGradients) {
        let rows = self.rows.make_mut().as_chunks_mut::<COLUMNS>().0;
        for (at, row) in rows.iter_mut().enumerate().filter(|(at, _)| screen.visible[*at]) {
            let [x, y] = screen.gradient_ndc[at];
            row[GRADIENT_SUM] += (x * x + y * y).sqrt();
            row[SEEN_COUNT] += 1.0;
            row[RADIUS_PX] = row[RADIUS_PX].max(screen.radius_px[at]);
        }
    }

    /// Adds the renders of one step on the host: gradients by [`StepGradient::MeanOverViews`].
    fn add_mean(&mut self, views: &[ScreenGradients]) {
        let rows = self.rows.make_mut().as_chunks_mut::<COLUMNS>().0;
        for (at, row) in rows.iter_mut().enumerate() {
            let (mut norms, mut shown) = (0.0, 0.0);
            for view in views.iter().filter(|view| view.visible[at]) {
                let [x, y] = view.gradient_ndc[at];
                norms += (x * x + y * y).sqrt();
                shown += 1.0_f32;
                row[RADIUS_PX] = row[RADIUS_PX].max(view.radius_px[at]);
            }
            row[GRADIENT_SUM] += norms * views.len() as f32 / shown.max(1.0);
            row[SEEN_COUNT] += shown.min(1.0);
        }
    }

    /// Removes the Gaussians whose flag is false.
    pub(crate) fn keep(&mut self, keep: &[bool]) {
        self.resize(keep.len());
        let kept = self.rows().iter().zip(keep).filter(|(_, keep)| **keep).flat_map(|(row, _)| row);
        *self = kept.copied().collect::<Vec<f32>>().into();
    }

    /// Resets gradient sum and step count of the Gaussians whose index and row satisfy `is_reset`.
    pub(crate) fn reset_gradients(&mut self, is_reset: impl Fn(usize, &[f32; COLUMNS]) -> bool) {
        let rows = self.rows.make_mut().as_chunks_mut::<COLUMNS>().0;
        for (_, row) in rows.iter_mut().enumerate().filter(|(at, row)| is_reset(*at, row)) {
            (row[GRADIENT_SUM], row[SEEN_COUNT]) = (0.0, 0.0);
        }
    }
}
