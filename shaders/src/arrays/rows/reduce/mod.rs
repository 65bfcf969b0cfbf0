//! Sums, products and lengths of rows.

mod gpu;

use super::map::{RowMap, RowWgsl, map_rows};
use crate::gpu::Gpu;
use crate::pointwise::{scale, shift};
use crate::tape::{Real, Tape, Tensor, Var};

/// Σₖ xₖ of every row: [N, C] → [N, 1].
pub fn row_sum<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    map_rows(tape, RowSum, [x])
}

/// Σₖ aₖbₖ of every row: [N, C], [N, C] → [N, 1].
pub fn row_dot<T: Real>(tape: &mut Tape<T>, a: Var, b: Var) -> Var {
    map_rows(tape, RowDot, [a, b])
}

/// Σₖ xₖ² of every row: [N, C] → [N, 1].
pub fn squared_norm<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    map_rows(tape, RowDot, [x, x])
}

/// ‖x‖ of every row: [N, C] → [N, 1]; the gradient of a zero row is 0.
pub fn norm<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    map_rows(tape, Norm, [x])
}

/// x / max(‖x‖, ε) of every row: [N, C] → [N, C]; the gradient of a zero row is that of x / ε.
pub fn normalize<T: Real>(tape: &mut Tape<T>, x: Var, epsilon: f64) -> Var {
    assert!(epsilon > 0.0, "normalize: ε must be positive");
    map_rows(tape, Normalize { epsilon }, [x])
}

/// Every row of x [N, C] times its factor [N, 1].
pub fn scale_rows<T: Real>(tape: &mut Tape<T>, x: Var, factors: Var) -> Var {
    map_rows(tape, ScaleRows, [x, factors])
}

/// Every row of x [N, C] over max(divisor, floor), for divisors [N, 1]. Divisors up to the floor receive no gradient.
pub fn divide_rows<T: Real>(tape: &mut Tape<T>, x: Var, divisors: Var, floor: f64) -> Var {
    assert!(floor > 0.0, "divide_rows: the floor must be positive");
    map_rows(tape, DivideRows { floor }, [x, divisors])
}

/// 1 − cos ∠(a, b) of every row: [N, C], [N, C] → [N, 1], with max(‖·‖, ε) for the lengths: 1 where a row is zero.
pub fn cosine_distance<T: Real>(tape: &mut Tape<T>, a: Var, b: Var, epsilon: f64) -> Var {
    let [a, b] = [a, b].map(|x| normalize(tape, x, epsilon));
    let cosine = row_dot(tape, a, b);
    let opposite = scale(tape, cosine, -1.0);
    shift(tape, opposite, 1.0)
}

fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    a.iter().zip(b).map(|(&a, &b)| a * b).sum()
}

struct RowSum;

impl RowMap<1> for RowSum {
    const NAME: &'static str = "row_sum";

    fn output_columns(&self, _input_columns: [usize; 1]) -> usize {
        1
    }

    fn value<T: Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        y[0] = x.iter().copied().sum();
    }

    fn gradient<T: Real>(&self, _inputs: [&[T]; 1], _y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        dx.fill(dy[0]);
    }

    fn wgsl(&self, _columns: [usize; 1]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: include_str!("row_sum.wgsl"),
            gradients: include_str!("row_sum_bwd.wgsl"),
            specialisation: Vec::new(),
            numbers: Vec::new(),
        })
    }
}

struct RowDot;

impl RowMap<2> for RowDot {
    const NAME: &'static str = "row_dot";

    fn output_columns(&self, [a, b]: [usize; 2]) -> usize {
        assert_eq!(a, b, "row_dot: numbers of columns differ");
        1
    }

    fn value<T: Real>(&self, [a, b]: [&[T]; 2], y: &mut [T]) {
        y[0] = dot(a, b);
    }

    fn gradient<T: Real>(&self, [a, b]: [&[T]; 2], _y: &[T], dy: &[T], [da, db]: [&mut [T]; 2]) {
        da.iter_mut().zip(b).for_each(|(da, &b)| *da = dy[0] * b);
        db.iter_mut().zip(a).for_each(|(db, &a)| *db = dy[0] * a);
    }

    fn wgsl(&self, _columns: [usize; 2]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: include_str!("row_dot.wgsl"),
            gradients: include_str!("row_dot_bwd.wgsl"),
            specialisation: Vec::new(),
            numbers: Vec::new(),
        })
    }
}

struct Norm;

impl RowMap<1> for Norm {
    const NAME: &'static str = "norm";

    fn output_columns(&self, _input_columns: [usize; 1]) -> usize {
        1
    }

    fn value<T: Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        y[0] = dot(x, x).sqrt();
    }

    fn gradient<T: Real>(&self, [x]: [&[T]; 1], y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        // Zero rows keep the zeros of `dx`; written so that a NaN stays a NaN.
        if !(y[0] == T::ZERO) {
            dx.iter_mut().zip(x).for_each(|(dx, &x)| *dx = dy[0] * x / y[0]);
        }
    }

    fn wgsl(&self, _columns: [usize; 1]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: include_str!("norm.wgsl"),
            gradients: include_str!("norm_bwd.wgsl"),
            specialisation: Vec::new(),
            numbers: Vec::new(),
        })
    }
}

struct Normalize {
    epsilon: f64,
}

impl RowMap<1> for Normalize {
    const NAME: &'static str = "normalize";

    fn output_columns(&self, [x]: [usize; 1]) -> usize {
        x
    }

    fn value<T: Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        let (length, _) = self.length(x);
        y.iter_mut().zip(x).for_each(|(y, &x)| *y = x / length);
    }

    fn gradient<T: Real>(&self, [x]: [&[T]; 1], y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        let (length, is_short) = self.length(x);
        // At lengths of ε or more, only the component tangential to the sphere passes.
        let radial = if is_short { T::ZERO } else { dot(y, dy) };
        dx.iter_mut().zip(y.iter().zip(dy)).for_each(|(dx, (&y, &dy))| *dx = (dy - radial * y) / length);
    }

    fn value_gpu<T: Real>(&self, gpu: Gpu, [x]: [&Tensor<T>; 1]) -> Option<Tensor<T>> {
        Some(gpu::normalize(gpu, x, self.epsilon))
    }

    fn gradient_gpu<T: Real>(&self, gpu: Gpu, [x]: [&Tensor<T>; 1], y: &Tensor<T>, dy: &Tensor<T>) -> [Tensor<T>; 1] {
        [gpu::normalize_gradient(gpu, [x, y, dy], self.epsilon)]
    }
}

impl Normalize {
    /// max(‖x‖, ε), and whether that is ε; a NaN stays a NaN.
    fn length<T: Real>(&self, x: &[T]) -> (T, bool) {
        let (norm, epsilon) = (dot(x, x).sqrt(), T::from_f64(self.epsilon));
        if norm < epsilon { (epsilon, true) } else { (norm, false) }
    }
}

struct ScaleRows;

impl RowMap<2> for ScaleRows {
    const NAME: &'static str = "scale_rows";

    fn output_columns(&self, [x, factor]: [usize; 2]) -> usize {
        assert_eq!(factor, 1, "scale_rows: one factor per row");
        x
    }

    fn value<T: Real>(&self, [x, factor]: [&[T]; 2], y: &mut [T]) {
        y.iter_mut().zip(x).for_each(|(y, &x)| *y = factor[0] * x);
    }

    fn gradient<T: Real>(&self, [x, factor]: [&[T]; 2], _y: &[T], dy: &[T], [dx, dfactor]: [&mut [T]; 2]) {
        dx.iter_mut().zip(dy).for_each(|(dx, &dy)| *dx = factor[0] * dy);
        dfactor[0] = dot(x, dy);
    }

    fn wgsl(&self, _columns: [usize; 2]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: include_str!("scale_rows.wgsl"),
            gradients: include_str!("scale_rows_bwd.wgsl"),
            specialisation: Vec::new(),
            numbers: Vec::new(),
        })
    }
}

struct DivideRows {
    floor: f64,
}

impl DivideRows {
    /// max(divisor, floor), and whether that is the divisor; a NaN stays a NaN.
    fn divisor<T: Real>(&self, divisor: T) -> (T, bool) {
        let floor = T::from_f64(self.floor);
        if divisor <= floor { (floor, false) } else { (divisor, true) }
    }
}

impl RowMap<2> for DivideRows {
    const NAME: &'static str = "divide_rows";

    fn output_columns(&self, [x, divisor]: [usize; 2]) -> usize {
        assert_eq!(divisor, 1, "divide_rows: one divisor per row");
        x
    }

    fn value<T: Real>(&self, [x, divisor]: [&[T]; 2], y: &mut [T]) {
        let (divisor, _) = self.divisor(divisor[0]);
        y.iter_mut().zip(x).for_each(|(y, &x)| *y = x / divisor);
    }

    fn gradient<T: Real>(&self, [_, divisor]: [&[T]; 2], y: &[T], dy: &[T], [dx, ddivisor]: [&mut [T]; 2]) {
        let (divisor, is_above) = self.divisor(divisor[0]);
        dx.iter_mut().zip(dy).for_each(|(dx, &dy)| *dx = dy / divisor);
        if is_above {
            ddivisor[0] = -(dot(y, dy) / divisor);
        }
    }

    fn wgsl(&self, _columns: [usize; 2]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: include_str!("divide_rows.wgsl"),
            gradients: include_str!("divide_rows_bwd.wgsl"),
            specialisation: Vec::new(),
            numbers: vec![self.floor as f32],
        })
    }
}

#[cfg(test)]
pub(super) fn validate_maps() {
    use crate::arrays::rows::validate_map;
    validate_map(&RowSum, [5]);
    validate_map(&RowDot, [5, 5]);
    validate_map(&Norm, [5]);
    validate_map(&ScaleRows, [5, 1]);
    validate_map(&DivideRows { floor: 0.5 }, [5, 1]);
}
