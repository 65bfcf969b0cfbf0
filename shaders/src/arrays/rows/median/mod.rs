mod gpu;

use crate::tape::{Device, Real, Tape, Tensor, Var};

/// The median, shape `[1]`, of the elements of x ≥ 0, `[N]` or [N, 1], whose flag `[N]` is above 0: the upper one of two middle
/// elements, 0 if no flag is set. NaN sorts last. The result is a constant without gradient.
pub fn median_where<T: Real>(tape: &mut Tape<T>, x: Var, flags: Var) -> Var {
    let [x, flags] = [x, flags].map(|var| tape.value(var));
    assert_eq!(x.len(), flags.len(), "median_where: one flag per element");
    let median = match tape.device() {
        Device::Cpu => Tensor::scalar(median(x.as_slice(), flags.as_slice())),
        Device::Gpu(gpu) => gpu::median(gpu, x, flags),
    };
    tape.constant(median)
}

fn median<T: Real>(x: &[T], flags: &[T]) -> T {
    let flagged = x.iter().zip(flags).filter(|(_, flag)| **flag > T::ZERO);
    let mut values: Vec<f64> = flagged.map(|(value, _)| value.to_f64()).collect();
    if values.is_empty() {
        return T::ZERO;
    }
    let middle = values.len() / 2;
    T::from_f64(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::conformance::Disagreement;
    use crate::check::{agree, noise};
    use crate::gpu::Gpu;
    use crate::gpu::fault_tests::assert_noticed;
    use crate::gpu::tests::test_gpu;

    fn found<T: Real>(device: Device, x: &[f64], flags: &[f64]) -> Tensor<T> {
        let mut tape = Tape::new(device);
        let [x, flags] = [x, flags].map(|values| {
            tape.constant(Tensor::from_vec([values.len()], values.iter().map(|&value| T::from_f64(value)).collect()))
        });
        let median = median_where(&mut tape, x, flags);
        tape.value(median).clone()
    }

    #[test]
    fn the_upper_of_two_and_nothing_of_nothing() {
        let of = |x: &[f64], flags: &[f64]| found::<f64>(Device::Cpu, x, flags).as_slice()[0];
        assert_eq!(of(&[5.0, 1.0, 9.0, 2.0], &[1.0; 4]), 5.0);
        assert_eq!(of(&[5.0, 1.0, 9.0, 2.0], &[0.0, 1.0, 0.5, 1.0]), 2.0);
        assert_eq!([of(&[], &[]), of(&[3.0], &[0.0]), of(&[3.0], &[1.0])], [0.0, 0.0, 3.0]);
        assert_eq!(of(&[f64::NAN, 4.0, 1.0], &[1.0; 3]), 4.0);
    }

    /// Compares the devices on `count` elements, every third of which is not flagged.
    fn compare(gpu: Gpu, count: usize) -> Result<usize, Disagreement> {
        let x: Vec<f64> = noise(count, 1).iter().map(|value| value.abs()).collect();
        let flags: Vec<f64> = (0..count).map(|at| f64::from(at as u32 % 3)).collect();
        let mismatch = |mismatch| Disagreement { what: format!("the median of {count}"), mismatch };
        let on_gpu = found::<f32>(Device::Gpu(gpu), &x, &flags);
        agree(&on_gpu, &found::<f32>(Device::Cpu, &x, &flags), 0.0).map(|()| 1).map_err(mismatch)
    }

    #[test]
    fn a_gpu_finds_the_same() {
        let Some(gpu) = test_gpu() else { return };
        for count in [0, 1, 2, 3, 4, 255, 1000, 5000] {
            compare(gpu, count).unwrap_or_else(|error| panic!("{error}"));
        }
        let x = [f64::NAN, 4.0, 0.0, f64::INFINITY, 1.0];
        assert_eq!(found::<f32>(Device::Gpu(gpu), &x, &[1.0; 5]).as_slice(), [4.0]);
        let faults = [("median, keys", "> 0.0", ">= 0.0"), ("median", "low / 2u", "low / 3u")];
        assert_noticed(&faults, || compare(gpu, 1000));
    }
}
