//! Measurements of every Gaussian over renders of several training views, for hooks that request them.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use shaders::losses::l1::l1_dssim;
use shaders::rasteriser::{self, HIDDEN_LOGIT};
use shaders::tape::{Tape, Tensor};

use super::Trainer;
use crate::data::{LoadedView, reduced_camera};
use crate::method::{Survey, raster_settings, too_large};

impl Trainer<'_> {
    /// Measures all Gaussians on sampled training views. Returns one value per row: the sum of
    /// [`Trainer::squared_gradients`], or the mean of [`Trainer::high_errors`], over the views at whose times the Gaussian
    /// is not hidden. The value is infinite for a Gaussian that is hidden in all of them, e.g. a seed of another frame,
    /// because nothing was measured.
    pub(super) fn survey(&self, survey: Survey) -> anyhow::Result<Vec<f32>> {
        let mut random = self.setup.streams().step(self.phase_name(), self.state.iteration);
        let random = random.of("survey");
        let (Survey::Sensitivity { views } | Survey::HighError { views, .. }) = survey;
        let mut totals: Vec<(f32, u32)> = Vec::new();
        for index in self.survey_views(views, random) {
            let view = &self.setup.start.dataset.train[index];
            let of_view = match survey {
                Survey::Sensitivity { .. } => self.squared_gradients(view, random)?,
                Survey::HighError { above, by_loss, .. } => self.high_errors(view, above, by_loss)?,
            };
            totals.resize(of_view.len(), (0.0, 0));
            let shown = totals.iter_mut().zip(of_view).filter_map(|(total, value)| Some((total, value?)));
            shown.for_each(|((sum, count), value)| (*sum, *count) = (*sum + value, *count + 1));
        }
        let value = |(sum, count): (f32, u32)| match (count, survey) {
            (0, _) => f32::INFINITY,
            (_, Survey::Sensitivity { .. }) => sum,
            (count, Survey::HighError { .. }) => sum / count as f32,
        };
        Ok(totals.into_iter().map(value).collect())
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
    pub(super) fn squared_gradients(
        &self,
        view: &LoadedView,
        random: &mut ChaCha8Rng,
    ) -> anyhow::Result<Vec<Option<f32>>> {
        let camera = reduced_camera(&view.camera, self.reduction());
        let mut tape = Tape::new(self.device);
        let moment = self.moment(view.time, &camera);
        let mut splats = self.splats(&mut tape, &moment)?;
        let logits = tape.value(splats.opacity_logits).clone();
        splats.opacity_logits = tape.leaf(logits.clone());
        let settings = raster_settings(moment.scene, self.state.sh_degree);
        let rendered = rasteriser::render(&mut tape, &splats, None, &camera, &settings).map_err(too_large)?;
        let signs = signs([camera.height, camera.width, 3], random).moved_to(self.device);
        let gradients = tape.backward(&[(rendered.color, signs)]);
        let by_logit = gradients.get(splats.opacity_logits).cloned().unwrap_or_else(|| Tensor::zeros(logits.shape()));
        // With respect to the factor g on the opacity o instead of its logit: ∂/∂g = ∂/∂logit / (1 − o).
        let square = |(by_logit, logit): (&f32, &f32)| (by_logit * (1.0 + logit.exp())).powi(2);
        let shown = |pair: (&f32, &f32)| (*pair.1 != HIDDEN_LOGIT as f32).then(|| square(pair));
        Ok(by_logit.as_slice().iter().zip(logits.as_slice()).map(shown).collect())
    }

    /// Per Gaussian, the sum of its weights in the pixels of a view whose error is high ([`Survey::HighError`]), px; with
    /// `by_loss`, times the photometric loss of the view. `None` for a Gaussian that is hidden at the time of the view.
    /// (Ren et al. 2025 count the pixels that a Gaussian covers. A sum of weights leaves out those in which others hide it.)
    pub(super) fn high_errors(&self, view: &LoadedView, above: f64, by_loss: bool) -> anyhow::Result<Vec<Option<f32>>> {
        let camera = reduced_camera(&view.camera, self.reduction());
        let image = view.image_reduced_by(self.reduction());
        let mut tape = Tape::new(self.device);
        let moment = self.moment(view.time, &camera);
        let splats = self.splats(&mut tape, &moment)?;
        let logits = tape.value(splats.opacity_logits).clone();
        let count = logits.rows();
        // The gradient of Σ m·F over the pixels, for a feature F = 1 of every Gaussian, is the sum of its weights where m is 1.
        let ones = tape.leaf(Tensor::full([count, 1], 1.0).moved_to(self.device));
        let settings = raster_settings(moment.scene, self.state.sh_degree);
        let rendered = rasteriser::render(&mut tape, &splats, Some(ones), &camera, &settings).map_err(too_large)?;
        let factor = if by_loss {
            let target = tape.constant(image.clone().moved_to(self.device));
            let loss = l1_dssim(&mut tape, rendered.color, target, self.setup.params.shared.loss.lambda_dssim);
            tape.value(loss).as_slice()[0]
        } else {
            1.0
        };
        let is_high = high_error_mask(tape.value(rendered.color), &image, above).moved_to(self.device);
        let weights = rendered.features.expect("features were given");
        let sums = tape.backward(&[(weights, is_high)]).take(ones).unwrap_or_else(|| Tensor::zeros([count, 1]));
        let shown = |(sum, logit): (&f32, &f32)| (*logit != HIDDEN_LOGIT as f32).then_some(factor * sum);
        Ok(sums.as_slice().iter().zip(logits.as_slice()).map(shown).collect())
    }
}

/// [H, W, 1]: 1 where the error |render − image|, mean over the channels, is above the share `above` of the way from its
/// smallest to its largest value; 0 everywhere if all errors are equal.
fn high_error_mask(render: &Tensor<f32>, image: &Tensor<f32>, above: f64) -> Tensor<f32> {
    let pixels = render.as_slice().as_chunks::<3>().0.iter().zip(image.as_slice().as_chunks::<3>().0);
    let error = |(render, image): (&[f32; 3], &[f32; 3])| {
        render.iter().zip(image).map(|(render, image)| (render - image).abs()).sum::<f32>() / 3.0
    };
    let errors: Vec<f32> = pixels.map(error).collect();
    let min = errors.iter().copied().fold(f32::INFINITY, f32::min);
    let max = errors.iter().copied().fold(0.0, f32::max);
    let limit = min + above as f32 * (max - min);
    let shape = [render.shape()[0], render.shape()[1], 1];
    Tensor::from_vec(shape, errors.into_iter().map(|error| f32::from(u8::from(error > limit))).collect())
}

/// ±1 with equal probability.
fn signs(shape: [usize; 3], random: &mut ChaCha8Rng) -> Tensor<f32> {
    let count = shape.iter().product::<usize>();
    let bits: Vec<u64> = (0..count.div_ceil(64)).map(|_| random.random()).collect();
    let sign = |at: usize| if bits[at / 64] >> (at % 64) & 1 == 1 { 1.0 } else { -1.0 };
    Tensor::from_vec(shape, (0..count).map(sign).collect())
}
