//! Measurements of every Gaussian over renders of several training views, for hooks that request them.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use shaders::rasteriser::{self, HIDDEN_LOGIT};
use shaders::tape::{Tape, Tensor};

use super::Trainer;
use crate::data::reduced_camera;
use crate::method::{Survey, raster_settings, too_large};

impl Trainer<'_> {
    /// Measures all Gaussians on sampled training views. Returns one value per row: the sum of
    /// [`Trainer::squared_gradients`] over the views at whose times the Gaussian is not hidden. The value is infinite
    /// for a Gaussian that is hidden in all of them, e.g. a seed of another frame, because nothing was measured.
    pub(super) fn survey(&self, survey: Survey) -> anyhow::Result<Vec<f32>> {
        let mut random = self.setup.streams().step(self.phase_name(), self.state.iteration);
        let random = random.of("survey");
        let Survey::Sensitivity { views } = survey;
        let mut sums: Vec<Option<f32>> = Vec::new();
        for view in self.survey_views(views, random) {
            let of_view = self.squared_gradients(view, random)?;
            sums.resize(of_view.len(), None);
            let add = |(sum, value): (&mut Option<f32>, Option<f32>)| {
                *sum = value.map(|value| value + sum.unwrap_or(0.0)).or(*sum);
            };
            sums.iter_mut().zip(of_view).for_each(add);
        }
        Ok(sums.into_iter().map(|sum| sum.unwrap_or(f32::INFINITY)).collect())
    }

    /// `count` training views evenly over time, from a random first one.
    fn survey_views(&self, count: usize, random: &mut ChaCha8Rng) -> Vec<usize> {
        let train = &self.setup.start.dataset.train;
        let mut by_time: Vec<usize> = (0..train.len()).collect();
        by_time.sort_by(|&a, &b| train[a].time.total_cmp(&train[b].time).then(a.cmp(&b)));
        let (all, count) = (train.len(), count.min(train.len()));
        let first = random.random_range(0..all as u64) as usize;
        (0..count).map(|at| by_time[(first + at * all / count) % all]).collect()
    }

    /// Per Gaussian, an unbiased estimate of Σ (∂I/∂g)² over the values I of a view's render, with respect to a factor
    /// g on its opacity: the square of the gradient of Σ z·I, where every z is ±1 at random. `None` for a Gaussian that
    /// is hidden at the time of the view.
    pub(super) fn squared_gradients(&self, index: usize, random: &mut ChaCha8Rng) -> anyhow::Result<Vec<Option<f32>>> {
        let scene = self.setup.start.scene();
        let view = &self.setup.start.dataset.train[index];
        let reduction = self.setup.detail(self.steps().0).map_or(1, |detail| detail.reduction);
        let camera = reduced_camera(&view.camera, reduction);
        let mut tape = Tape::new(self.device);
        let moment = self.moment(view.time, &camera);
        let mut splats = self.splats(&mut tape, &moment)?;
        let logits = tape.value(splats.opacity_logits).clone();
        splats.opacity_logits = tape.leaf(logits.clone());
        let settings = raster_settings(scene, self.state.sh_degree);
        let rendered = rasteriser::render(&mut tape, &splats, None, &camera, &settings).map_err(too_large)?;
        let signs = signs([camera.height, camera.width, 3], random).moved_to(self.device);
        let gradients = tape.backward(&[(rendered.color, signs)]);
        let by_logit = gradients.get(splats.opacity_logits).cloned().unwrap_or_else(|| Tensor::zeros(logits.shape()));
        // With respect to the factor g on the opacity o instead of its logit: ∂/∂g = ∂/∂logit / (1 − o).
        let square = |(by_logit, logit): (&f32, &f32)| (by_logit * (1.0 + logit.exp())).powi(2);
        let shown = |pair: (&f32, &f32)| (*pair.1 != HIDDEN_LOGIT as f32).then(|| square(pair));
        Ok(by_logit.as_slice().iter().zip(logits.as_slice()).map(shown).collect())
    }
}

/// ±1 with equal probability.
fn signs(shape: [usize; 3], random: &mut ChaCha8Rng) -> Tensor<f32> {
    let count = shape.iter().product::<usize>();
    let bits: Vec<u64> = (0..count.div_ceil(64)).map(|_| random.random()).collect();
    let sign = |at: usize| if bits[at / 64] >> (at % 64) & 1 == 1 { 1.0 } else { -1.0 };
    Tensor::from_vec(shape, (0..count).map(sign).collect())
}
