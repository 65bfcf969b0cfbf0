//! Weights of the pixels of a moving subject, with the effect `seed-from-masks`.

use scene::{LabelMap, Mask};
use shaders::losses::l1::l1;
use shaders::pointwise::mul;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::data::TrainingView;
use crate::schedule::WARM_UPS;
use crate::shared::Shared;

/// Per Gaussian, when it is shown (see `bases/seeds`): a model with this tensor has seeds.
pub(crate) const SEED_LIVES: &str = "gaussians.seed_lives";

/// Whether a Gaussian with this row of [`SEED_LIVES`] descends from a seed.
pub(crate) fn is_seed<T: Real>([_, last, _, next, _]: &[T; 5]) -> bool {
    next > last
}

/// Whether a step leaves out the seeds of the drawn view itself: half of all steps do, by the Thue–Morse sequence. Losses
/// and density control that see only every n-th step then see steps of both kinds, equally often if n is a power of two.
pub(super) fn leaves_out_own(iteration: u64) -> bool {
    iteration.count_ones().is_multiple_of(2)
}

/// Share of the image's width by which the moving part is widened before its pixels are hidden, because edges of masks
/// are blurred.
const MARGIN_SHARE: f64 = 0.01;

/// The treatment of a view's moving pixels in a step.
pub(super) enum Attention<T: Real> {
    /// The whole image counts equally.
    Even,
    /// The moving pixels are ignored: [H, W, 3], 0 at moving pixels and 1 elsewhere.
    Hidden(Tensor<T>),
    /// The moving pixels get an additional L1 term: their mask [H, W, 3] (1 at moving pixels, 0 elsewhere), and the
    /// reciprocal of their share of the image, which turns a mean over all pixels into one over the moving pixels.
    Raised(Tensor<T>, f64),
}

/// The treatment of a view's moving pixels with the effect `seed-from-masks`: hidden in a warm-up without seeds;
/// otherwise raised, unless `seeds.weight` is 0 or the mask is empty.
///
/// `moving` is the moving part of the view, and `is_seeded` whether the model has seeds already.
pub(super) fn attention<T: Real>(
    moving: Option<&LabelMap>,
    view: &TrainingView<T>,
    shared: &Shared,
    phase: &str,
    is_seeded: bool,
) -> Attention<T> {
    let Some(moving) = moving.filter(|_| shared.has_seeds()) else { return Attention::Even };
    let mask = Mask::from(moving);
    let tensor = |inside: &[bool], [outside, set]: [T; 2]| {
        let values = inside.iter().flat_map(|&inside| [if inside { set } else { outside }; 3]).collect();
        Tensor::from_vec(view.image.shape(), values)
    };
    if WARM_UPS.contains(&phase) && !is_seeded {
        let margin = (MARGIN_SHARE * f64::from(moving.width)).ceil() as u32;
        return Attention::Hidden(tensor(&mask.dilated(margin).inside, [T::ONE, T::ZERO]));
    }
    let count = mask.count();
    match count > 0 && shared.seeds.weight > 0.0 {
        true => Attention::Raised(tensor(&mask.inside, [T::ZERO, T::ONE]), mask.inside.len() as f64 / count as f64),
        false => Attention::Even,
    }
}

/// Mean |w·render − w·target| over all pixels and channels, shape [1]: pixels of weight 0 add nothing to the sum, but
/// count in its divisor.
pub(super) fn masked_l1<T: Real>(tape: &mut Tape<T>, images: [Var; 2], weights: Tensor<T>) -> Var {
    let weights = tape.constant(weights);
    let [render, target] = images.map(|image| mul(tape, image, weights));
    l1(tape, render, target)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_at_any_interval_show_a_frame_with_and_without_its_own_seeds() {
        let left_out = |interval: u64, first: u64| {
            let steps = (0..1024).map(|at| first + at * interval);
            steps.filter(|&iteration| leaves_out_own(iteration)).count()
        };
        for interval in [1, 2, 4, 8, 16] {
            assert!((0..interval).all(|first| left_out(interval, first) == 512), "every {interval} steps");
        }
        for interval in [3, 5, 6, 7, 10, 12] {
            assert!(
                (0..interval).all(|first| (200..=824).contains(&left_out(interval, first))),
                "every {interval} steps"
            );
        }
    }
}
