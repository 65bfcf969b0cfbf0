//! The grid of tokens that divides an image.

use shaders::arrays::rows::{RowIndex, gather, reshape};
use shaders::networks::pooling::average_pool;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::settings::TeacherSettings;

/// Cells along each side of a token. A token's depth is the vector of its cells' depths, and the teacher's input image
/// has one pixel per cell.
pub(crate) const CELLS: usize = 4;

/// Rows and columns of tokens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TokenGrid {
    pub rows: usize,
    pub columns: usize,
}

impl TokenGrid {
    /// The grid for an image [height, width], with tokens as square as its shape allows.
    pub(crate) fn of_image(height: usize, width: usize, settings: &TeacherSettings) -> Self {
        let longer = height.max(width);
        let along_longer = (longer / settings.pixels_per_token).clamp(1, settings.tokens_per_side);
        let along = |pixels: usize| ((2 * pixels * along_longer + longer) / (2 * longer)).max(1);
        Self { rows: along(height), columns: along(width) }
    }

    /// The factor by which an image [height, width] may be reduced for values of tokens and cells: every cell keeps at
    /// least one pixel, as in the teacher's input. 1 for small images.
    pub(crate) fn reduction(&self, height: usize, width: usize) -> usize {
        let along = |pixels: usize, tokens: usize| pixels / (CELLS * tokens);
        along(height, self.rows).min(along(width, self.columns)).max(1)
    }

    /// Total number of tokens.
    pub(crate) fn count(&self) -> usize {
        self.rows * self.columns
    }

    /// [tokens, C]: the mean of an image [H, W, C] over each token.
    pub(crate) fn pool<T: Real>(&self, tape: &mut Tape<T>, image: Var) -> Var {
        let channels = tape.value(image).shape()[2];
        let pooled = average_pool(tape, image, self.rows, self.columns);
        reshape(tape, pooled, [self.count(), channels])
    }

    /// The image at one pixel per cell, [CELLS·rows, CELLS·columns, C].
    pub(crate) fn cell_image<T: Real>(&self, tape: &mut Tape<T>, image: Var) -> Var {
        average_pool(tape, image, CELLS * self.rows, CELLS * self.columns)
    }

    /// [tokens·CELLS², 1]: the mean of a map [H, W] over each cell, token by token.
    pub(crate) fn cells<T: Real>(&self, tape: &mut Tape<T>, map: Var) -> Var {
        let &[height, width] = tape.value(map).shape() else { panic!("a map of cells must be [H, W]") };
        let map = reshape(tape, map, [height, width, 1]);
        let pooled = self.cell_image(tape, map);
        let by_row = reshape(tape, pooled, [self.count() * CELLS * CELLS, 1]);
        gather(tape, by_row, &self.cell_order())
    }

    /// Means of values [H, W] over each cell, token by token: [tokens·CELLS²]. The same reduction as
    /// [`TokenGrid::cells`], for values outside a tape.
    pub(crate) fn cell_values<T: Real>(&self, height: usize, width: usize, values: Vec<T>) -> Tensor<T> {
        let mut tape = Tape::new(shaders::tape::Device::Cpu);
        let map = tape.constant(Tensor::from_vec([height, width], values));
        let cells = self.cells(&mut tape, map);
        tape.value(cells).clone()
    }

    /// Index in the cell image of every cell, in token order.
    fn cell_order(&self) -> RowIndex {
        let columns = CELLS * self.columns;
        let cell = |token: usize, at: usize| {
            let (row, column) = (token / self.columns * CELLS + at / CELLS, token % self.columns * CELLS + at % CELLS);
            (row * columns + column) as u32
        };
        let order = (0..self.count()).flat_map(|token| (0..CELLS * CELLS).map(move |at| cell(token, at))).collect();
        RowIndex::new(order, self.count() * CELLS * CELLS)
    }
}
