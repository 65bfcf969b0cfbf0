use super::{RowMap, RowWgsl, map_rows};
use crate::tape::{Real, Tape, Var};

/// The rows of x [N, C] whose flag `[N]` or [N, 1] is above 0, zeros elsewhere: [N, C]. Infinities and NaN in the other rows
/// reach neither values nor gradients; the flags receive no gradient.
pub fn keep_rows<T: Real>(tape: &mut Tape<T>, x: Var, flags: Var) -> Var {
    map_rows(tape, KeepRows, [x, flags])
}

struct KeepRows;

impl RowMap<2> for KeepRows {
    const NAME: &'static str = "keep_rows";

    fn output_columns(&self, [x, flag]: [usize; 2]) -> usize {
        assert_eq!(flag, 1, "keep_rows: one flag per row");
        x
    }

    fn value<T: Real>(&self, [x, flag]: [&[T]; 2], y: &mut [T]) {
        if flag[0] > T::ZERO {
            y.copy_from_slice(x);
        }
    }

    fn gradient<T: Real>(&self, [_, flag]: [&[T]; 2], _y: &[T], dy: &[T], [dx, _]: [&mut [T]; 2]) {
        if flag[0] > T::ZERO {
            dx.copy_from_slice(dy);
        }
    }

    fn wgsl(&self, _columns: [usize; 2]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: "fn value(row: u32, column: u32) -> f32 {
    return select(0.0, x0[row * COLUMNS_0 + column], x1[row] > 0.0);
}
",
            gradients: "fn gradient_0(row: u32, column: u32) -> f32 {
    return select(0.0, dy[row * COLUMNS_0 + column], x1[row] > 0.0);
}
fn gradient_1(row: u32, column: u32) -> f32 {
    return 0.0;
}
",
            specialisation: Vec::new(),
            numbers: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arrays::rows::validate_map;
    use crate::check::conformance::{Tolerance, compare};
    use crate::check::{self, noise};
    use crate::gpu::tests::test_gpu;
    use crate::tape::{Device, Tensor};

    /// Rows, some with NaN or infinity, and flags that exclude these rows.
    fn spoilt<T: Real>() -> [Tensor<T>; 2] {
        let (nan, infinity) = (f64::NAN, f64::INFINITY);
        [vec![1.0, 2.0, nan, infinity, -3.0, 4.0], vec![1.0, 0.0, 1.0]]
            .map(|values| values.into_iter().map(T::from_f64).collect::<Vec<T>>())
            .map(|values| Tensor::from_vec([3, values.len() / 3], values))
    }

    #[test]
    fn rows_that_do_not_count_reach_nothing_on_any_device() {
        fn kept<T: Real>(device: Device) -> (Tensor<T>, Tensor<T>) {
            let mut tape = Tape::new(device);
            let [x, flags] = spoilt::<T>().map(|tensor| tape.leaf(tensor));
            let y = keep_rows(&mut tape, x, flags);
            // The gradient of a row that does not count is not finite, either.
            let seed = tape.value(x).clone();
            let gradient = tape.backward(&[(y, seed)]).take(x).unwrap();
            (tape.value(y).clone(), gradient)
        }
        let expected = [1.0, 2.0, 0.0, 0.0, -3.0, 4.0];
        let (y, gradient) = kept::<f64>(Device::Cpu);
        assert_eq!([y.as_slice(), gradient.as_slice()], [expected; 2]);
        let Some(gpu) = test_gpu() else { return };
        let (y, gradient) = kept::<f32>(Device::Gpu(gpu));
        assert_eq!([y.as_slice(), gradient.as_slice()], [expected.map(|value| value as f32); 2]);
    }

    #[test]
    fn gradients_are_central_differences_and_a_gpu_agrees() {
        let flags = |rows: usize| Tensor::from_vec([rows], (0..rows).map(|row| f64::from(row as u32 % 3)).collect());
        let x = |rows: usize| Tensor::from_vec([rows, 3], noise(3 * rows, 1));
        let keep = |tape: &mut Tape<f64>, vars: &[Var]| {
            let flags = tape.constant(flags(7));
            keep_rows(tape, vars[0], flags)
        };
        check::gradients(keep, &[x(7)], check::TOLERANCE).unwrap();
        validate_map(&KeepRows, [3, 1]);
        let Some(gpu) = test_gpu() else { return };
        let exact = Tolerance { value: 0.0, gradient: 0.0 };
        for rows in [0, 1, 300] {
            let inputs = [x(rows).cast(), flags(rows).cast()];
            compare(gpu, &format!("{rows} rows"), &inputs, exact, |tape, vars| vec![keep_rows(tape, vars[0], vars[1])])
                .unwrap();
        }
        // The planted fault: flags of other rows.
        let faulty = |tape: &mut Tape<f32>, vars: &[Var]| {
            vec![keep_rows(tape, vars[0], vars[if tape.device() == Device::Cpu { 1 } else { 2 }])]
        };
        let other = Tensor::full([300], 1.0);
        let inputs = [x(300).cast(), flags(300).cast(), other];
        assert!(compare(gpu, "faulty flags", &inputs, exact, faulty).is_err());
    }
}
