//! Regularisers of the planes of a hexplane field (Cao and Johnson 2023; Fridovich-Keil et al. 2023).

mod gpu;

use crate::gpu::Gpu;
use crate::tape::chunks::{CHUNK, for_each_chunk, map_chunks};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// A mean over the elements of a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaneMean {
    /// The mean of squared second differences (P[i−1] − 2·P`[i]` + P[i+1])² along the height axis, (height −
    /// 2)·width·channels of them; a plane of height below 3 contributes 0. On spatial planes this is the "total
    /// variation" of 4DGaussians, on time planes its time smoothness.
    SecondDifference,
    /// The mean of |1 − P|; the gradient at P = 1 is 0. On time planes, 1 means "does not change".
    DistanceToOne,
}

/// For every (mean, planes) the sum over those planes of that mean: `[1]` each. No plane enters one mean twice.
pub fn plane_means<T: Real>(tape: &mut Tape<T>, terms: &[(PlaneMean, Vec<Var>)]) -> Vec<Var> {
    let mut inputs: Vec<Var> = terms.iter().flat_map(|(_, planes)| planes).copied().collect();
    inputs.sort_unstable();
    inputs.dedup();
    let place = |var: &Var| inputs.binary_search(var).expect("every plane is an input");
    let term =
        |(mean, planes): &(PlaneMean, Vec<Var>)| Term { mean: *mean, planes: planes.iter().map(place).collect() };
    let terms: Vec<Term> = terms.iter().map(term).collect();
    for mean in [PlaneMean::SecondDifference, PlaneMean::DistanceToOne] {
        let entering =
            |plane: usize| terms.iter().filter(move |term| term.mean == mean && term.planes.contains(&plane));
        assert!((0..inputs.len()).all(|plane| entering(plane).count() <= 1), "a plane enters {mean:?} twice");
    }
    tape.apply(PlaneMeans { terms }, &inputs)
}

/// A mean and the inputs that it is taken of.
struct Term {
    mean: PlaneMean,
    planes: Vec<usize>,
}

struct PlaneMeans {
    terms: Vec<Term>,
}

impl PlaneMean {
    /// Elements that enter the mean over a plane.
    fn terms<T: Real>(self, plane: &Tensor<T>) -> usize {
        match self {
            Self::SecondDifference => second_differences(plane) * plane.row_len(),
            Self::DistanceToOne => plane.len(),
        }
    }

    fn of<T: Real>(self, plane: &Tensor<T>) -> f64 {
        match self {
            Self::SecondDifference => mean_square_second_difference(plane),
            Self::DistanceToOne => mean_distance_to_one(plane),
        }
    }

    fn gradient<T: Real>(self, plane: &Tensor<T>, dy: T) -> Tensor<T> {
        let values = match self {
            Self::SecondDifference => smoothness_gradient(plane, dy),
            Self::DistanceToOne => distance_gradient(plane, dy),
        };
        Tensor::from_vec(plane.shape(), values)
    }
}

impl<T: Real> Op<T> for PlaneMeans {
    fn name(&self) -> &'static str {
        "plane_means"
    }

    fn forward(&mut self, planes: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let sum = |term: &Term| term.planes.iter().map(|&index| term.mean.of(planes[index])).sum();
        self.terms.iter().map(|term| Tensor::scalar(T::from_f64(sum(term)))).collect()
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs: planes, output_grads, needs, .. } = pass;
        let mut gradients: Vec<Option<Tensor<T>>> = vec![None; planes.len()];
        for (Term { mean, planes: chosen }, dy) in self.terms.iter().zip(output_grads).rev() {
            let Some(dy) = dy else { continue };
            for &index in chosen.iter().filter(|&&index| needs[index]) {
                let term = mean.gradient(planes[index], dy.as_slice()[0]);
                match &mut gradients[index] {
                    None => gradients[index] = Some(term),
                    Some(sum) => {
                        let pairs = sum.make_mut().iter_mut().zip(term.as_slice());
                        pairs.for_each(|(sum, &term)| *sum += term);
                    }
                }
            }
        }
        gradients
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for PlaneMeans {
    fn forward_gpu(&mut self, gpu: Gpu, planes: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(gpu::sums_of_means(gpu, planes, &self.terms))
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        pass.summed_from_zero(|totals| self.accumulate_gpu(gpu, pass, totals))
    }

    fn accumulate_gpu(&mut self, gpu: Gpu, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        gpu::add_mean_gradients(gpu, pass, &self.terms, totals);
    }
}

/// Rows per chunk so that a chunk has about [`CHUNK`] elements.
fn rows_per_chunk(row_len: usize) -> usize {
    (CHUNK / row_len).max(1)
}

/// Σ `term(i)` over `0..len` in partial sums that do not wait for each other, added in order.
#[inline(always)]
fn sum_in_lanes<T: Real>(len: usize, term: impl Fn(usize) -> T) -> T {
    const LANES: usize = 16;
    let mut lanes = [T::ZERO; LANES];
    let whole = len / LANES * LANES;
    for first in (0..whole).step_by(LANES) {
        for (lane, sum) in lanes.iter_mut().enumerate() {
            *sum += term(first + lane);
        }
    }
    lanes.into_iter().sum::<T>() + (whole..len).map(term).sum::<T>()
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
        let square = |i: usize| {
            let difference = above[i] - center[i] - center[i] + below[i];
            difference * difference
        };
        sum_in_lanes(row_len, square).to_f64()
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
            gradient_of_row(plane, first / row_len + index, factor, out);
        }
    });
    gradient
}

/// Into `out`, `factor` times Σ over second differences that contain the row of coefficient · difference.
fn gradient_of_row<T: Real>(plane: &Tensor<T>, row: usize, factor: T, out: &mut [T]) {
    let (row_len, last) = (plane.row_len(), plane.rows() - 1);
    if row >= 2 && row + 2 <= last {
        let rows: [&[T]; 5] = std::array::from_fn(|term| &plane.row(row + term - 2)[..row_len]);
        let (four, six) = (T::from_f64(4.0), T::from_f64(6.0));
        for (i, out) in out.iter_mut().enumerate() {
            let (outer, inner) = (rows[0][i] + rows[4][i], rows[1][i] + rows[3][i]);
            *out = factor * ((outer - four * inner) + six * rows[2][i]);
        }
        return;
    }
    // The second difference that starts `offset` rows above this row has it as first, middle or last term.
    for (offset, coefficient) in [(0, T::ONE), (1, T::from_f64(-2.0)), (2, T::ONE)] {
        if row < offset || row - offset + 2 > last {
            continue;
        }
        let [above, center, below] = [0, 1, 2].map(|term| plane.row(row - offset + term));
        for i in 0..row_len {
            out[i] += factor * coefficient * (above[i] - center[i] - center[i] + below[i]);
        }
    }
}

fn mean_distance_to_one<T: Real>(plane: &Tensor<T>) -> f64 {
    let values = plane.as_slice();
    let sum_of = |range: std::ops::Range<usize>| {
        let values = &values[range];
        sum_in_lanes(values.len(), |i| (T::ONE - values[i]).abs())
    };
    map_chunks(values.len(), CHUNK, |range| sum_of(range).to_f64()).into_iter().sum::<f64>() / values.len() as f64
}

fn distance_gradient<T: Real>(plane: &Tensor<T>, dy: T) -> Vec<T> {
    let (values, step) = (plane.as_slice(), dy / T::from_f64(plane.len() as f64));
    let mut gradient = vec![T::ZERO; values.len()];
    for_each_chunk(&mut gradient, CHUNK, |first, out| {
        for (out, &value) in out.iter_mut().zip(&values[first..]) {
            // Two selections, which become vector instructions; a chain of branches does not.
            let above = if value > T::ONE { step } else { T::ZERO };
            let below = if value < T::ONE { step } else { T::ZERO };
            *out = above - below;
        }
    });
    gradient
}
