//! Several sums at once.

use crate::gpu::Gpu;
use crate::tape::chunks::{CHUNK, chunked};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var, sums_on_gpu};

/// The sums of pairs of equal shape, each equal to [`super::add`]. A GPU computes them in one launch.
pub fn adds<T: Real>(tape: &mut Tape<T>, pairs: &[[Var; 2]]) -> Vec<Var> {
    for &[a, b] in pairs {
        assert_eq!(tape.value(a).shape(), tape.value(b).shape(), "adds: shapes differ");
    }
    tape.apply(Adds, pairs.as_flattened())
}

struct Adds;

impl<T: Real> Op<T> for Adds {
    fn name(&self) -> &'static str {
        "add"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let sum = |pair: &[&Tensor<T>]| {
            let (a, b) = (pair[0].as_slice(), pair[1].as_slice());
            let sum = chunked(a.len(), CHUNK, |first, sum: &mut [T]| {
                let terms = a[first..].iter().zip(&b[first..]);
                sum.iter_mut().zip(terms).for_each(|(sum, (&a, &b))| *sum = a + b);
            });
            Tensor::from_vec(pair[0].shape(), sum)
        };
        inputs.chunks(2).map(sum).collect()
    }

    /// The gradient of a sum is the gradient of both of its terms, on either device.
    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { output_grads, needs, .. } = pass;
        let term = |(index, &needed): (usize, &bool)| output_grads[index / 2].filter(|_| needed).cloned();
        needs.iter().enumerate().map(term).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Adds {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(sums_on_gpu(gpu, inputs.as_chunks().0))
    }

    fn backward_gpu(&mut self, _gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        self.backward(pass)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::conformance::{Tolerance, compare, run};
    use crate::check::noise;
    use crate::gpu::fault_tests::assert_noticed;
    use crate::gpu::parts::tests::assert_equal_in_parts;
    use crate::gpu::tests::{bits, test_gpu};
    use crate::pointwise::{add, square};
    use crate::tape::Device;

    fn inputs() -> Vec<Tensor<f32>> {
        let shapes = [[70, 3], [1, 1], [0, 4], [257, 2]];
        let tensor = |seed: usize| {
            let shape = shapes[seed / 2 % shapes.len()];
            Tensor::from_vec(shape, noise(shape[0] * shape[1], seed as u64)).cast()
        };
        (0..2 * shapes.len()).map(tensor).collect()
    }

    /// Sums of terms that other operations use as well.
    fn uses(tape: &mut Tape<f32>, vars: &[Var], sums: impl Fn(&mut Tape<f32>, &[[Var; 2]]) -> Vec<Var>) -> Vec<Var> {
        let squares: Vec<Var> = vars.iter().map(|&var| square(tape, var)).collect();
        let pairs: Vec<[Var; 2]> = vars.chunks(2).zip(squares.chunks(2)).map(|(a, b)| [a[0], b[1]]).collect();
        let mut outputs = sums(tape, &pairs);
        outputs.extend(squares);
        outputs
    }

    #[test]
    fn sums_at_once_are_sums_one_by_one_to_the_bit() {
        let at_once = run(Device::Cpu, &inputs(), |tape, vars| uses(tape, vars, adds));
        let one_by_one =
            |tape: &mut Tape<f32>, pairs: &[[Var; 2]]| pairs.iter().map(|&[a, b]| add(tape, a, b)).collect();
        assert!(at_once == run(Device::Cpu, &inputs(), |tape, vars| uses(tape, vars, one_by_one)));
    }

    #[test]
    fn a_gpu_has_several_sums_at_once() {
        let Some(gpu) = test_gpu() else { return };
        let tight = Tolerance { value: 1e-6, gradient: 1e-6 };
        let faults = [
            ("sums of pairs", "a(item, at) + b", "a(item, at) - b"),
            ("sums of pairs", "+ b(item, at)", "+ b(0u, at)"),
        ];
        assert_noticed(&faults, || compare(gpu, "sums", &inputs(), tight, |tape, vars| uses(tape, vars, adds)));
        let result = || bits(&run(Device::Gpu(gpu), &inputs(), |tape, vars| uses(tape, vars, adds)));
        assert_equal_in_parts(result);
    }
}
