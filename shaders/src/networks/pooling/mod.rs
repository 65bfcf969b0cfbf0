//! Area-average pooling of an image [H, W, C] to a grid [rows, columns, C].
//!
//! Cell (i, j) is the mean over [i·H/rows, (i + 1)·H/rows) × [j·W/columns, (j + 1)·W/columns) of the image as a piecewise
//! constant function: a pixel on the border of two cells contributes to each by its area. Every pixel has the same
//! total weight, so the mean of the cells is the mean of the image. A grid finer than the image repeats pixels.

mod gpu;
#[cfg(test)]
mod tests;

use std::ops::Range;

use rayon::prelude::*;

use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// The mean of every cell, [rows, columns, C], of an image [H, W, C].
pub fn average_pool<T: Real>(tape: &mut Tape<T>, image: Var, rows: usize, columns: usize) -> Var {
    let &[height, width, channels] = tape.value(image).shape() else {
        panic!("average_pool: the image must be [H, W, C], not {:?}", tape.value(image).shape())
    };
    assert!(rows > 0 && columns > 0, "average_pool: a grid without cells");
    assert!(height > 0 && width > 0, "average_pool: an image without pixels");
    let (vertical, horizontal) = (Axis { pixels: height, cells: rows }, Axis { pixels: width, cells: columns });
    tape.apply_one(AveragePool { vertical, horizontal, channels }, &[image])
}

/// One axis of the grid.
#[derive(Copy, Clone)]
struct Axis {
    pixels: usize,
    cells: usize,
}

impl Axis {
    /// The pixels that a cell touches. In units of 1/(pixels·cells) of the axis, cells are `pixels` and pixels `cells` long.
    fn pixels_of(&self, cell: usize) -> Range<usize> {
        cell * self.pixels / self.cells..((cell + 1) * self.pixels).div_ceil(self.cells)
    }

    /// The cells that touch a pixel.
    fn cells_of(&self, pixel: usize) -> Range<usize> {
        pixel * self.cells / self.pixels..((pixel + 1) * self.cells).div_ceil(self.pixels)
    }

    /// The share of a cell's length that a pixel covers.
    fn weight<T: Real>(&self, cell: usize, pixel: usize) -> T {
        let start = (cell * self.pixels).max(pixel * self.cells);
        let end = ((cell + 1) * self.pixels).min((pixel + 1) * self.cells);
        T::from_f64((end - start) as f64 / self.pixels as f64)
    }

    /// For every cell, the pixels that it touches and their weights.
    fn by_cell<T: Real>(&self) -> Vec<Vec<(usize, T)>> {
        let of = |cell| self.pixels_of(cell).map(|pixel| (pixel, self.weight(cell, pixel))).collect();
        (0..self.cells).map(of).collect()
    }

    /// For every pixel, the cells that touch it and its weights.
    fn by_pixel<T: Real>(&self) -> Vec<Vec<(usize, T)>> {
        let of = |pixel| self.cells_of(pixel).map(|cell| (cell, self.weight(cell, pixel))).collect();
        (0..self.pixels).map(of).collect()
    }
}

struct AveragePool {
    vertical: Axis,
    horizontal: Axis,
    channels: usize,
}

impl<T: Real> Op<T> for AveragePool {
    fn name(&self) -> &'static str {
        "average_pool"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let Self { vertical, horizontal, channels } = *self;
        let grid = weighted_sums(
            &vertical.by_cell(),
            &horizontal.by_cell(),
            inputs[0].as_slice(),
            horizontal.pixels,
            channels,
        );
        vec![Tensor::from_vec([vertical.cells, horizontal.cells, channels], grid)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Self { vertical, horizontal, channels } = *self;
        let dgrid = pass.dy().as_slice();
        let dimage = weighted_sums(&vertical.by_pixel(), &horizontal.by_pixel(), dgrid, horizontal.cells, channels);
        vec![Some(Tensor::from_vec(pass.inputs[0].shape(), dimage))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for AveragePool {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.pool_on_gpu(gpu, inputs[0])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(self.backward_on_gpu(gpu, pass.inputs[0], pass.dy()))]
    }
}

/// An image of weighted sums over pixels of `source`, whose rows have `width` pixels. `rows` and `columns` list, for every row
/// and column of the result, those of the source and their weights.
fn weighted_sums<T: Real>(
    rows: &[Vec<(usize, T)>],
    columns: &[Vec<(usize, T)>],
    source: &[T],
    width: usize,
    channels: usize,
) -> Vec<T> {
    let mut sums = vec![T::ZERO; rows.len() * columns.len() * channels];
    sums.par_chunks_mut(columns.len() * channels).zip(rows).for_each(|(sums, row)| {
        for (sum, column) in sums.chunks_exact_mut(channels).zip(columns) {
            for &(y, of_row) in row {
                for &(x, of_column) in column {
                    add_scaled(sum, &source[(y * width + x) * channels..][..channels], of_row * of_column);
                }
            }
        }
    });
    sums
}

/// total += weight·term
fn add_scaled<T: Real>(total: &mut [T], term: &[T], weight: T) {
    total.iter_mut().zip(term).for_each(|(total, &term)| *total += weight * term);
}
