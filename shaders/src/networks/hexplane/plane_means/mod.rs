//! Regularisers of the planes of a hexplane field (Cao and Johnson 2023; Fridovich-Keil et al. 2023).

mod gpu;

use crate::gpu::Gpu;
use crate::tape::chunks::{CHUNK, chunked, map_chunks};
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

/// A mean and the inputs that it is computed from.
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

    /// Adds the gradient of whole rows of `plane`, from the row `first_row` on.
    fn add_gradient<T: Real>(self, plane: &Tensor<T>, dy: T, first_row: usize, rows: &mut [T]) {
        match self {
            Self::SecondDifference => add_smoothness_gradient(plane, dy, first_row, rows),
            Self::DistanceToOne => add_distance_gradient(plane, dy, first_row, rows),
        }
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
        let gradient = |index: usize| {
            let plane = planes[index];
            let of_plane = |(term, dy): (&Term, &Option<&Tensor<T>>)| {
                dy.filter(|_| term.planes.contains(&index)).map(|dy| (term.mean, dy.as_slice()[0]))
            };
            let terms: Vec<(PlaneMean, T)> = self.terms.iter().zip(output_grads).rev().filter_map(of_plane).collect();
            let row_len = plane.row_len();
            let sum = |first: usize, rows: &mut [T]| {
                terms.iter().for_each(|&(mean, dy)| mean.add_gradient(plane, dy, first / row_len, rows));
            };
            let values = || chunked(plane.len(), rows_per_chunk(row_len) * row_len, sum);
            (needs[index] && !terms.is_empty()).then(|| Tensor::from_vec(plane.shape(), values()))
        };
        (0..planes.len()).map(gradient).collect()
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

/// Σ `term(i)` over `0..len` in independent partial sums, added in order.
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
fn add_smoothness_gradient<T: Real>(plane: &Tensor<T>, dy: T, first_row: usize, rows: &mut [T]) {
    let (row_len, count) = (plane.row_len(), second_differences(plane));
    if count == 0 {
        return;
    }
    let factor = T::from_f64(2.0 / (count * row_len) as f64) * dy;
    for (index, out) in rows.chunks_exact_mut(row_len).enumerate() {
        add_gradient_of_row(plane, first_row + index, factor, out);
    }
}

/// Adds to `out` `factor` times Σ over second differences that contain the row of coefficient · difference.
fn add_gradient_of_row<T: Real>(plane: &Tensor<T>, row: usize, factor: T, out: &mut [T]) {
    let (row_len, last) = (plane.row_len(), plane.rows() - 1);
    if row >= 2 && row + 2 <= last {
        let rows: [&[T]; 5] = std::array::from_fn(|term| &plane.row(row + term - 2)[..row_len]);
        let (four, six) = (T::from_f64(4.0), T::from_f64(6.0));
        for (i, out) in out.iter_mut().enumerate() {
            let (outer, inner) = (rows[0][i] + rows[4][i], rows[1][i] + rows[3][i]);
            *out += factor * ((outer - four * inner) + six * rows[2][i]);
        }
        return;
    }
    // The second difference that starts `offset` rows above this row has it as first, middle or last term.
    let stencil = [(0, T::ONE), (1, T::from_f64(-2.0)), (2, T::ONE)];
    let differences: Vec<(T, [&[T]; 3])> = stencil
        .into_iter()
        .filter(|&(offset, _)| offset <= row && row - offset + 2 <= last)
        .map(|(offset, coefficient)| (factor * coefficient, [0, 1, 2].map(|term| plane.row(row - offset + term))))
        .collect();
    for (i, out) in out.iter_mut().enumerate() {
        let term =
            |&(factor, [above, center, below]): &(T, [&[T]; 3])| factor * (above[i] - center[i] - center[i] + below[i]);
        *out += differences.iter().map(term).sum::<T>();
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

fn add_distance_gradient<T: Real>(plane: &Tensor<T>, dy: T, first_row: usize, rows: &mut [T]) {
    let (values, step) = (plane.as_slice(), dy / T::from_f64(plane.len() as f64));
    for (out, &value) in rows.iter_mut().zip(&values[first_row * plane.row_len()..]) {
        // Two selections, which become vector instructions; a chain of branches does not.
        let above = if value > T::ONE { step } else { T::ZERO };
        let below = if value < T::ONE { step } else { T::ZERO };
        *out += above - below;
    }
}
