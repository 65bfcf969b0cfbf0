//! Gradients that add up, where a value is used more than once.

use super::chunks::{CHUNK, for_each_chunk};
use super::pair_sums::sums_on_gpu;
use super::{Real, Tensor};
use crate::gpu::{Gpu, GpuArray};

/// Adds the gradients of those inputs that need one to their totals; on a GPU in one launch.
pub(super) fn add_all<T: Real>(
    op: &str,
    totals: &mut [Option<Tensor<T>>],
    terms: Vec<Option<Tensor<T>>>,
    needs: &[bool],
) {
    assert_eq!(terms.len(), totals.len(), "{op}: one gradient per input");
    let mut pairs = Vec::new();
    for ((total, term), &needed) in totals.iter_mut().zip(terms).zip(needs) {
        match (needed, term, total) {
            (true, Some(term), total @ None) => *total = Some(term),
            (true, Some(term), Some(total)) => pairs.push((total, term)),
            (false, ..) | (_, None, _) => {}
        }
    }
    add_pairs(pairs);
}

/// The array of an input's total gradient, and whether kernels must add to it. If not, it is a new array of this shape
/// with undefined content, and kernels must write all of it.
pub(crate) fn total_on_gpu<'a, T: Real>(
    gpu: Gpu,
    total: &'a mut Option<Tensor<T>>,
    shape: &[usize],
) -> (&'a GpuArray, bool) {
    let adds = total.is_some();
    let total = total.get_or_insert_with(|| Tensor::from_gpu(shape, GpuArray::new(gpu, shape.iter().product())));
    (total.make_mut_on_gpu(gpu), adds)
}

/// total += term, where an absent total is zero.
pub(super) fn add_to<T: Real>(total: &mut Option<Tensor<T>>, term: Tensor<T>) {
    match total {
        None => *total = Some(term),
        Some(total) => add_pairs(vec![(total, term)]),
    }
}

/// total += term for every pair; on the GPU if either of a pair is on it.
fn add_pairs<T: Real>(pairs: Vec<(&mut Tensor<T>, Tensor<T>)>) {
    let mut on_gpu = Vec::new();
    for (total, term) in pairs {
        assert_eq!(term.shape(), total.shape(), "two gradients of one value differ in shape");
        match total.gpu().or(term.gpu()) {
            Some(gpu) => on_gpu.push((gpu, total, term)),
            None => add(total, &term),
        }
    }
    if let Some(&(gpu, ..)) = on_gpu.first() {
        let pairs: Vec<[&Tensor<T>; 2]> = on_gpu.iter().map(|(_, total, term)| [&**total, term]).collect();
        let sums = sums_on_gpu(gpu, &pairs);
        on_gpu.into_iter().zip(sums).for_each(|((_, total, _), sum)| *total = sum);
    }
}

fn add<T: Real>(total: &mut Tensor<T>, term: &Tensor<T>) {
    let term = term.as_slice();
    for_each_chunk(total.make_mut(), CHUNK, |first, total| {
        total.iter_mut().zip(&term[first..]).for_each(|(total, &term)| *total += term);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::conformance::{Tolerance, compare};
    use crate::check::noise;
    use crate::gpu::fault_tests::assert_noticed;
    use crate::gpu::grouped::tests::with_arrays;
    use crate::gpu::tests::test_gpu;
    use crate::pointwise::{add, mul, square};
    use crate::tape::{Tape, Var};

    /// Σ of a²·b, b + a and a: the gradient of every input is shared and summed over several uses.
    fn uses(tape: &mut Tape<f32>, vars: &[Var]) -> Vec<Var> {
        let halves = vars.len() / 2;
        let mut outputs = Vec::new();
        for (&a, &b) in vars[..halves].iter().zip(&vars[halves..]) {
            let squared = square(tape, a);
            let product = mul(tape, squared, b);
            let sum = add(tape, product, b);
            outputs.extend([add(tape, sum, a), mul(tape, a, b)]);
        }
        outputs
    }

    #[test]
    fn a_gpu_adds_the_gradients_of_repeated_uses() {
        let Some(gpu) = test_gpu() else { return };
        let input = |seed: usize| {
            let shape = [[7, 3], [1, 1], [300, 2], [0, 4], [257, 1]][seed % 5];
            Tensor::from_vec(shape, noise(shape[0] * shape[1], seed as u64)).cast()
        };
        let inputs: Vec<Tensor<f32>> = (0..10).map(input).collect();
        let exact = Tolerance { value: 1e-6, gradient: 1e-6 };
        let faults = [("sums of pairs", "a(item, at) + b", "a(item, at) - b")];
        assert_noticed(&faults, || compare(gpu, "repeated uses", &inputs, exact, uses));
    }

    #[test]
    fn what_others_have_of_a_total_stays() {
        let Some(gpu) = test_gpu() else { return };
        let tensor = |value: f32, len: usize| {
            let tensor = Tensor::full([len], value);
            tensor.on_gpu(gpu);
            tensor
        };
        let lens = [5, 0, 1000, 1, 257, 256, 3];
        let mut totals: Vec<Option<Tensor<f32>>> = lens.iter().map(|&len| Some(tensor(1.0, len))).collect();
        totals[0] = None;
        let shared = totals[2].clone().unwrap();
        let terms: Vec<_> = lens.iter().map(|&len| Some(tensor(2.5, len))).collect();
        let needs = [true, true, true, true, false, true, true];
        with_arrays(4, || add_all("test", &mut totals, terms, &needs));
        for ((total, len), expected) in totals.iter().zip(lens).zip([2.5, 0.0, 3.5, 3.5, 1.0, 3.5, 3.5]) {
            assert_eq!(total.as_ref().unwrap().as_slice(), vec![expected; len]);
        }
        assert_eq!(shared.as_slice(), vec![1.0; 1000]);
    }
}
