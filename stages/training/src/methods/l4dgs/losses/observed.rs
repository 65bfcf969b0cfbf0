//! What renders, depth maps and images say about the tokens of the grid.

use scene::DepthMap;
use shaders::pointwise::scale;
use shaders::rows::{divide_rows, reshape};
use shaders::splat::Rendered;
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use super::super::tokens::{CELLS, TokenGrid};
use crate::method::Step;

/// Less opacity than this leaves features and depth undetermined.
const MIN_ALPHA: f64 = 1e-3;
/// Depth cells of one token.
const TOKEN_CELLS: usize = CELLS * CELLS;

/// What a render says about the tokens of the image.
pub struct RenderedTokens {
    /// [tokens, features]: the mean feature of the Gaussians in sight.
    pub features: Option<Var>,
    /// [tokens, CELLS²] in extents of the scene.
    pub depth: Option<Var>,
    /// [tokens]: whether Gaussians cover the token.
    pub covered: Vec<bool>,
    /// [tokens·CELLS²]: whether Gaussians cover the cell.
    pub cells_covered: Vec<bool>,
}

/// Means over tokens and cells, divided by the opacity that they were blended with; covered is what has `min_alpha`.
pub fn rendered_tokens<T: Real>(
    step: &mut Step<'_, T>,
    grid: TokenGrid,
    rendered: &Rendered,
    min_alpha: f64,
) -> RenderedTokens {
    let (tape, extent) = (&mut *step.tape, step.scene.extent);
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
        let relative = scale(tape, depth_view, 1.0 / extent);
        reshape(tape, relative, [grid.count(), TOKEN_CELLS])
    });
    let is_covered = |alpha: &T| alpha.to_f64() >= min_alpha;
    let covered = |alpha: Var| tape.value(alpha).as_slice().iter().map(is_covered).collect();
    RenderedTokens { features, depth, covered: covered(alpha), cells_covered: covered(cell_alpha) }
}

/// [tokens, CELLS²] of a depth map in extents of the scene, and the cells in which all of it is known.
pub fn depth_cells<T: Real>(grid: TokenGrid, map: &DepthMap, extent: f64) -> (Tensor<T>, Vec<bool>) {
    let (height, width) = (map.height as usize, map.width as usize);
    let is_known = |depth: f32| depth > 0.0 && depth.is_finite();
    let relative = |&depth: &f32| T::from_f64(if is_known(depth) { f64::from(depth) / extent } else { 0.0 });
    let depth = grid.cell_values(height, width, map.depth_view.iter().map(relative).collect());
    let holes = map.depth_view.iter().map(|&depth| T::from_f64(f64::from(u8::from(!is_known(depth))))).collect();
    let holes = grid.cell_values(height, width, holes);
    let known = holes.as_slice().iter().map(|&hole| hole == T::ZERO).collect();
    (depth.reshape([grid.count(), TOKEN_CELLS]), known)
}

/// [tokens, 6]: mean and standard deviation of the three colours.
pub fn color_statistics<T: Real>(grid: TokenGrid, image: &Tensor<T>) -> Tensor<T> {
    let mut tape = Tape::new(Device::Cpu);
    let squares = image.as_slice().iter().map(|&value| value * value).collect();
    let [means, squares] = [image.clone(), Tensor::from_vec(image.shape(), squares)].map(|image| {
        let image = tape.constant(image);
        let pooled = grid.pool(&mut tape, image);
        tape.value(pooled).clone()
    });
    let row = |token: usize| {
        let (means, squares) = (means.row(token), squares.row(token));
        let deviation = |channel: usize| (squares[channel] - means[channel] * means[channel]).max(T::ZERO).sqrt();
        [means[0], means[1], means[2], deviation(0), deviation(1), deviation(2)]
    };
    Tensor::from_vec([grid.count(), 6], (0..grid.count()).flat_map(row).collect())
}
