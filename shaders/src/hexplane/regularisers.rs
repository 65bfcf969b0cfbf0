//! Regularisers of the planes of a hexplane field (Cao and Johnson 2023; Fridovich-Keil et al. 2023).

use crate::tape::chunks::{CHUNK, for_each_chunk, map_chunks};
use crate::tape::{Op, Real, Tape, Tensor, Var};

/// Σ over planes of the mean squared second difference (P[i−1] − 2·P[i] + P[i+1])² along the height axis, shape [1].
///
/// The mean runs over the (height − 2)·width·channels second differences; a plane of height below 3 contributes 0. On
/// spatial planes this is the "total variation" of 4DGaussians, on time planes its time smoothness.
pub fn smoothness<T: Real>(tape: &mut Tape<T>, planes: &[Var]) -> Var {
    tape.apply_one(
        PlaneMeans { name: "plane_smoothness", mean: mean_square_second_difference, gradient: smoothness_gradient },
        planes,
    )
}

/// Σ over planes of mean |1 − P|, shape [1]; the gradient at P = 1 is 0. On time planes 1 means "does not change".
pub fn distance_to_one<T: Real>(tape: &mut Tape<T>, planes: &[Var]) -> Var {
    tape.apply_one(
        PlaneMeans { name: "plane_distance_to_one", mean: mean_distance_to_one, gradient: distance_gradient },
        planes,
    )
}

/// The sum over planes of a mean over one plane.
struct PlaneMeans<T: Real> {
    name: &'static str,
    mean: fn(&Tensor<T>) -> f64,
    /// Gradient of the mean times the given factor.
    gradient: fn(&Tensor<T>, T) -> Vec<T>,
}

impl<T: Real> Op<T> for PlaneMeans<T> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn forward(&mut self, planes: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        vec![Tensor::scalar(T::from_f64(planes.iter().map(|plane| (self.mean)(plane)).sum()))]
    }

    fn backward(
        &mut self,
        planes: &[&Tensor<T>],
        _outputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
        needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let Some(dy) = output_grads[0] else { return vec![None; planes.len()] };
        let gradient = |plane: &Tensor<T>| Tensor::from_vec(plane.shape(), (self.gradient)(plane, dy.as_slice()[0]));
        planes.iter().zip(needs).map(|(plane, &needed)| needed.then(|| gradient(plane))).collect()
    }
}

/// Rows per chunk so that a chunk has about [`CHUNK`] elements.
fn rows_per_chunk(row_len: usize) -> usize {
    (CHUNK / row_len).max(1)
}

/// Second differences of a plane: rows, or 0.
fn second_differences<T: Real>(plane: &Tensor<T>) -> usize {
    plane.rows().saturating_sub(2)
}

fn mean_square_second_difference<T: Real>(plane: &Tensor<T>) -> f64 {
    let (row_len, count) = (plane.row_len(), second_differences(plane));
    if count == 0 {
        return 0.0;
    }
    let sum_of_row = |row: usize| -> f64 {
        let [above, center, below] = [0, 1, 2].map(|offset| plane.row(row + offset));
        let squares = (0..row_len).map(|i| {
            let difference = above[i] - center[i] - center[i] + below[i];
            difference * difference
        });
        squares.sum::<T>().to_f64()
    };
    let sums = map_chunks(count, rows_per_chunk(row_len), |rows| rows.map(sum_of_row).sum::<f64>());
    sums.into_iter().sum::<f64>() / (count * row_len) as f64
}

/// The stencil applied twice: [1, −4, 6, −4, 1] away from the first and last rows.
fn smoothness_gradient<T: Real>(plane: &Tensor<T>, dy: T) -> Vec<T> {
    let (row_len, count) = (plane.row_len(), second_differences(plane));
    let mut gradient = vec![T::ZERO; plane.len()];
    if count == 0 {
        return gradient;
    }
    let factor = T::from_f64(2.0 / (count * row_len) as f64) * dy;
    for_each_chunk(&mut gradient, rows_per_chunk(row_len) * row_len, |first, chunk| {
        for (index, out) in chunk.chunks_exact_mut(row_len).enumerate() {
            let row = first / row_len + index;
            // The second difference that starts `offset` rows above this row has it as first, middle or last term.
            for (offset, coefficient) in [(0, T::ONE), (1, T::from_f64(-2.0)), (2, T::ONE)] {
                if row < offset || row - offset >= count {
                    continue;
                }
                let [above, center, below] = [0, 1, 2].map(|term| plane.row(row - offset + term));
                for i in 0..row_len {
                    out[i] += factor * coefficient * (above[i] - center[i] - center[i] + below[i]);
                }
            }
        }
    });
    gradient
}

fn mean_distance_to_one<T: Real>(plane: &Tensor<T>) -> f64 {
    let values = plane.as_slice();
    let sum_of = |range: std::ops::Range<usize>| values[range].iter().map(|&value| (T::ONE - value).abs()).sum::<T>();
    map_chunks(values.len(), CHUNK, |range| sum_of(range).to_f64()).into_iter().sum::<f64>() / values.len() as f64
}

fn distance_gradient<T: Real>(plane: &Tensor<T>, dy: T) -> Vec<T> {
    let (values, step) = (plane.as_slice(), dy / T::from_f64(plane.len() as f64));
    let mut gradient = vec![T::ZERO; values.len()];
    for_each_chunk(&mut gradient, CHUNK, |first, out| {
        for (out, &value) in out.iter_mut().zip(&values[first..]) {
            *out = if value > T::ONE {
                step
            } else if value < T::ONE {
                -step
            } else {
                T::ZERO
            };
        }
    });
    gradient
}
