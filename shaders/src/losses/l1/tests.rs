use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::{TOLERANCE, gradients, noise};
use crate::gpu::Gpu;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::tests::test_gpu;
use crate::tape::Device;

fn image(seed: u64) -> Tensor<f64> {
    Tensor::from_vec([6, 7, 3], noise(6 * 7 * 3, seed).iter().map(|x| 0.5 + 0.4 * x).collect())
}

fn loss(lambda: f64) -> (f64, usize) {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let (render, target) = (tape.leaf(image(1)), tape.constant(image(2)));
    let total = l1_dssim(&mut tape, render, target, lambda);
    (tape.value(total).as_slice()[0], tape.profile().ops.len())
}

#[test]
fn gradients_equal_central_differences() {
    for lambda in [0.0, 0.2, 1.0] {
        let total = |tape: &mut Tape<f64>, vars: &[Var]| {
            let target = tape.constant(image(2));
            l1_dssim(tape, vars[0], target, lambda)
        };
        gradients(total, &[image(1)], TOLERANCE).unwrap();
    }
}

#[test]
fn the_mixture_is_linear_in_lambda() {
    let l1 = image(1).as_slice().iter().zip(image(2).as_slice()).map(|(x, y)| (x - y).abs()).sum::<f64>() / 126.0;
    assert!((loss(0.0).0 - l1).abs() <= 1e-15);
    assert!((loss(0.2).0 - (0.8 * l1 + 0.2 * loss(1.0).0)).abs() <= 1e-15);
}

#[test]
fn a_weight_of_zero_costs_nothing() {
    assert_eq!((loss(0.0).1, loss(0.2).1), (1, 3), "kinds of operations");
}

#[test]
fn equal_images_have_no_l1_gradient() {
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let (render, target) = (tape.leaf(image(1).cast()), tape.constant(image(1).cast()));
    let total = l1(&mut tape, render, target);
    let gradient = tape.backward(&[(total, Tensor::scalar(1.0))]).take(render).unwrap();
    assert!(gradient.as_slice().iter().all(|&gradient| gradient == 0.0));
}

const OF_SUMS: Tolerance = Tolerance { value: 1e-5, gradient: 1e-4 };

fn compare_losses(gpu: Gpu, shape: [usize; 3]) -> Result<usize, Disagreement> {
    let image = |seed| Tensor::from_vec(shape, noise(shape.iter().product(), seed)).cast();
    let target: Tensor<f32> = image(2);
    compare(gpu, &format!("losses of {shape:?}"), &[image(1)], OF_SUMS, |tape, vars| {
        let target = tape.constant(target.clone());
        vec![l1(tape, vars[0], target), l1_dssim(tape, vars[0], target, 0.2)]
    })
}

#[test]
fn a_gpu_takes_losses() {
    let Some(gpu) = test_gpu() else { return };
    for shape in [[1, 1, 3], [40, 35, 3], [70, 90, 3]] {
        compare_losses(gpu, shape).unwrap();
    }
    let faults = [
        ("l1", "abs(render[at] - image[at])", "render[at] - image[at]"),
        ("l1 backward", "l1.factor * dy[0]", "dy[0]"),
    ];
    assert_noticed(&faults, || compare_losses(gpu, [20, 7, 3]));
}
