//! Views on random backgrounds: if a capture knows the coverage of its images, a render must be transparent in empty
//! places, because no colour of Gaussians can equal a background that changes with every step.

use rand::RngExt as _;
use shaders::arrays::rows::reshape;
use shaders::networks::linear::{Activation, linear};
use shaders::pointwise::add;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::data::{TrainingView, area_means};
use crate::method::Step;
use crate::shared::MAX_REDUCTION;

/// Names of the cached tensors, by reduction factor of the view.
const UNCOVERED: [&str; MAX_REDUCTION + 1] = [
    "",
    "uncovered",
    "uncovered/2",
    "uncovered/3",
    "uncovered/4",
    "uncovered/5",
    "uncovered/6",
    "uncovered/7",
    "uncovered/8",
];

/// A view on another background.
pub(crate) struct Recomposed {
    /// The new background.
    pub background: [f32; 3],
    /// The image [H, W, 3] on it.
    pub image: Var,
}

/// Composites a view on a random background; `None` if the capture does not know the coverage of the view.
pub(crate) fn recomposed<T: Real>(
    step: &mut Step<'_, T>,
    view: &TrainingView<T>,
) -> anyhow::Result<Option<Recomposed>> {
    let Some(uncovered) = uncovered(step, view)? else { return Ok(None) };
    let random = step.random.of("background");
    let background = [0.0; 3].map(|_: f32| random.random::<f32>());
    let image = on_background(step.tape, &view.image, uncovered, [step.scene.background, background]);
    Ok(Some(Recomposed { background, image }))
}

/// An image [H, W, 3] on the second of two backgrounds instead of the first one.
fn on_background<T: Real>(
    tape: &mut Tape<T>,
    image: &Tensor<T>,
    uncovered: Tensor<T>,
    [before, after]: [[f32; 3]; 2],
) -> Var {
    let change = [0, 1, 2].map(|channel| T::from_f64(f64::from(after[channel]) - f64::from(before[channel])));
    let [weight, bias] = [Tensor::from_vec([3, 1], change.to_vec()), Tensor::zeros([3])].map(|x| tape.constant(x));
    let (uncovered, image) = (tape.constant(uncovered), tape.constant(image.clone()));
    let change = linear(tape, uncovered, weight, bias, Activation::Identity);
    let shape = tape.value(image).shape().to_vec();
    let change = reshape(tape, change, shape);
    add(tape, image, change)
}

/// 1 − coverage of every pixel: [H·W, 1].
fn uncovered<T: Real>(step: &Step<'_, T>, view: &TrainingView<T>) -> anyhow::Result<Option<Tensor<T>>> {
    if let Some(kept) = step.constants.kept(UNCOVERED[view.reduction], view.index) {
        return Ok(Some(kept));
    }
    let capture = &step.dataset.capture;
    let Some(coverage) = capture.load_alpha(&capture.views[view.index])? else { return Ok(None) };
    let uncovered = |level: f64| T::from_f64(1.0 - level);
    let values: Vec<T> = if view.reduction == 1 {
        coverage.as_raw().iter().map(|&level| uncovered(f64::from(level) / 255.0)).collect()
    } else {
        let size = [coverage.width() as usize, coverage.height() as usize];
        let means = area_means(coverage.as_raw(), 1, size, [view.camera.width, view.camera.height]);
        means.into_iter().map(|level| uncovered(f64::from(level))).collect()
    };
    let tensor = Tensor::from_vec([values.len(), 1], values).moved_to(step.tape.device());
    step.constants.keep(UNCOVERED[view.reduction], view.index, &tensor);
    Ok(Some(tensor))
}

#[cfg(test)]
mod tests {
    use shaders::tape::Device;

    use super::*;

    #[test]
    fn only_what_is_not_covered_changes_its_colour() {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        // One pixel each of an object, of the black background and of half of both.
        let image = Tensor::from_vec([1, 3, 3], [[0.2, 0.4, 0.6], [0.0; 3], [0.1, 0.2, 0.3]].concat());
        let uncovered = Tensor::from_vec([3, 1], vec![0.0, 1.0, 0.5]);
        let recomposed = on_background(&mut tape, &image, uncovered, [[0.0; 3], [1.0, 0.5, 0.0]]);
        let expected = [[0.2, 0.4, 0.6], [1.0, 0.5, 0.0], [0.6, 0.45, 0.3]].concat();
        let close = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-7;
        assert!(tape.value(recomposed).as_slice().iter().zip(&expected).all(close));
    }
}
