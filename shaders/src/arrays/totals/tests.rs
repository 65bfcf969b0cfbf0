use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::tests::test_gpu;
use crate::tape::Device;

#[test]
fn a_weighted_mean_is_that_of_what_counts() {
    let mean_of = |weights: [f64; 4]| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let x = tape.leaf(Tensor::from_vec([4], vec![1.0, f64::NAN, 3.0, f64::INFINITY]));
        let weights = tape.constant(Tensor::from_vec([4], weights.to_vec()));
        let mean = weighted_mean(&mut tape, x, weights);
        let gradient = tape.backward(&[(mean, Tensor::scalar(1.0))]).take(x).unwrap();
        (tape.value(mean).as_slice()[0], gradient.into_vec())
    };
    assert_eq!(mean_of([1.0, 0.0, 1.0, 0.0]), (2.0, vec![0.5, 0.0, 0.5, 0.0]));
    assert_eq!(mean_of([0.0; 4]), (0.0, vec![0.0; 4]));
    assert!(mean_of([1.0; 4]).0.is_nan());
}

const OF_SUMS: Tolerance = Tolerance { value: 1e-5, gradient: 1e-4 };

fn compare_totals(gpu: Gpu, shape: [usize; 3]) -> Result<usize, Disagreement> {
    let x = Tensor::from_vec(shape, noise(shape.iter().product(), 1)).cast();
    let both = |tape: &mut Tape<f32>, vars: &[Var]| vec![mean(tape, vars[0]), total(tape, vars[0])];
    compare(gpu, &format!("totals of {shape:?}"), &[x], OF_SUMS, both)
}

#[test]
fn a_gpu_takes_totals() {
    let Some(gpu) = test_gpu() else { return };
    for shape in [[1, 1, 3], [40, 35, 3], [70, 90, 3]] {
        compare_totals(gpu, shape).unwrap();
    }
    let faults = [("total backward", "spread.factor * dy[0]", "spread.factor"), ("total", "total.factor * sum", "sum")];
    assert_noticed(&faults, || compare_totals(gpu, [20, 7, 3]));
}
