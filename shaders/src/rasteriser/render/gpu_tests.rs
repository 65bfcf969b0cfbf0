//! A GPU renders what the CPU renders, forward and backward.

use std::cell::RefCell;
use std::collections::BTreeMap;

use super::scene_tests::{camera, cast, images, splats, tensors, vars};
use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::{agree, noise};
use crate::gpu::Gpu;
use crate::gpu::parts::tests::assert_agree_in_parts;
use crate::gpu::tests::{bits, test_gpu};
use crate::rasteriser::ShapeVars;
use crate::rasteriser::binning::{Lists, TileLists};

/// Sums over hundreds of splats and pixels.
const TIGHT: Tolerance = Tolerance { value: 1e-4, gradient: 1e-3 };
/// At the edge of a splat, only one device may blend it into a pixel.
const FLIPS: Tolerance = Tolerance { value: 2.0 / 255.0, gradient: 2e-2 };

/// Renders one scene, with a number of features, on both devices: with its thresholds, and with smooth ones.
fn compare_renders(
    gpu: Gpu,
    (splats, features): (&SplatTensors<f64>, usize),
    camera: &PinholeCamera,
    settings: &RasterSettings,
) -> Result<usize, Disagreement> {
    let what = format!("{}×{}", camera.width, camera.height);
    let (inputs, f) = scene(splats, features, *camera, *settings);
    compare(gpu, &what, &inputs, FLIPS, f)?;
    let (inputs, f) = scene(splats, features, *camera, without_jumps(*settings));
    compare(gpu, &what, &inputs, TIGHT, f)
}

fn without_jumps(settings: RasterSettings) -> RasterSettings {
    RasterSettings { smooth_cutoff: true, transmittance_stop: 0.0, ..settings }
}

/// Renders the images of a scene from its inputs.
type RenderFn = Box<dyn Fn(&mut Tape<f32>, &[Var]) -> Vec<Var>>;

/// Inputs and function of a render.
fn scene(
    splats: &SplatTensors<f64>,
    features: usize,
    camera: PinholeCamera,
    settings: RasterSettings,
) -> (Vec<Tensor<f32>>, RenderFn) {
    let count = splats.positions.rows();
    let mut inputs = tensors(&cast::<f32>(splats));
    inputs.push(Tensor::from_vec([count, features.max(1)], noise(count * features.max(1), 5)).cast());
    let f = move |tape: &mut Tape<f32>, inputs: &[Var]| {
        let features = (features > 0).then_some(inputs[5]);
        images(&render(tape, &vars(&inputs[..5]), features, &camera, &settings).unwrap())
    };
    (inputs, Box::new(f))
}

fn default_with(depth: bool) -> RasterSettings {
    RasterSettings { depth, background: [0.3, 0.1, 0.6], ..RasterSettings::default() }
}

#[test]
fn a_gpu_renders_images_of_every_size() {
    let Some(gpu) = test_gpu() else { return };
    for [width, height] in [[1, 1], [1, 17], [17, 1], [15, 15], [16, 16], [17, 17], [33, 47]] {
        let scene = splats(60, -1.8, 7);
        compare_renders(gpu, (&scene, 0), &camera(width, height), &default_with(false)).unwrap();
    }
}

#[test]
fn a_gpu_renders_every_kind_of_channel_and_degree() {
    let Some(gpu) = test_gpu() else { return };
    for (features, depth, sh_degree) in [(0, true, 0), (1, false, 1), (2, true, 2), (13, true, 3)] {
        let settings = RasterSettings { sh_degree, ..default_with(depth) };
        compare_renders(gpu, (&splats(80, -2.0, 3), features), &camera(40, 36), &settings).unwrap();
    }
}

#[test]
fn a_gpu_renders_many_layers_and_large_splats() {
    let Some(gpu) = test_gpu() else { return };
    // Hundreds of entries per tile: pixels end early, and the opacities reach the cap.
    let mut scene = splats(700, -0.5, 11);
    scene.opacity_logits.make_mut().iter_mut().step_by(3).for_each(|logit| *logit = 8.0);
    let (inputs, f) = self::scene(&scene, 0, camera(50, 35), default_with(true));
    compare(gpu, "many layers", &inputs, FLIPS, f).unwrap();
}

#[test]
fn a_gpu_takes_factors_for_shapes() {
    let Some(gpu) = test_gpu() else { return };
    let scene = splats(50, -1.5, 6);
    let factors: Vec<f64> = noise(450, 8).iter().map(|value| 0.1 * value).collect();
    let inputs = [scene.positions, Tensor::from_vec([50, 3, 3], factors), scene.opacity_logits, scene.sh];
    let inputs: Vec<Tensor<f32>> = inputs.iter().map(Tensor::cast).collect();
    let f = |tape: &mut Tape<f32>, inputs: &[Var]| {
        let &[positions, factors, opacity_logits, sh] = inputs else { panic!("four variables") };
        let splats = SplatVars { positions, shape: ShapeVars::Factor(factors), opacity_logits, sh };
        images(&render(tape, &splats, None, &camera(40, 36), &without_jumps(default_with(true))).unwrap())
    };
    compare(gpu, "factors", &inputs, TIGHT, f).unwrap();
}

#[test]
fn a_gpu_that_renders_something_else_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let (inputs, _) = scene(&splats(60, -1.8, 7), 0, camera(40, 36), default_with(true));
    let changes: [fn(&mut RasterSettings); 3] = [
        |settings| settings.dilation = 0.31,
        |settings| settings.transmittance_stop = 0.05,
        |settings| settings.background = [0.3, 0.1, 0.61],
    ];
    for (index, change) in changes.into_iter().enumerate() {
        let f = |tape: &mut Tape<f32>, inputs: &[Var]| {
            let mut settings = without_jumps(default_with(true));
            if tape.device() != Device::Cpu {
                change(&mut settings);
            }
            images(&render(tape, &vars(&inputs[..5]), None, &camera(40, 36), &settings).unwrap())
        };
        assert!(compare(gpu, "a fault", &inputs, TIGHT, f).is_err(), "change {index}");
    }
}

#[test]
fn two_runs_on_a_gpu_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let (inputs, f) = scene(&splats(400, -1.5, 13), 3, camera(64, 48), default_with(true));
    let bits = || bits(&run(Device::Gpu(gpu), &inputs, &f));
    let first = bits();
    assert!((0..3).all(|_| bits() == first));
}

#[test]
fn a_render_in_parts_agrees_with_a_whole_one() {
    let Some(gpu) = test_gpu() else { return };
    for sh_degree in [0, 3] {
        let settings = without_jumps(RasterSettings { sh_degree, ..default_with(true) });
        let mut splats = splats(500, -1.5, 23);
        // Above the cap of alpha, which is counted.
        splats.opacity_logits.make_mut()[470..].fill(8.0);
        let (inputs, f) = scene(&splats, 2, camera(64, 48), settings);
        let result = || {
            let events = RefCell::new(BTreeMap::new());
            let results = run(Device::Gpu(gpu), &inputs, |tape, vars| {
                let images = f(tape, vars);
                tape.read_back();
                events.replace(tape.profile().events.clone());
                images
            });
            (results, events.into_inner())
        };
        type Rendered = (Vec<(String, Tensor<f32>)>, BTreeMap<&'static str, u64>);
        let are_near = |(found, events): &Rendered, (expected, expected_events): &Rendered| {
            let mut pairs = found.iter().zip(expected);
            events == expected_events
                && pairs.all(|((_, found), (_, expected))| agree(found, expected, TIGHT.gradient).is_ok())
        };
        // Projection, sorts, lists, blending and sums, forward and backward.
        assert!(assert_agree_in_parts(result, are_near) > 15);
    }
}

#[test]
fn nothing_visible_gives_the_background_on_a_gpu() {
    let Some(gpu) = test_gpu() else { return };
    let mut behind = splats(10, -1.5, 2);
    behind.positions.make_mut().as_chunks_mut::<3>().0.iter_mut().for_each(|position| position[2] -= 100.0);
    for scene in [splats(0, -1.5, 2), behind] {
        compare_renders(gpu, (&scene, 2), &camera(20, 18), &default_with(true)).unwrap();
    }
}

#[test]
fn poisoned_splats_are_culled_on_a_gpu_for_the_same_reasons() {
    let Some(gpu) = test_gpu() else { return };
    let mut scene = splats(64, -1.5, 9);
    let poison = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30];
    // A colour of 1e30 is not a poisoned value, and dominates everything else.
    let coefficients = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    for (index, (&value, coefficient)) in poison.iter().zip(coefficients).enumerate() {
        scene.positions.make_mut()[3 * (8 * index) + 1] = value;
        scene.log_scales.make_mut()[3 * (8 * index + 1)] = value;
        scene.rotations.make_mut()[4 * (8 * index + 2)] = value;
        scene.opacity_logits.make_mut()[8 * index + 3] = value;
        scene.sh.make_mut()[48 * (8 * index + 4) + 7] = coefficient;
        scene.positions.make_mut()[3 * (8 * index + 5) + 2] = -5.0 + index as f64;
        scene.rotations.make_mut()[4 * (8 * index + 6)..][..4].fill(0.0);
    }
    compare_renders(gpu, (&scene, 1), &camera(40, 36), &default_with(true)).unwrap();
    let cutoffs = |device| {
        let mut tape = Tape::new(device);
        let leaves = cast::<f32>(&scene).leaves(&mut tape);
        let projected = projection::project(&mut tape, &leaves, &camera(40, 36), &default_with(true));
        let cutoffs = tape.value(projected.cutoffs).as_slice().to_vec();
        cutoffs.into_iter().map(|cutoff| cutoff.min(0.0)).collect::<Vec<f32>>()
    };
    assert_eq!(cutoffs(Device::Gpu(gpu)), cutoffs(Device::Cpu));
}

/// Lists of a scene with many equal depths.
fn lists_of(device: Device, size: [usize; 2], log_scale: f64) -> (Vec<bool>, [usize; 2], TileLists) {
    let mut scene = splats(3000, log_scale, 17);
    // On planes before a camera that looks along z.
    scene.positions.make_mut().as_chunks_mut::<3>().0.iter_mut().for_each(|p| p[2] = (2.0 * p[2]).round());
    let camera =
        PinholeCamera { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ..camera(size[0], size[1]) };
    let mut tape = Tape::new(device);
    let leaves = cast::<f32>(&scene).leaves(&mut tape);
    let projected = projection::project(&mut tape, &leaves, &camera, &default_with(false));
    let lists = binning::bin(&mut tape, &projected, Grid { width: size[0], height: size[1] }).unwrap();
    let host = match &*lists {
        Lists::Host(lists) => lists.clone(),
        Lists::Gpu(lists) => lists.read_back(),
    };
    (lists.visible(), [lists.visible_count(), lists.entry_count()], host)
}

#[test]
fn a_gpu_lists_the_splats_of_every_tile_in_the_same_order() {
    let Some(gpu) = test_gpu() else { return };
    for (size, log_scale) in [([64, 48], -3.0), ([97, 129], -1.0), ([16, 16], -3.0)] {
        let found = lists_of(Device::Gpu(gpu), size, log_scale);
        assert!(found.1[1] > 1000, "{:?}", found.1);
        assert_eq!(found, lists_of(Device::Cpu, size, log_scale));
    }
}

#[test]
fn capacity_changes_no_render_and_overflow_is_reported() {
    let Some(gpu) = test_gpu() else { return };
    let scene = cast::<f32>(&splats(400, -2.0, 21));
    let run = |capacity: Option<usize>| {
        let mut tape = Tape::new(Device::Gpu(gpu));
        if let Some(capacity) = capacity {
            tape = tape.with_capacity(capacity);
        }
        let leaves = scene.leaves(&mut tape);
        let rendered = render(&mut tape, &leaves, None, &camera(60, 44), &default_with(false)).unwrap();
        let seed = Tensor::full([44, 60, 3], 1.0);
        let gradient = tape.backward(&[(rendered.color, seed)]).take(leaves.positions).unwrap();
        let found = tape.read_back();
        (tape.value(rendered.color).clone(), gradient, found)
    };
    let (image, gradient, exact) = run(None);
    assert!(!exact.overflowed && exact.intersections > 1000, "{exact:?}");
    for capacity in [exact.intersections, 3 * exact.intersections] {
        let (bounded, bounded_gradient, found) = run(Some(capacity));
        assert!(bounded == image && bounded_gradient == gradient && found == exact, "{found:?}");
    }
    let (.., found) = run(Some(exact.intersections - 1));
    assert_eq!((found.overflowed, found.intersections), (true, exact.intersections));
    assert!(run(Some(0)).2.overflowed);
}

#[test]
fn overflow_on_a_child_tape_is_reported_by_its_parent() {
    let Some(gpu) = test_gpu() else { return };
    let scene = cast::<f32>(&splats(400, -2.0, 21));
    let found_with = |capacity: usize, is_absorbed: bool| {
        let mut tape = Tape::new(Device::Gpu(gpu)).with_capacity(capacity);
        let mut child = tape.child();
        let splats = scene.constants(&mut child);
        render(&mut child, &splats, None, &camera(60, 44), &default_with(false)).unwrap();
        if is_absorbed {
            tape.absorb(child);
        }
        tape.read_back()
    };
    let wanted = found_with(1 << 20, true);
    assert!(!wanted.overflowed && wanted.intersections > 1000, "{wanted:?}");
    assert!(found_with(wanted.intersections - 1, true).overflowed);
    assert!(!found_with(wanted.intersections - 1, false).overflowed, "not absorbed");
}

#[test]
fn an_empty_render_leaves_spare_capacity_unused() {
    let Some(gpu) = test_gpu() else { return };
    let mut scene = cast::<f32>(&splats(10, -2.0, 11));
    scene.positions.make_mut().chunks_exact_mut(3).for_each(|position| position[2] = -50.0);
    let mut tape = Tape::new(Device::Gpu(gpu)).with_capacity(1000);
    let vars = scene.constants(&mut tape);
    let rendered = render(&mut tape, &vars, None, &camera(33, 17), &default_with(false)).unwrap();
    assert!(tape.value(rendered.color).as_slice().chunks_exact(3).all(|pixel| pixel == [0.3, 0.1, 0.6]));
    assert_eq!((rendered.stats().visible, rendered.stats().intersections), (0, 0));
}
