//! Positional encoding: every coordinate as sines and cosines of doubling frequency (Mildenhall et al. 2020, eq. 4).

#[cfg(test)]
mod tests;

use crate::arrays::rows::{RowMap, RowWgsl, map_rows};
use crate::tape::{Real, Tape, Var};

/// Bands up to which a GPU represents the frequencies as whole numbers.
const MOST_BANDS: usize = 32;

/// Which frequencies, and whether the coordinates themselves come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PositionalEncoding {
    /// Frequencies 2⁰ … 2^(bands − 1), without the factor π of the paper, as in its code and its successors.
    pub bands: usize,
    /// Whether x precedes the sines and cosines.
    pub with_input: bool,
}

impl PositionalEncoding {
    /// Columns of the encoding of that many coordinates.
    pub fn columns(&self, coordinates: usize) -> usize {
        coordinates * (2 * self.bands + usize::from(self.with_input))
    }

    /// x [N, C] → [N, columns(C)]: x, sin x, cos x, sin 2x, cos 2x, sin 4x, …, each of C columns.
    pub fn encode<T: Real>(self, tape: &mut Tape<T>, x: Var) -> Var {
        map_rows(tape, self, [x])
    }

    /// Band `band` as its frequency and the columns of its sines and cosines.
    fn band<T: Real>(&self, band: usize, coordinates: usize) -> (T, usize, usize) {
        let sines = coordinates * (2 * band + usize::from(self.with_input));
        (T::from_f64(2.0).powi(band as i32), sines, sines + coordinates)
    }
}

impl RowMap<1> for PositionalEncoding {
    const NAME: &'static str = "positional_encoding";

    fn output_columns(&self, [coordinates]: [usize; 1]) -> usize {
        self.columns(coordinates)
    }

    fn value<T: Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        if self.with_input {
            y[..x.len()].copy_from_slice(x);
        }
        for band in 0..self.bands {
            let (frequency, sines, cosines) = self.band::<T>(band, x.len());
            for (axis, &x) in x.iter().enumerate() {
                (y[sines + axis], y[cosines + axis]) = ((frequency * x).sin(), (frequency * x).cos());
            }
        }
    }

    fn gradient<T: Real>(&self, [x]: [&[T]; 1], y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        if self.with_input {
            dx.copy_from_slice(&dy[..x.len()]);
        }
        for band in 0..self.bands {
            let (frequency, sines, cosines) = self.band::<T>(band, x.len());
            for (axis, dx) in dx.iter_mut().enumerate() {
                let (sine, cosine) = (sines + axis, cosines + axis);
                *dx += frequency * (y[cosine] * dy[sine] - y[sine] * dy[cosine]);
            }
        }
    }

    fn wgsl(&self, _coordinates: [usize; 1]) -> Option<RowWgsl> {
        let wgsl = || RowWgsl {
            value: include_str!("encoding.wgsl"),
            gradients: include_str!("encoding_bwd.wgsl"),
            specialisation: vec![("BANDS", self.bands as u32), ("WITH_INPUT", u32::from(self.with_input))],
            numbers: Vec::new(),
        };
        (self.bands <= MOST_BANDS).then(wgsl)
    }
}
