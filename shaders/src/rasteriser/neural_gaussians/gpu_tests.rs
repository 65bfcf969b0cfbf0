use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::readbacks_of_this_thread;
use crate::gpu::tests::test_gpu;
use crate::rasteriser::neural_gaussians::{AnchorVars, neural_gaussians, spawn};
use crate::tape::{Device, Tape, Var};

const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };

/// Positions, scales, offsets, opacities, shapes and colours; opacities are negative, positive and at both ends.
fn inputs(anchors: usize, per_anchor: usize) -> Vec<Tensor<f32>> {
    let tensor = |columns: usize, seed: u64, factor: f64, offset: f64| {
        let values = noise(anchors * columns, seed).into_iter().map(|value| (offset + factor * value) as f32);
        Tensor::from_vec([anchors, columns], values.collect())
    };
    let mut opacities = tensor(per_anchor, 4, 0.9, 0.0);
    for (index, opacity) in opacities.make_mut().iter_mut().enumerate().step_by(7) {
        *opacity = [1.0, 1e-9, 0.0][index % 3];
    }
    vec![
        tensor(3, 1, 2.0, 0.0),
        tensor(6, 2, 1.0, -1.0),
        tensor(3 * per_anchor, 3, 1.0, 0.0),
        opacities,
        tensor(7 * per_anchor, 5, 2.0, 0.0),
        tensor(3 * per_anchor, 6, 0.5, 0.5),
    ]
}

/// Compares the outputs with the indices `picked`.
fn compare_spawned(gpu: Gpu, inputs: &[Tensor<f32>], picked: &[usize]) -> Result<usize, Disagreement> {
    let f = |tape: &mut Tape<f32>, vars: &[Var]| {
        let &[positions, log_scales, offsets, opacities, shapes, colors] = vars else { panic!("six variables") };
        let anchors = AnchorVars { positions, log_scales, offsets, opacities, shapes, colors };
        let chosen = Chosen::all(tape.value(opacities));
        let found = spawn(tape, &anchors, chosen);
        let all = [found.positions, found.log_scales, found.rotations, found.opacity_logits, found.sh];
        picked.iter().map(|&output| all[output]).collect()
    };
    compare(gpu, &format!("Gaussians of {} anchors", inputs[0].rows()), inputs, TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    assert_valid::<SpawnBlock>(&FORWARD, &[]);
    for kernel in [BACKWARD, ANCHORS_BACKWARD] {
        assert_valid::<SpawnBlock>(&kernel, &[("ARRIVING", 0b10101)]);
    }
}

#[test]
fn a_gpu_spawns_what_the_cpu_spawns() {
    let Some(gpu) = test_gpu() else { return };
    for (anchors, per_anchor) in [(0, 4), (1, 1), (1, 10), (255, 2), (257, 5)] {
        compare_spawned(gpu, &inputs(anchors, per_anchor), &[0, 1, 2, 3, 4]).unwrap();
    }
    // One gradient alone, and no Gaussian at all.
    for output in 0..5 {
        compare_spawned(gpu, &inputs(40, 3), &[output]).unwrap();
    }
    let mut none = inputs(40, 3);
    none[3] = Tensor::full([40, 3], -0.5);
    compare_spawned(gpu, &none, &[0, 1, 2, 3, 4]).unwrap();
}

#[test]
fn a_gpu_does_not_look_which_gaussians_there_are() {
    let Some(gpu) = test_gpu() else { return };
    let mut tape = Tape::new(Device::Gpu(gpu));
    let vars: Vec<Var> = inputs(30, 4).into_iter().map(|input| tape.constant(input)).collect();
    let &[positions, log_scales, offsets, opacities, shapes, colors] = &vars[..] else { panic!("six variables") };
    let anchors = AnchorVars { positions, log_scales, offsets, opacities, shapes, colors };
    let before = readbacks_of_this_thread();
    let found = neural_gaussians(&mut tape, &anchors);
    assert_eq!(readbacks_of_this_thread(), before);
    assert!(found.slots.is_none() && tape.value(found.positions).rows() == 120);
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("neural gaussians", "6u * anchor + 3u + axis", "6u * anchor + axis"),
        ("neural gaussians backward", "!(opacity > HIGH)", "!(opacity > 1.0)"),
        ("neural gaussians backward", "exp(log_sigmoid(-shapes", "exp(log_sigmoid(shapes"),
        ("neural gaussians", "opacities[gaussian] <= 0.0", "opacities[gaussian] < 0.0"),
        ("neural gaussians backward, anchors", "g_position += g;", "g_position = g;"),
    ];
    assert_noticed(&faults, || compare_spawned(gpu, &inputs(100, 4), &[0, 1, 2, 3, 4]));
}
