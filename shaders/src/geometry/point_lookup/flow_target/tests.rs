use super::gpu::{FlowBlock, TARGETS};
use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::{agree, noise};
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::tape::Device;

/// f32 against f64: positions are sums of products of coordinates and depths of a few scene units.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 0.0 };

/// Seen from z = −2.5, a little to the side, with a focal length of 20 px.
fn camera(angle: f64, width: usize, height: usize) -> PinholeCamera {
    let (sin, cos) = angle.sin_cos();
    PinholeCamera {
        width,
        height,
        focal: [20.0, 22.0],
        center: [0.5 * width as f64, 0.5 * height as f64],
        rotation: [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]],
        translation: [0.1, -0.2, 2.5],
    }
}

fn map(shape: &[usize], seed: u64, factor: f64, offset: f64) -> Tensor<f64> {
    let values = noise(shape.iter().product(), seed).into_iter().map(|value| offset + factor * value);
    Tensor::from_vec(shape, values.collect())
}

/// Maps with holes of every kind.
fn maps(knows_arrival: bool) -> FlowMaps<f64> {
    let mut depth = map(&[18, 24], 1, 0.3, 2.5);
    let mut flow = map(&[18, 24, 2], 2, 6.0, 1.0);
    let mut depth_to = map(&[20, 16], 3, 1.0, 3.0);
    for tensor in [&mut depth, &mut flow, &mut depth_to] {
        for (at, value) in tensor.make_mut().iter_mut().enumerate().step_by(17) {
            *value = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][at % 3];
        }
    }
    for tensor in [&mut depth, &mut depth_to] {
        tensor.make_mut().iter_mut().step_by(11).for_each(|value| *value = 0.0);
    }
    let (camera, camera_to) = (camera(0.2, 24, 18), camera(-0.1, 16, 20));
    FlowMaps { camera, depth, flow, camera_to, depth_to: knows_arrival.then_some(depth_to) }
}

fn single(maps: FlowMaps<f64>) -> FlowMaps<f32> {
    let FlowMaps { camera, depth, flow, camera_to, depth_to } = maps;
    FlowMaps { camera, depth: depth.cast(), flow: flow.cast(), camera_to, depth_to: depth_to.map(|depth| depth.cast()) }
}

/// Points around the surfaces that the maps show, some of them behind the camera or not numbers.
fn points(count: usize) -> Tensor<f32> {
    let mut points = map(&[count, 3], 4, 1.0, 0.0);
    for (at, point) in points.make_mut().as_chunks_mut::<3>().0.iter_mut().enumerate() {
        point[2] *= if at % 16 == 15 { 9.0 } else { 0.4 };
        if at % 50 == 49 {
            point[at / 50 % 3] = [f64::NAN, f64::INFINITY][at / 50 % 2];
        }
    }
    points.cast()
}

fn targets(knows_arrival: bool) -> impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var> {
    let maps = single(maps(knows_arrival));
    move |tape, vars| {
        let found = flow_targets(tape, vars[0], &maps);
        vec![found.positions, found.free, found.seen]
    }
}

fn compare_targets(gpu: Gpu, count: usize, knows_arrival: bool) -> Result<usize, Disagreement> {
    compare(gpu, &format!("targets of {count} points"), &[points(count)], TOLERANCE, targets(knows_arrival))
}

#[test]
fn the_kernel_is_valid() {
    for knows_arrival in [0, 1] {
        assert_valid::<FlowBlock>(&TARGETS, &[("KNOWS_ARRIVAL", knows_arrival)]);
    }
}

#[test]
fn a_gpu_follows_the_flow_where_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for knows_arrival in [false, true] {
        for count in [0, 1, 255, 257, 2000] {
            compare_targets(gpu, count, knows_arrival).unwrap();
        }
        let found = run(Device::Gpu(gpu), &[points(2000)], targets(knows_arrival));
        let [seen, free] = [2, 1].map(|at| found[at].1.as_slice().iter().filter(|value| **value != 0.0).count());
        assert!(seen > 100 && seen < 1000 && free > 50 && (free == 3 * seen) != knows_arrival, "{seen} {free}");
    }
}

#[test]
fn single_precision_agrees_with_double() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let vars = [tape.constant(points(300).cast())];
    let exact = flow_targets(&mut tape, vars[0], &maps(true));
    let found = run(Device::Cpu, &[points(300)], targets(true));
    for ((_, found), exact) in found.iter().zip([exact.positions, exact.free, exact.seen]) {
        agree(found, tape.value(exact), 1e-6).unwrap();
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("flow targets", "!(in_view.z > 0.0)", "!(in_view.z > 2.4)"),
        ("flow targets", "u32(pixel.y) * size.x", "u32(pixel.y) * (size.x + 1u)"),
        ("flow targets", "view.depth_tolerance * surface", "0.9 * view.depth_tolerance * surface"),
        ("flow targets", "is_finite(surface) && surface > 0.0", "is_finite(surface)"),
        ("flow targets", "pixel + shift", "pixel - shift"),
        ("flow targets", "view.size_to)", "view.size)"),
        ("flow targets", "- translation", "+ translation"),
        ("flow targets", "normalize(rotated_to_world(ray))", "normalize(ray)"),
    ];
    assert_noticed(&faults, || compare_targets(gpu, 2000, true));
}
