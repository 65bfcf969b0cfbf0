use shaders::check::{TOLERANCE, gradients, noise};
use shaders::rasteriser::slicing4d::Gaussians4dVars;
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
    let moment = Moment { scene: &dataset.scene, phase: TRAIN, time, camera: &camera, sh_degree, left_out: None };
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

/// A table of `columns` values in each row.
fn table(columns: usize, values: Vec<f64>) -> Tensor<f64> {
    Tensor::from_vec([values.len() / columns, columns], values)
}

/// The loss `rigid` of Gaussians on the x axis that are compared with `neighbors` of them.
fn rigid_loss(xs: &[f64], velocities: &[[f64; 3]], neighbors: usize, unit_world: f64) -> Option<f64> {
    let settings = Settings { rigid_neighbors: neighbors, ..Settings::default() };
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let positions = tape.constant(table(3, xs.iter().flat_map(|&x| [x, 0.0, 0.0]).collect()));
    let velocities = tape.constant(table(3, velocities.concat()));
    let mut streams = Streams::new(0).step("fine", 1);
    let loss = rigidity::loss(&mut tape, positions, velocities, &settings, unit_world, streams.of("rigid"));
    loss.map(|loss| tape.value(loss).as_slice()[0])
}

#[test]
fn the_rigidity_of_four_gaussians_is_the_published_one() {
    let xs = [0.0, 0.01, 0.03, 0.08];
    let velocities = [[0.0; 3], [1.0, 2.0, 2.0], [1.0, 0.0, 0.0], [1.0, 4.0, 3.0]];
    let found = rigid_loss(&xs, &velocities, 3, 1.0).unwrap();
    // Distance and difference of the velocities of each Gaussian and its two nearest others; itself adds 0.
    let [root5, root8] = [5.0, 8.0].map(f64::sqrt);
    let pairs = [
        [(0.01, 3.0), (0.03, 1.0)],
        [(0.01, 3.0), (0.02, root8)],
        [(0.02, root8), (0.03, 1.0)],
        [(0.05, 5.0), (0.07, root5)],
    ];
    let by_hand = |power: i32| {
        let terms =
            pairs.as_flattened().iter().map(|(apart, change): &(f64, f64)| (-100.0 * apart.powi(power)).exp() * change);
        0.1 * terms.sum::<f64>() / (4.0 * 3.0)
    };
    assert!((found - by_hand(1)).abs() <= 1e-12, "{found} {}", by_hand(1));
    assert!((found - by_hand(2)).abs() > 0.1, "squared distances are another loss");
}

#[test]
fn rigidity_vanishes_for_equal_motion_and_missing_neighbours() {
    assert_eq!(rigid_loss(&[0.0, 0.01, 0.03], &[[1.0, 2.0, 3.0]; 3], 3, 1.0), Some(0.0));
    assert_eq!(rigid_loss(&[0.0], &[[1.0, 2.0, 3.0]], 3, 1.0), None);
    let of_two = rigid_loss(&[0.0, 0.01], &[[0.0; 3], [2.0, 0.0, 0.0]], 20, 1.0).unwrap();
    assert!((of_two - 0.1 * 2.0 * (-1.0_f64).exp() / 20.0).abs() <= 1e-12, "{of_two}");
}

#[test]
fn rigidity_does_not_depend_on_the_unit_of_length() {
    // Times are in the same unit, so that velocities are equal numbers.
    let velocities = [[0.0; 3], [1.0, 2.0, 2.0], [1.0, 0.0, 0.0]];
    let [published, small] =
        [1.0, 1.0 / 64.0].map(|unit| rigid_loss(&[0.0, 0.01 * unit, 0.03 * unit], &velocities, 2, unit).unwrap());
    assert!(published > 0.0 && (published - small).abs() <= 1e-9 * published, "{published} {small}");
}

#[test]
fn gradients_of_rigidity_agree_with_central_differences() {
    let count = 6;
    let around = |columns: usize, middle: &[f64], amount: f64, seed: u64| {
        let values = noise(count * columns, seed).into_iter().enumerate();
        table(columns, values.map(|(at, value)| middle[at % columns] + amount * value).collect())
    };
    let unit = [1.0, 0.0, 0.0, 0.0];
    let inputs =
        [around(3, &[-1.0; 3], 0.3, 1), around(1, &[-4.0], 0.3, 2), around(4, &unit, 0.3, 3), around(4, &unit, 0.3, 4)];
    let settings = Settings { rigid_samples: 4, rigid_neighbors: 3, ..Settings::default() };
    let loss = |tape: &mut Tape<f64>, vars: &[Var]| {
        let mut constant = |columns, amount, seed| tape.constant(around(columns, &[0.0; 3], amount, seed));
        let (positions, times, opacity_logits) = (constant(3, 0.01, 5), constant(1, 1.0, 6), constant(1, 1.0, 7));
        let [log_scales, log_scales_time, rotations_left, rotations_right] = vars[..] else { panic!("four inputs") };
        let parameters =
            Gaussians4dVars { log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits };
        let velocities = primitives4d::velocities(tape, &parameters);
        let mut streams = Streams::new(0).step("fine", 1);
        rigidity::loss(tape, positions, velocities, &settings, 1.0, streams.of("rigid")).unwrap()
    };
    gradients(loss, &inputs, TOLERANCE).unwrap_or_else(|mismatch| panic!("{mismatch}"));
    let faulty = |tape: &mut Tape<f64>, vars: &[Var]| {
        let held = tape.detach(vars[1]);
        loss(tape, &[vars[0], held, vars[2], vars[3]])
    };
    assert!(gradients(faulty, &inputs, TOLERANCE).is_err(), "a gradient that lacks the lifetimes passed");
}

#[test]
fn absent_gaussians_keep_their_velocities() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let mut twice = |row: &[f64]| tape.constant(table(row.len(), row.repeat(2)));
    let parameters = Gaussians4dVars {
        log_scales: twice(&[-1.0, -2.0, -1.5]),
        log_scales_time: twice(&[-4.0]),
        rotations_left: twice(&[1.0, 0.2, 0.1, -0.3]),
        rotations_right: twice(&[1.0, -0.1, 0.3, 0.2]),
        times: tape.constant(table(1, vec![0.0, 50.0])),
        opacity_logits: tape.constant(table(1, vec![0.0; 2])),
    };
    let shown = primitives4d::slice(&mut tape, &parameters, 50.0).velocities;
    let all = primitives4d::velocities(&mut tape, &parameters);
    let [shown, all] = [shown, all].map(|velocities| tape.value(velocities).clone());
    assert!(shown.row(0) == [0.0; 3] && shown.row(1) != [0.0; 3]);
    assert!(all.row(0) == shown.row(1) && all.row(1) == shown.row(1));
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
        Moment { scene: &dataset.scene, phase: TRAIN, time: 0.3, camera: &camera, sh_degree: 1, left_out: None };
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
