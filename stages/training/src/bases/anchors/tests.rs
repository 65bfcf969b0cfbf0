use scene::TimeMap;
use shaders::check::{self, noise, test_gpu};
use shaders::geometry::camera::PinholeCamera;
use shaders::gpu::readbacks_of_this_thread;
use shaders::rasteriser::{RasterSettings, render};
use shaders::tape::{Device, Tape, Tensor};

use super::*;
use crate::data::Streams;
use crate::method::{AfterStep, Parents, RenderRecord, ScreenGradients, ScreenStats, StepHook};
use crate::model::{ModelState, Optimizer};

/// Two Gaussians per anchor, voxels of one unit.
fn settings() -> AnchorSettings {
    AnchorSettings { voxel_size: 1.0, offsets: 2, features: 2, width: 4, ..AnchorSettings::default() }
}

fn camera() -> PinholeCamera {
    PinholeCamera {
        width: 20,
        height: 20,
        focal: [20.0; 2],
        center: [10.0; 2],
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0, 0.0, 5.0],
    }
}

fn scene() -> SceneFacts {
    let time_map = TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 };
    SceneFacts { extent: 10.0, unit_world: 1.0, time_map, background: [0.0; 3], time_count: 4 }
}

fn state_at(positions: &[[f32; 3]]) -> ModelState<f32> {
    let mut state = ModelState::new();
    insert_anchors(&mut state, positions.to_vec(), &settings(), &scene());
    state
}

/// Growth with statistics from the first iteration and intervals of ten.
fn growth(change: impl FnOnce(&mut Density)) -> AnchorGrowth {
    let mut density = Density { interval: 10, from: 0, until: 1000, min_opacity: 0.1, ..Density::default() };
    change(&mut density);
    let settings = AnchorSettings { growth: Growth { statistics_from: 0, ..Growth::default() }, ..settings() };
    AnchorGrowth::new(&density, &settings, 1.0, 1.0)
}

/// Values of a render of anchors with two Gaussians each.
#[derive(Clone)]
struct Seen {
    gaussians: ScreenGradients,
    anchors: Parents,
}

impl Seen {
    /// Gradients and opacities of every Gaussian, with every anchor in view.
    fn of(gradients: &[f32], opacities: &[f32]) -> Self {
        let gaussians = ScreenGradients {
            gradient_ndc: gradients.iter().map(|&gradient| [gradient, 0.0]).collect(),
            visible: opacities.iter().map(|&opacity| opacity > 0.0).collect(),
            radius_px: vec![1.0; gradients.len()],
        };
        let of_anchors: Vec<f32> = opacities.as_chunks::<2>().0.iter().map(|[a, b]| a + b).collect();
        let shape = [of_anchors.len(), 1];
        Self {
            gaussians,
            anchors: Parents { in_view: Tensor::full(shape, 1.0), opacity: Tensor::from_vec(shape, of_anchors) },
        }
    }

    fn screen(&self) -> ScreenStats<'static> {
        ScreenStats::of(ANCHORS, self.gaussians.clone()).with_parents(self.anchors.clone())
    }
}

/// The anchors after an interval of equal renders.
fn after_interval(control: &mut AnchorGrowth, state: ModelState<f32>, seen: &Seen) -> ModelState<f32> {
    let scene = scene();
    let mut optimizer = Optimizer::new(state, |_| Some(LogLinear::constant(1e-3)));
    for iteration in 1..=10 {
        control.observe(&seen.screen());
        let random = &mut Streams::new(3).step("fine", iteration);
        let (optimizer, scene, notices, surveys) = (&mut optimizer, &scene, &mut Vec::new(), Vec::new());
        control.after_step(AfterStep { iteration, optimizer, detail: None, surveys, scene, random, notices }).unwrap();
    }
    optimizer.into_state()
}

fn positions(state: &ModelState<f32>) -> Vec<[f32; 3]> {
    state.get("anchors.positions").unwrap().as_slice().as_chunks::<3>().0.to_vec()
}

#[test]
fn a_voxel_holds_one_anchor_at_its_centre() {
    let points = [[0.2, 0.1, 0.0], [-0.4, 0.3, 0.49], [3.2, 0.0, -1.6]];
    assert_eq!(voxels(&points, 1.0), [([0.0, 0.0, 0.0], 0), ([3.0, 0.0, -2.0], 2)]);
    assert!(voxels(&[], 1.0).is_empty());
}

#[test]
fn anchors_without_gradients_do_not_change() {
    let state = state_at(&[[0.0; 3], [40.0, 0.0, 0.0]]);
    let quiet = Seen::of(&[1e-6; 4], &[0.5; 4]);
    assert_eq!(after_interval(&mut growth(|_| ()), state.clone(), &quiet), state);
}

#[test]
fn a_gaussian_with_a_large_gradient_becomes_an_anchor() {
    let mut state = state_at(&[[0.0; 3], [40.0, 0.0, 0.0]]);
    // The second Gaussian of the first anchor is 100 units above it.
    let mut offsets = Tensor::zeros([2, 6]);
    offsets.make_mut()[4] = 100.0;
    state.insert("anchors.offsets", offsets);
    state.insert("anchors.log_scales", Tensor::zeros([2, 6]));
    state.insert("anchors.features", Tensor::from_vec([2, 2], vec![1.0, 2.0, 3.0, 4.0]));
    let pulled = Seen::of(&[0.0, 1.0, 0.0, 0.0], &[0.5; 4]);
    let grown = after_interval(&mut growth(|_| ()), state, &pulled);
    let found = positions(&grown);
    assert!(found.len() > 2, "nothing grew");
    for (index, position) in found.iter().enumerate().skip(2) {
        assert!((position[1] - 100.0).abs() <= 8.0 && position[0] == 0.0, "{position:?}");
        assert_eq!(grown.get("anchors.features").unwrap().row(index), [1.0, 2.0]);
        assert_eq!(grown.get("anchors.offsets").unwrap().row(index), [0.0; 6]);
    }
    // Cells of 16, 4 and 1 voxels.
    let scales: Vec<f32> = (2..found.len()).map(|row| grown.get("anchors.log_scales").unwrap().row(row)[0]).collect();
    assert!(scales.iter().all(|scale| [16.0_f32, 4.0, 1.0].iter().any(|cell| (scale - cell.ln()).abs() <= 1e-6)));
}

#[test]
fn growth_respects_the_cap_on_anchors() {
    let mut state = state_at(&[[0.0; 3], [40.0, 0.0, 0.0]]);
    let mut offsets = Tensor::zeros([2, 6]);
    (0..4).for_each(|slot| offsets.make_mut()[3 * slot + 1] = 100.0 * (slot + 1) as f32);
    state.insert("anchors.offsets", offsets);
    state.insert("anchors.log_scales", Tensor::zeros([2, 6]));
    let pulled = Seen::of(&[1.0; 4], &[0.5; 4]);
    let count = |max_count| {
        positions(&after_interval(&mut growth(|density| density.max_count = max_count), state.clone(), &pulled)).len()
    };
    assert_eq!((count(2), count(3)), (2, 3));
    assert!(count(1000) > 3);
}

#[test]
fn only_transparent_anchors_in_view_are_pruned() {
    let state = state_at(&[[0.0; 3], [40.0, 0.0, 0.0], [0.0, 40.0, 0.0]]);
    let mut quiet = Seen::of(&[0.0; 6], &[0.04, 0.05, 0.5, 0.0, 0.0, 0.0]);
    quiet.anchors.in_view.make_mut()[2] = 0.0;
    let left = after_interval(&mut growth(|_| ()), state, &quiet);
    assert_eq!(positions(&left), [[40.0, 0.0, 0.0], [0.0, 40.0, 0.0]]);
}

#[test]
fn the_last_anchor_is_never_pruned() {
    let state = state_at(&[[0.0; 3], [40.0, 0.0, 0.0]]);
    let left = after_interval(&mut growth(|_| ()), state, &Seen::of(&[0.0; 4], &[0.01, 0.0, 0.0, 0.02]));
    assert_eq!(positions(&left), [[40.0, 0.0, 0.0]]);
}

#[test]
fn statistics_survive_a_checkpoint() {
    let mut control = growth(|_| ());
    control.observe(&Seen::of(&[1e-3, 0.0, 2e-3, 0.0], &[0.5, 0.1, 0.2, 0.0]).screen());
    let mut restored = growth(|_| ());
    restored.restore(control.save()).unwrap();
    assert_eq!(restored.save(), control.save());
    assert_ne!(restored.save(), growth(|_| ()).save());
    assert!(restored.restore(serde_json::json!({ "gradient_sum": "no" })).is_err());
}

#[test]
fn spawned_gaussians_have_slots_and_parents_in_view() {
    let mut state: ModelState<f64> = state_at(&[[0.0; 3], [0.0, 0.0, -20.0], [50.0, 0.0, 0.0]]).cast();
    insert_view_networks(&mut state, &settings(), true, Streams::new(1));
    // Opacities that do not depend on the view: one of two Gaussians.
    state.insert("views.opacity.1.weight", Tensor::zeros([2, 4]));
    state.insert("views.opacity.1.bias", Tensor::from_vec([2], vec![-1.0, 1.0]));
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let anchors = Anchors::stored(&model);
    let spawned = spawn(&mut tape, &model, &anchors, None, &camera());
    assert_eq!(**spawned.slots.as_ref().unwrap(), [1, 3, 5]);
    let parents = spawned.rows().parents;
    assert_eq!((spawned.rows().count, tape.value(parents.in_view).as_slice()), (6, &[1.0, 0.0, 0.0][..]));
    check::agree(tape.value(parents.opacity), &Tensor::from_vec([3, 1], vec![1.0_f64.tanh(), 0.0, 0.0]), 1e-12)
        .unwrap();
    let logits = tape.value(spawned.splats.opacity_logits);
    // tanh 1 = (e − 1/e) / (e + 1/e), whose logit is ln((e² − 1) / 2).
    let expected = ((2.0_f64.exp() - 1.0) / 2.0).ln();
    check::agree(logits, &Tensor::full([3, 1], expected), 1e-12).unwrap();
    check::agree(tape.value(spawned.splats.positions), state.get("anchors.positions").unwrap(), 1e-12).unwrap();
}

/// Forty anchors around the origin, some of them outside of the image, with networks.
fn scattered() -> ModelState<f32> {
    let places: Vec<f32> = noise(120, 1).iter().map(|&place| 4.0 * place as f32).collect();
    let mut state = state_at(places.as_chunks::<3>().0);
    insert_view_networks(&mut state, &settings(), true, Streams::new(1));
    state
}

/// Statistics of three steps of two views each on a device, and the number of readbacks.
fn observed_on(device: Device) -> (serde_json::Value, u64) {
    let (state, mut control, mut readbacks) = (scattered(), growth(|_| ()), 0);
    let settings = RasterSettings { sh_degree: 0, ..RasterSettings::default() };
    for step in 0..3 {
        let mut tape = Tape::new(device);
        let model = state.bind(&mut tape, |_| true);
        let render_view = |view: i32, tape: &mut Tape<f32>| {
            let camera = PinholeCamera { translation: [f64::from(step), f64::from(view), 5.0], ..camera() };
            let spawned = spawn(tape, &model, &Anchors::stored(&model), None, &camera);
            let rendered = render(tape, &spawned.splats, None, &camera, &settings).unwrap();
            let (population, rows) = (ANCHORS.into(), spawned.rows());
            RenderRecord { population, rendered, size_px: [20.0; 2], count: rows.count, rows: Some(rows) }
        };
        let renders: Vec<RenderRecord> = (0..2).map(|view| render_view(view, &mut tape)).collect();
        let weights = Tensor::from_vec([20, 20, 3], noise(1200, 4).iter().map(|&weight| weight as f32).collect());
        let gradients = tape.backward(&[0, 1].map(|view| (renders[view].rendered.color, weights.clone())));
        let before = readbacks_of_this_thread();
        let populations = ScreenStats::by_population(&renders, &tape, &gradients);
        populations.iter().for_each(|stats| control.observe(stats));
        readbacks += readbacks_of_this_thread() - before;
    }
    (control.save(), readbacks)
}

#[test]
fn a_gpu_adds_the_same_statistics_without_readbacks() {
    let Some(gpu) = test_gpu() else { return };
    let ((on_cpu, _), (on_gpu, readbacks)) = (observed_on(Device::Cpu), observed_on(Device::Gpu(gpu)));
    assert_eq!(readbacks, 0);
    let values = |saved: &serde_json::Value, name: &str| {
        let values: Vec<f64> =
            saved["statistics"][name].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect();
        Tensor::from_vec([values.len()], values)
    };
    for (name, tolerance) in [("seen_count", 0.0), ("view_count", 0.0), ("opacity_sum", 1e-5), ("gradient_sum", 2e-3)] {
        let [cpu, gpu] = [&on_cpu, &on_gpu].map(|saved| values(saved, name));
        check::agree(&gpu, &cpu, tolerance).unwrap_or_else(|mismatch| panic!("{name}: {mismatch}"));
        let zeros = cpu.as_slice().iter().filter(|value| **value == 0.0).count();
        assert!(zeros > 0 && zeros < cpu.len(), "{name}: the test needs both kinds");
    }
}

#[test]
fn invalid_settings_are_refused() {
    assert!(settings().check().keys().is_empty());
    assert!(DeformationSettings::default().check().keys().is_empty());
    let bad = [
        ("voxel_size", AnchorSettings { voxel_size: 0.0, ..settings() }),
        ("offsets", AnchorSettings { offsets: 0, ..settings() }),
        ("feature_rate", AnchorSettings { feature_rate: f64::NAN, ..settings() }),
        ("growth.success", AnchorSettings { growth: Growth { success: 1.0, ..Growth::default() }, ..settings() }),
    ];
    bad.iter().for_each(|(key, settings)| assert_eq!(settings.check().keys(), [*key]));
    let mut fields = DeformationSettings::default();
    fields.anchors.multipliers.clear();
    fields.gaussians.regularizers.time_to_one = -1.0;
    assert_eq!(fields.check().keys(), ["anchors.multipliers", "gaussians.regularizers.time_to_one"]);
}

#[test]
fn the_number_of_time_knots_follows_the_frames() {
    let texels = |time_count: usize, time_resolution: Option<usize>| {
        let mut settings = DeformationSettings::default();
        settings.gaussians.time_resolution = time_resolution;
        let mut state: ModelState<f32> = state_at(&[[0.0; 3], [4.0, 4.0, 4.0]]);
        insert_boxes(&mut state).unwrap();
        let time_map = TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 };
        let scene = SceneFacts { extent: 10.0, unit_world: 1.0, time_map, background: [0.0; 3], time_count };
        GaussianDeformation::new(&settings).insert(&mut state, &scene, Streams::new(1));
        let plane = state.get("gaussian_field.plane_0_xt").unwrap();
        // Planes are [channels, time, space] or [channels, space, time].
        *plane.shape().iter().filter(|&&side| side != 16 && side != 64).min().unwrap_or(&64)
    };
    // Half as many texels as frames in the published counting, of which the published code reads half.
    assert_eq!((texels(40, None), texels(80, None), texels(400, None)), (10, 20, 50));
    assert_eq!(texels(40, Some(12)), 6);
}

#[test]
fn networks_without_the_viewing_direction_do_not_depend_on_the_camera() {
    let colors = |view_direction: bool, shift: f64| {
        let mut state: ModelState<f64> = state_at(&[[0.0; 3], [1.0, 0.0, 0.0]]).cast();
        insert_view_networks(&mut state, &settings(), view_direction, Streams::new(1));
        state.insert("views.opacity.1.bias", Tensor::full([2], 2.0));
        // Positive inputs of every hidden unit, so that the colours depend on the inputs.
        state.insert("views.color.0.bias", Tensor::full([settings().width], 2.0));
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let camera = PinholeCamera { translation: [shift, 0.0, 5.0], ..camera() };
        let spawned = spawn(&mut tape, &model, &Anchors::stored(&model), None, &camera);
        tape.value(spawned.splats.sh).clone()
    };
    assert_ne!(colors(true, 0.0), colors(true, 1.0));
    assert_eq!(colors(false, 0.0), colors(false, 1.0));
}
