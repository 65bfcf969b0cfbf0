use super::*;
use crate::check::conformance::{Tolerance, compare};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::rasteriser::slicing4d::{Gaussians4dVars, slice};
use crate::tape::{Device, Tape, Var};

/// Gradients go through divisions by deviations in time, which differ by orders of magnitude.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-4 };
const TIME: f64 = 0.45;

/// Gaussians of all proportions; every twentieth has no direction or is too short in time.
fn inputs(count: usize) -> Vec<Tensor<f32>> {
    let tensor = |len: usize, seed: u64, factor: f64, offset: f64| {
        let values = noise(count * len, seed).into_iter().map(|value| (offset + factor * value) as f32).collect();
        Tensor::from_vec([count, len], values)
    };
    let mut inputs = vec![
        tensor(3, 1, 0.7, -1.5),
        tensor(1, 2, 0.5, -1.0),
        tensor(4, 3, 1.0, 0.0),
        tensor(4, 4, 1.0, 0.0),
        tensor(1, 5, 0.4, 0.5),
        tensor(1, 6, 4.0, 0.0),
    ];
    for row in (0..count).step_by(20) {
        inputs[2].make_mut()[4 * row..][..4].fill(0.0);
    }
    inputs
}

fn vars(inputs: &[Var]) -> Gaussians4dVars {
    let &[log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits] = inputs else {
        panic!("six variables")
    };
    Gaussians4dVars { log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits }
}

/// The slices with more than this share of the opacity, and their presence flags.
fn sliced(least_share: f64) -> impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var> {
    move |tape, inputs| {
        let sliced = slice(tape, &vars(inputs), TIME, least_share);
        vec![sliced.displacements, sliced.velocities, sliced.factors, sliced.opacity_logits]
    }
}

/// Shares that keep all, some and none of the Gaussians.
const SHARES: [f64; 3] = [1e-300, 0.5, 1.0];

#[test]
fn kernels_are_valid() {
    assert_valid::<SlicingBlock>(&FORWARD, &[]);
    for mask in [0b1111, 0b0100] {
        assert_valid::<SlicingBlock>(&BACKWARD, &[("ARRIVING", mask)]);
    }
}

#[test]
fn a_gpu_slices_what_the_cpu_slices() {
    let Some(gpu) = test_gpu() else { return };
    for count in [0, 1, 63, 64, 65, 500] {
        for share in SHARES {
            compare(gpu, &format!("{count} slices"), &inputs(count), TOLERANCE, sliced(share)).unwrap();
        }
    }
}

#[test]
fn gradients_of_single_outputs_agree() {
    let Some(gpu) = test_gpu() else { return };
    for output in 0..4 {
        let f = |tape: &mut Tape<f32>, inputs: &[Var]| vec![sliced(0.5)(tape, inputs)[output]];
        compare(gpu, "one output", &inputs(90), TOLERANCE, f).unwrap();
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("slicing4d", "rotation[3] * scales)", "rotation[3] * scales.yxzw)"),
        ("slicing4d", "e + rest", "e + 0.999 * rest"),
        ("slicing4d backward", "g_deviation -= g", "g_deviation -= 1.01 * g"),
        ("slicing4d backward", "inverse * inverse * inverse", "inverse * inverse"),
    ];
    let inputs = inputs(100);
    assert_noticed(&faults, || compare(gpu, "slices", &inputs, TOLERANCE, sliced(SHARES[0])));
    let faults = [
        ("slicing4d", "<= slicing.least_log_share", "<= 1.3 * slicing.least_log_share"),
        ("slicing4d backward", "<= slicing.least_log_share", "<= 0.7 * slicing.least_log_share"),
    ];
    assert_noticed(&faults, || compare(gpu, "slices", &inputs, TOLERANCE, sliced(0.5)));
}

#[test]
fn a_gpu_hides_what_the_cpu_hides() {
    let Some(gpu) = test_gpu() else { return };
    for count in [0, 1, 31, 33, 256, 257, 3000] {
        let present = |device| {
            let mut tape = Tape::new(device);
            let vars = vars(&inputs(count).into_iter().map(|input| tape.constant(input)).collect::<Vec<_>>());
            let sliced = slice(&mut tape, &vars, TIME, 0.5);
            tape.value(sliced.present).as_slice().to_vec()
        };
        let (found, expected) = (present(Device::Gpu(gpu)), present(Device::Cpu));
        assert_eq!(found, expected);
        let shown = found.iter().sum::<f32>();
        assert!(count < 3000 || (300.0..2700.0).contains(&shown), "{shown} rows");
    }
}
