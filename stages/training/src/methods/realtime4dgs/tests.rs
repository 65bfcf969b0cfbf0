use shaders::tape::Device;

use super::*;
use crate::bases::gaussians::{baked, present};
use crate::data::{Dataset, NOTHING, Streams};
use crate::effects::Effects;
use crate::methods;
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;
use crate::shared::Harmonics;

fn dataset(dir: &tempfile::TempDir) -> Dataset {
    Dataset::load(TestScene::default().write(dir.path()), 1).unwrap()
}

fn method(effects: &[&str], degree: usize) -> SpaceTimeGaussians {
    let effects = Effects::Named(effects.iter().map(|name| name.to_string()).collect());
    let harmonics = Harmonics { degree, ..Harmonics::default() };
    let shared = Shared { effects, harmonics, ..Realtime4dgs::shared_defaults() };
    let switches = Switches::new(&shared.effects);
    SpaceTimeGaussians { shared, settings: Settings::default(), switches }
}

fn first_state(method: &dyn Method<f32>, dataset: &Dataset) -> ModelState<f32> {
    let points = dataset.initial_points(&Shared::default().initial_points, 0).unwrap();
    let start = Start { dataset, supplements: &NOTHING };
    method.initialize(&start, &points, Streams::new(0)).unwrap()
}

/// A tape with the splats of a state at a time and degree, and the names of its operations.
fn splats(
    method: &SpaceTimeGaussians,
    state: &ModelState<f32>,
    dataset: &Dataset,
    time: f64,
    sh_degree: usize,
) -> (Tape<f32>, SplatVars, Vec<&'static str>) {
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let camera = dataset.train[0].camera;
    let moment =
        Moment { scene: &dataset.scene, phase: TRAIN, time, camera: &camera, sh_degree, leaves_out_own: false };
    let splats = Method::splats(method, &mut tape, &model, &moment).unwrap();
    let operations = tape.profile().ops.keys().copied().collect();
    (tape, splats, operations)
}

#[test]
fn without_motion_it_equals_static3dgs() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir);
    let still = method(&["temporal-color", "rigid"], 3);
    let TrainingParams { shared, settings, .. } = TrainingParams::of("static3dgs").unwrap();
    let plain = methods::find("static3dgs").unwrap().build_f32(&shared, &settings).unwrap();
    let state = first_state(&still, &dataset);
    assert_eq!(state, first_state(&*plain, &dataset), "the same bytes");
    assert!(splats(&still, &state, &dataset, 0.5, 0).2.is_empty(), "and no operation");
}

#[test]
fn colours_without_temporal_color_have_no_waves() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir);
    let (full, plain) = (method(&["motion", "temporal-color"], 1), method(&["motion"], 1));
    let (with, without) = (first_state(&full, &dataset), first_state(&plain, &dataset));
    assert_eq!(with.get("gaussians.sh_waves").unwrap().shape(), [30, 8, 3]);
    assert!(without.get("gaussians.sh_waves").is_err());
    let waves = |method, state, degree| splats(method, state, &dataset, 0.5, degree).2.contains(&"temporal_harmonics");
    assert!(waves(&full, &with, 1) && !waves(&full, &with, 0) && !waves(&plain, &without, 1));
}

#[test]
fn gaussians_of_other_times_are_absent() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir);
    let method = method(&["motion"], 0);
    let mut state = first_state(&method, &dataset);
    assert_eq!(splats(&method, &state, &dataset, 0.5, 0).0.profile().ops["slicing4d"].forward.calls, 1);
    // Ten times with three Gaussians each, with a standard deviation of a hundredth.
    state.insert("gaussians.times", Tensor::from_vec([30, 1], (0..30).map(|at| 0.1 * (at % 10) as f32).collect()));
    state.insert("gaussians.log_scales_time", Tensor::full([30, 1], 0.01_f32.ln()));
    let (tape, sliced, _) = splats(&method, &state, &dataset, 0.3, 0);
    assert_eq!(present(&tape, &sliced), [3, 13, 23]);
    assert_eq!(baked(&tape, &sliced, 0).positions.len(), 9);
    let (tape, none, _) = splats(&method, &state, &dataset, 0.35, 0);
    assert!(present(&tape, &none).is_empty(), "a moment without Gaussians is valid");
}

#[test]
fn slices_convert_to_3d_gaussians() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir);
    let method = method(&["motion"], 0);
    let state = first_state(&method, &dataset);
    let (tape, sliced, _) = splats(&method, &state, &dataset, 0.5, 0);
    let saved = baked(&tape, &sliced, 0);
    let stored = state.get("gaussians.log_scales").unwrap().as_slice();
    let sorted = |values: &[f32]| {
        let mut values = values.to_vec();
        values.sort_by(f32::total_cmp);
        values
    };
    let difference = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-4;
    assert_eq!(saved.log_scales.len(), 90, "no Gaussian fades below 5 % within half a clip");
    assert!(
        sorted(&saved.log_scales).iter().zip(&sorted(stored)).all(difference),
        "initial Gaussians are not tilted in time"
    );
}

#[test]
fn equal_motion_of_neighbours_has_zero_loss() {
    let settings = Settings { rigid_samples: 10, rigid_neighbors: 3, ..Settings::default() };
    let loss_in = |unit_world: f64, velocities: Vec<f64>, present: [f64; 5]| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let mut constant = |columns: usize, values: Vec<f64>| tape.constant(Tensor::from_vec([5, columns], values));
        let positions = constant(3, (0..15).map(|at| 0.01 * unit_world * f64::from(at)).collect());
        let sliced = SlicedVars {
            displacements: positions,
            velocities: constant(3, velocities),
            factors: constant(9, vec![0.0; 45]),
            opacity_logits: constant(1, vec![0.0; 5]),
            present: constant(1, present.to_vec()),
        };
        let mut streams = Streams::new(0).step("fine", 1);
        let random = streams.of("rigid");
        let loss = rigidity::loss(&mut tape, positions, &sliced, &settings, unit_world, random);
        tape.value(loss.unwrap()).as_slice()[0]
    };
    let loss_of = |velocities, present| loss_in(1.0, velocities, present);
    assert_eq!(loss_of([1.0, 2.0, 3.0].repeat(5), [1.0; 5]), 0.0);
    assert!(loss_of((0..15).map(f64::from).collect(), [1.0; 5]) > 0.1);
    // Absent Gaussians have no velocity; each of the two present ones has one present neighbour of three.
    let two = |second: f64| {
        let velocities = [[1.0; 3], [0.0; 3], [0.0; 3], [second; 3], [0.0; 3]].concat();
        loss_of(velocities, [1.0, 0.0, 0.0, 1.0, 0.0])
    };
    let expected = 0.1 * 12.0_f64.sqrt() * (-100.0 * 3.0 * 0.09_f64.powi(2)).exp() / 3.0;
    assert_eq!(two(1.0), 0.0);
    assert!((two(3.0) - expected).abs() <= 1e-12, "{} {expected}", two(3.0));
    // A scene in another unit has the same loss.
    let velocities = || (0..15).map(f64::from).collect();
    let (published, tiny) = (loss_of(velocities(), [1.0; 5]), loss_in(0.01, velocities(), [1.0; 5]));
    assert!((published - tiny).abs() <= 1e-9 * published, "{published} {tiny}");
}

#[test]
fn waves_start_one_interval_after_another_behind_the_last_degree() {
    let waves = |effects: &[&str], degree| {
        let method = method(effects, degree);
        (0..8).map(|intervals| method.trained_waves(intervals)).collect::<Vec<_>>()
    };
    assert_eq!(waves(&["motion", "temporal-color"], 3), [0, 0, 0, 0, 1, 2, 2, 2]);
    assert_eq!(waves(&["motion", "temporal-color"], 0), [0, 1, 2, 2, 2, 2, 2, 2]);
    assert_eq!(waves(&["motion"], 3), [0; 8]);
}

#[test]
fn a_wave_that_has_not_started_gets_no_gradient() {
    let dir = tempfile::tempdir().unwrap();
    let (dataset, method) = (dataset(&dir), method(&["motion", "temporal-color"], 1));
    let mut state = first_state(&method, &dataset);
    let values = (0..30 * 8 * 3).map(|at| 0.01 * (at % 7) as f32).collect();
    state.insert("gaussians.sh_waves", Tensor::from_vec([30, 8, 3], values));
    let camera = dataset.train[0].camera;
    let moment =
        Moment { scene: &dataset.scene, phase: TRAIN, time: 0.3, camera: &camera, sh_degree: 1, leaves_out_own: false };
    let by_wave = |waves| {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let model = state.bind(&mut tape, |name| name == "gaussians.sh_waves");
        let colors = method.colors(&mut tape, &model, &moment, waves);
        let ones = Tensor::full(tape.value(colors).shape(), 1.0);
        let gradients = tape.backward(&[(colors, ones)]);
        let of_waves = gradients.get(model.get("gaussians.sh_waves"));
        let row = of_waves.map_or(vec![0.0; 24], |gradient| gradient.row(0).to_vec());
        [0, 12].map(|first| row[first..first + 12].iter().all(|value| *value != 0.0))
    };
    assert_eq!([0, 1, 2].map(by_wave), [[false, false], [true, false], [true, true]]);
}

#[test]
fn the_unit_of_time_sets_lifetimes_and_leaves_the_same_model_in_clips() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir);
    let of_length = |clip_length| {
        let plain = method(&["motion", "temporal-color"], 0);
        SpaceTimeGaussians { settings: Settings { clip_length, ..Settings::default() }, ..plain }
    };
    let (one, ten) = (of_length(1.0), of_length(10.0));
    let (first, scaled) = (first_state(&one, &dataset), first_state(&ten, &dataset));
    let values = |state: &ModelState<f32>, name: &str| state.get(name).unwrap().as_slice().to_vec();
    // √(0.2·10) = 1.414 of ten units, 0.141 of the clip; √0.2 = 0.447 where the clip is the unit.
    let lifetime = |state| values(state, "gaussians.log_scales_time")[0].exp();
    assert!((lifetime(&first) - 0.2_f32.sqrt()).abs() <= 1e-6 && (lifetime(&scaled) - 2.0_f32.sqrt()).abs() <= 1e-5);
    let [times, of_ten] = [&first, &scaled].map(|state| values(state, "gaussians.times"));
    assert!(times.iter().zip(&of_ten).all(|(time, of_ten)| (10.0 * time - of_ten).abs() <= 1e-5));
    // The same Gaussians in the other unit make the same splats, colours included.
    let mut converted = first_state(&one, &dataset);
    let waves: Vec<f32> = (0..30 * 2 * 3).map(|at| 0.01 * (at % 7) as f32).collect();
    converted.insert("gaussians.sh_waves", Tensor::from_vec([30, 2, 3], waves));
    let mut in_ten = converted.clone();
    in_ten.insert("gaussians.times", Tensor::from_vec([30, 1], times.iter().map(|time| 10.0 * time).collect()));
    let long = lifetime(&first) * 10.0;
    in_ten.insert("gaussians.log_scales_time", Tensor::full([30, 1], long.ln()));
    let shown = |method, state| {
        let (tape, splats, _) = splats(method, state, &dataset, 0.4, 0);
        [splats.opacity_logits, splats.sh].map(|var| tape.value(var).clone())
    };
    let ([opacity, colors], [of_ten, colors_of_ten]) = (shown(&one, &converted), shown(&ten, &in_ten));
    shaders::check::agree(&of_ten, &opacity, 1e-4).unwrap_or_else(|mismatch| panic!("{mismatch}"));
    shaders::check::agree(&colors_of_ten, &colors, 1e-4).unwrap_or_else(|mismatch| panic!("{mismatch}"));
}
