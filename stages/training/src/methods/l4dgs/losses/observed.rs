//! Token values of renders, depth maps and images.

use scene::{DepthMap, LabelMap};
use shaders::arrays::rows::{concat_columns, divide_rows, reshape};
use shaders::pointwise::{scale, square};
use shaders::rasteriser::Rendered;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::super::tokens::{CELLS, TokenGrid};
use super::weights::covered;
use crate::method::Step;

/// Minimum opacity; below it, features and depth are undetermined.
const MIN_ALPHA: f64 = 1e-3;
/// Number of depth cells per token.
const TOKEN_CELLS: usize = CELLS * CELLS;

shaders::pointwise! {
    /// y = √max(mean of squares − mean², 0), the standard deviation; its gradient at 0 is defined as 0.
    fn deviation(mean, mean_of_squares) -> y {
        let variance = mean_of_squares - mean * mean;
        return sqrt(select(variance, 0.0, variance < 0.0));
    }
    gradients(dy) {
        mean: { return select(0.0, -mean * dy / y, y > 0.0); }
        mean_of_squares: { return select(0.0, 0.5 * dy / y, y > 0.0); }
    }
}

/// Token values of a render.
pub(crate) struct RenderedTokens {
    /// [tokens, features]: mean feature of the visible Gaussians.
    pub features: Option<Var>,
    /// [tokens, CELLS²]: mean depth, in [`depth_unit`].
    pub depth: Option<Var>,
    /// [tokens, 1]: 1 where Gaussians cover the token, otherwise 0.
    pub covered: Var,
    /// [tokens, CELLS²]: 1 where Gaussians cover the cell, otherwise 0.
    pub cells_covered: Var,
}

/// Means over tokens and cells, divided by their blended opacity. Tokens and cells with an opacity of at least
/// `min_alpha` are covered.
pub(crate) fn rendered_tokens<T: Real>(
    step: &mut Step<'_, T>,
    grid: TokenGrid,
    rendered: &Rendered,
    min_alpha: f64,
) -> RenderedTokens {
    let unit = depth_unit(step);
    let tape = &mut *step.tape;
    let &[height, width] = tape.value(rendered.alpha).shape() else { unreachable!("alpha is [H, W]") };
    let alpha_image = reshape(tape, rendered.alpha, [height, width, 1]);
    let alpha = grid.pool(tape, alpha_image);
    let cell_alpha = grid.cells(tape, rendered.alpha);
    let features = rendered.features.map(|features| {
        let pooled = grid.pool(tape, features);
        divide_rows(tape, pooled, alpha, MIN_ALPHA)
    });
    let depth = rendered.depth.map(|depth| {
        let cells = grid.cells(tape, depth);
        let depth_view = divide_rows(tape, cells, cell_alpha, MIN_ALPHA);
        let relative = scale(tape, depth_view, 1.0 / unit);
        reshape(tape, relative, [grid.count(), TOKEN_CELLS])
    });
    let [covered, cells_covered] = [alpha, cell_alpha].map(|alpha| covered(tape, alpha, min_alpha));
    let cells_covered = reshape(tape, cells_covered, [grid.count(), TOKEN_CELLS]);
    RenderedTokens { features, depth, covered, cells_covered }
}

/// The unit of depth, scene units: the range of depths of the visible scene, i.e. half the diagonal of the capture's
/// box, or the size of the scene if the capture has no box. In units of the much larger distance to the cameras,
/// squared errors would vanish.
pub(crate) fn depth_unit<T: Real>(step: &Step<'_, T>) -> f64 {
    let half_diagonal =
        |[low, high]: [[f64; 3]; 2]| 0.5 * (0..3).map(|axis| (high[axis] - low[axis]).powi(2)).sum::<f64>().sqrt();
    step.dataset.capture.bounds_world.map(half_diagonal).filter(|unit| *unit > 0.0).unwrap_or(step.scene.extent)
}

/// The depth map per cell, [tokens, CELLS²] in units of `unit`, and a mask of the cells in which all depths are known.
/// Depths of pixels that are `hidden` behind a moving subject are unknown.
pub(crate) fn depth_cells<T: Real>(
    grid: TokenGrid,
    map: &DepthMap,
    hidden: Option<&LabelMap>,
    unit: f64,
) -> [Tensor<T>; 2] {
    let (height, width) = (map.height as usize, map.width as usize);
    let is_hidden = |pixel: usize| hidden.is_some_and(|hidden| hidden.labels[pixel] != 0);
    let known = |pixel: usize| map.known(pixel).filter(|_| !is_hidden(pixel));
    let known: Vec<Option<f64>> = (0..map.depth_view.len()).map(known).collect();
    let relative = |depth: &Option<f64>| depth.map_or(T::ZERO, |depth| T::from_f64(depth / unit));
    let depth = grid.cell_values(height, width, known.iter().map(relative).collect());
    let holes = known.iter().map(|depth| if depth.is_some() { T::ZERO } else { T::ONE }).collect();
    let holes = grid.cell_values(height, width, holes);
    let is_whole = |&hole: &T| if hole == T::ZERO { T::ONE } else { T::ZERO };
    let known = Tensor::from_vec(holes.shape(), holes.as_slice().iter().map(is_whole).collect());
    [depth, known].map(|cells| cells.reshape([grid.count(), TOKEN_CELLS]))
}

/// [tokens, 6]: mean and standard deviation of the three colours of an image [H, W, 3].
pub(crate) fn color_statistics<T: Real>(tape: &mut Tape<T>, grid: TokenGrid, image: Var) -> Var {
    let squares = square(tape, image);
    let [means, mean_squares] = [image, squares].map(|image| grid.pool(tape, image));
    let deviations = deviation(tape, means, mean_squares);
    concat_columns(tape, &[means, deviations])
}

#[cfg(test)]
mod tests {
    use shaders::check::{TOLERANCE, gradients, noise};
    use shaders::tape::Device;

    use super::*;

    #[test]
    fn deviations_have_the_gradient_of_central_differences() {
        let means = Tensor::from_vec([40], noise(40, 1));
        let squares = Tensor::from_vec([40], noise(40, 2).iter().map(|x| 2.5 + x).collect());
        gradients(|tape, vars| deviation(tape, vars[0], vars[1]), &[means, squares], TOLERANCE).unwrap();
    }

    #[test]
    fn colors_have_their_mean_and_standard_deviation() {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        // Two tokens of two pixels, of which the second has one colour.
        let image = [[0.0, 0.2, 1.0], [1.0, 0.4, 1.0], [0.5, 0.25, 0.0], [0.5, 0.25, 0.0]].concat();
        let image = tape.constant(Tensor::from_vec([1, 4, 3], image));
        let statistics = color_statistics(&mut tape, TokenGrid { rows: 1, columns: 2 }, image);
        let expected = [[0.5, 0.3, 1.0, 0.5, 0.1, 0.0], [0.5, 0.25, 0.0, 0.0, 0.0, 0.0]].concat();
        let found = tape.value(statistics).as_slice();
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-7), "{found:?}");
    }
}
