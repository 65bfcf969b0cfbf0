//! Prompts to a trained model: the relevancy of every pixel and Gaussian to a prompt.

use anyhow::ensure;
use shaders::arrays::rows::{divide_rows, normalize, reshape};
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Tape, Tensor, Var};

use super::Player;

/// Sharpness of the comparison between prompts (Qin et al. 2024).
const SHARPNESS: f64 = 10.0;
/// Relevancy above which a prompt selects a pixel or Gaussian.
pub(super) const RELEVANT: f32 = 0.5;
/// Minimum opacity of a pixel with a meaning.
const MIN_ALPHA: f64 = 0.5;
/// Minimum norm in the denominator of a cosine.
const MIN_NORM: f64 = 1e-6;

/// The semantic features in a camera's image.
#[derive(Clone, Debug)]
pub struct SemanticImage {
    /// [H, W, features]: the mean over the visible Gaussians, blended like their colours.
    pub features: Tensor<f32>,
    /// [H, W]: opacity; where it is small, the features are meaningless.
    pub alpha: Tensor<f32>,
}

impl Player {
    /// The semantic features at a time of the capture; `None` for a model without them.
    pub fn render_semantics(&self, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<Option<SemanticImage>> {
        let mut tape = self.tape();
        let splats = self.splats(&mut tape, time_secs, camera)?;
        let model = self.state.bind(&mut tape, |_| false);
        let Some(semantics) = self.method.language().and_then(|language| language.semantics(&model)) else {
            return Ok(None);
        };
        let rendered = self.rasterize(&mut tape, &splats, Some(semantics), camera, &self.raster_settings())?;
        let features = rendered.features.expect("features were given");
        let (width, pixels) = (tape.value(features).shape()[2], camera.height * camera.width);
        let by_pixel = reshape(&mut tape, features, [pixels, width]);
        let alpha = reshape(&mut tape, rendered.alpha, [pixels, 1]);
        let mean = divide_rows(&mut tape, by_pixel, alpha, MIN_ALPHA);
        let features = tape.value(mean).clone().reshape([camera.height, camera.width, width]);
        Ok(Some(SemanticImage { features, alpha: tape.value(rendered.alpha).clone() }))
    }

    /// The embeddings [P, E] of the prompts that the model was trained with, if any.
    pub fn prompts(&self) -> Option<Tensor<f32>> {
        let mut tape = self.tape();
        let model = self.state.bind(&mut tape, |_| false);
        let prompts = self.method.language()?.prompts(&model)?;
        Some(tape.value(prompts).clone())
    }

    /// The prompts that the model was trained with, in the order of [`Player::prompts`].
    pub fn prompt_names(&self) -> &[String] {
        &self.prompt_names
    }

    /// The relevancy [H, W, P] in [0, 1] of each pixel to each prompt [P, E] among all of them (0 where nothing is
    /// visible): the smallest softmax of the prompt against one other, as in LangSplat (Qin et al. 2024). `None` for a
    /// model that cannot compare its features with prompts.
    pub fn prompt_relevancy(
        &self,
        time_secs: f64,
        camera: &PinholeCamera,
        prompts: &Tensor<f32>,
    ) -> anyhow::Result<Option<Tensor<f32>>> {
        match self.render_semantics(time_secs, camera)? {
            Some(image) => self.image_relevancy(&image, prompts),
            None => Ok(None),
        }
    }

    /// [`Player::prompt_relevancy`] of the pixels of an image.
    pub fn image_relevancy(
        &self,
        SemanticImage { features, alpha }: &SemanticImage,
        prompts: &Tensor<f32>,
    ) -> anyhow::Result<Option<Tensor<f32>>> {
        let [height, width, channels] = [0, 1, 2].map(|axis| features.shape()[axis]);
        let mut tape = self.tape();
        let features = tape.constant(features.clone().reshape([height * width, channels]));
        let Some(cosines) = self.cosines(&mut tape, features, prompts)? else { return Ok(None) };
        let rows = cosines.chunks_exact(prompts.rows()).zip(alpha.as_slice());
        let relevancy = rows.flat_map(|(cosines, &alpha)| {
            let seen = f64::from(alpha) >= MIN_ALPHA;
            relevancies(cosines).into_iter().map(move |value| if seen { value } else { 0.0 })
        });
        Ok(Some(Tensor::from_vec([height, width, prompts.rows()], relevancy.collect())))
    }

    /// The relevancy of each Gaussian to each prompt, N·P values row by row, defined as for pixels
    /// ([`Player::prompt_relevancy`]).
    pub fn gaussian_relevancy(&self, prompts: &Tensor<f32>) -> anyhow::Result<Option<Vec<f32>>> {
        let mut tape = self.tape();
        let model = self.state.bind(&mut tape, |_| false);
        let Some(semantics) = self.method.language().and_then(|language| language.semantics(&model)) else {
            return Ok(None);
        };
        let cosines = self.cosines(&mut tape, semantics, prompts)?;
        Ok(cosines.map(|cosines| cosines.chunks_exact(prompts.rows()).flat_map(relevancies).collect()))
    }

    /// Cosines between decoded semantic features [M, features] and prompts [P, E], M·P values row by row.
    fn cosines(&self, tape: &mut Tape<f32>, features: Var, prompts: &Tensor<f32>) -> anyhow::Result<Option<Vec<f32>>> {
        let model = self.state.bind(tape, |_| false);
        let Some(meaning) = self.method.language().and_then(|words| words.meaning(tape, &model, features)) else {
            return Ok(None);
        };
        let (found, given) = (tape.value(meaning).row_len(), prompts.row_len());
        ensure!(found == given, "prompts have {given} dimensions, the model was trained with {found}");
        Ok(Some(cosines(tape, meaning, prompts)))
    }
}

/// Cosines of every row of x [M, E] with every prompt [P, E]: M·P values, row by row.
fn cosines(tape: &mut Tape<f32>, x: Var, prompts: &Tensor<f32>) -> Vec<f32> {
    let x = normalize(tape, x, MIN_NORM);
    let prompts = tape.constant(prompts.clone());
    let prompts = normalize(tape, prompts, MIN_NORM);
    let (x, prompts) = (tape.value(x), tape.value(prompts));
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
    (0..x.rows()).flat_map(|row| (0..prompts.rows()).map(move |prompt| dot(x.row(row), prompts.row(prompt)))).collect()
}

/// Minimum over the other prompts of softmax(10·[cos, cos of the other]); a single prompt competes with a cosine of 0.
fn relevancies(cosines: &[f32]) -> Vec<f32> {
    let relevancy = |at: usize| {
        let others = cosines.iter().enumerate().filter(|(other, _)| *other != at).map(|(_, &cosine)| cosine);
        let nearest = others.reduce(f32::max).unwrap_or(0.0);
        (1.0 / (1.0 + (SHARPNESS * f64::from(nearest - cosines[at])).exp())) as f32
    };
    (0..cosines.len()).map(relevancy).collect()
}

#[cfg(test)]
mod tests {
    use shaders::tape::Device;

    use super::*;

    #[test]
    fn the_nearest_prompt_is_the_relevant_one() {
        let found = relevancies(&[0.9, 0.1, 0.2]);
        assert!(found[0] > 0.99 && found[1] < 0.01 && found[2] < 0.01, "{found:?}");
        assert_eq!(relevancies(&[0.4, 0.4]), [0.5, 0.5]);
        assert!(relevancies(&[0.5])[0] > 0.99 && relevancies(&[-0.5])[0] < 0.01);
    }

    #[test]
    fn cosines_do_not_depend_on_lengths() {
        let mut tape = Tape::new(Device::Cpu);
        let x = tape.constant(Tensor::from_vec([2, 2], vec![5.0, 0.0, 0.0, 0.0]));
        let found = cosines(&mut tape, x, &Tensor::from_vec([2, 2], vec![0.1, 0.0, 3.0, 3.0]));
        for (found, expected) in found.iter().zip([1.0, 0.5_f32.sqrt(), 0.0, 0.0]) {
            assert!((found - expected).abs() <= 1e-6, "{found} instead of {expected}");
        }
    }
}
