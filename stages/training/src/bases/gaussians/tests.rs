use std::collections::BTreeMap;

use scene::TimeMap;
use scene::cloud::PointCloud;
use shaders::check;
use shaders::tape::Tensor;

use super::*;
use crate::data::Streams;
use crate::effects::Effects;
use crate::method::{AfterStep, Detail, ScreenGradients, ScreenStats, StepHook as _, Survey};
use crate::model::{ModelState, Optimizer};
use crate::shared::{BatchGradient, Density, Shared, TemporalPruning, ViewConsistency};

fn scene() -> SceneFacts {
    let time_map = TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 };
    SceneFacts { extent: 1.0, unit_world: 1.0, time_map, background: [0.0; 3], time_count: 4 }
}

/// Four Gaussians: scales 0.001, 0.001, 0.05, 0.05.
fn four_gaussians() -> ModelState<f32> {
    let points = PointCloud { positions: (0..4).map(|at| [at as f32, 0.0, 0.0]).collect(), colors: vec![[99; 3]; 4] };
    let mut state = ModelState::new();
    insert_gaussians(&mut state, GAUSSIANS, &points, 1, &scene());
    let log_scales = [0.001_f32, 0.001, 0.05, 0.05].iter().flat_map(|scale| [scale.ln(); 3]).collect();
    state.insert("gaussians.log_scales", Tensor::from_vec([4, 3], log_scales));
    state
}

fn optimizer(state: ModelState<f32>) -> Optimizer {
    Optimizer::new(state, |_| Some(LogLinear::constant(1e-3)))
}

fn screen(gradients: &[f32]) -> ScreenStats<'static> {
    let values = ScreenGradients {
        gradient_ndc: gradients.iter().map(|&gradient| [gradient, 0.0]).collect(),
        visible: gradients.iter().map(|&gradient| gradient > 0.0).collect(),
        radius_px: vec![3.0; gradients.len()],
    };
    ScreenStats::of(GAUSSIANS, values)
}

fn density() -> Density {
    Density { interval: 10, from: 0, until: 1000, prune_interval: 10, opacity_reset_interval: 0, ..Density::default() }
}

/// Runs density control after a step without surveys, with random numbers of a seed.
fn after_step(control: &mut AdaptiveDensity, iteration: u64, optimizer: &mut Optimizer, seed: u64) {
    after_surveys(control, iteration, optimizer, seed, Vec::new());
}

/// Runs density control after a step with surveys, with random numbers of a seed.
fn after_surveys(
    control: &mut AdaptiveDensity,
    iteration: u64,
    optimizer: &mut Optimizer,
    seed: u64,
    surveys: Vec<(Survey, Vec<f32>)>,
) {
    let random = &mut Streams::new(seed).step("fine", iteration);
    let (detail, notices) = (None, &mut Vec::new());
    control.after_step(AfterStep { iteration, optimizer, detail, surveys, scene: &scene(), random, notices }).unwrap();
}

fn act(params: &Density, state: ModelState<f32>, gradients: &[f32], iteration: u64) -> ModelState<f32> {
    let mut control = AdaptiveDensity::new(GAUSSIANS, params, 1.0, false);
    let mut optimizer = optimizer(state);
    control.observe(&screen(gradients));
    after_step(&mut control, iteration, &mut optimizer, 0);
    optimizer.into_state()
}

fn positions(state: &ModelState<f32>) -> Vec<[f32; 3]> {
    state.get("gaussians.positions").unwrap().as_slice().as_chunks::<3>().0.to_vec()
}

#[test]
fn initial_sizes_are_distances_to_three_neighbours() {
    let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [50.0, 0.0, 0.0]];
    let points = PointCloud { colors: vec![[128; 3]; positions.len()], positions };
    let mut state = ModelState::<f64>::new();
    insert_gaussians(&mut state, GAUSSIANS, &points, 3, &scene());
    let scale = state.get("gaussians.log_scales").unwrap().as_slice()[0].exp();
    assert!((scale - (14.0_f64 / 3.0).sqrt()).abs() <= 1e-9, "{scale}");
    let shapes: BTreeMap<_, _> =
        state.iter().map(|(name, tensor)| (name.to_string(), tensor.shape().to_vec())).collect();
    assert_eq!(shapes["gaussians.sh_rest"], [5, 15, 3]);
    assert_eq!(shapes["gaussians.opacity_logits"], [5, 1]);
}

#[test]
fn small_clouds_get_sensible_sizes() {
    let line: Vec<[f32; 3]> = (0..5).map(|at| [at as f32, 0.0, 0.0]).collect();
    let root_mean_square = |squares: [f64; 3]| (squares.iter().sum::<f64>() / 3.0).sqrt();
    let (end, inner) = (root_mean_square([1.0, 4.0, 9.0]), root_mean_square([1.0, 1.0, 4.0]));
    let cases = [
        (vec![], vec![]),
        (vec![[0.5; 3]], vec![0.01]),
        (vec![[0.5; 3]; 200], vec![1e-7_f64.sqrt(); 200]),
        (vec![[0.0; 3], [0.0, 0.0, 2.0]], vec![2.0; 2]),
        (line, vec![end, inner, inner, inner, end]),
    ];
    for (positions, expected) in cases {
        let points = PointCloud { colors: vec![[0; 3]; positions.len()], positions };
        assert_eq!(nearest_scales(&points, &scene()), expected, "{:?}", points.positions);
    }
}

#[test]
fn initial_sizes_do_not_depend_on_the_unit_of_length() {
    let unit_world = 2.0_f64.powi(-20);
    let small = SceneFacts { extent: unit_world, unit_world, ..scene() };
    let cloud = |scale: f64| {
        let line = (0..5).map(|at| [at as f32 * 1e-3, 0.0, 0.0]);
        let positions: Vec<[f32; 3]> =
            line.chain([[0.0, 1.0, 0.0]; 8]).map(|at| at.map(|x| scale as f32 * x)).collect();
        PointCloud { colors: vec![[0; 3]; positions.len()], positions }
    };
    let scaled: Vec<f64> = nearest_scales(&cloud(1.0), &scene()).iter().map(|scale| unit_world * scale).collect();
    assert_eq!(nearest_scales(&cloud(unit_world), &small), scaled);
}

#[test]
fn small_gaussians_are_cloned_and_large_ones_split() {
    let state = act(&density(), four_gaussians(), &[1.0, 0.0, 1.0, 0.0], 10);
    let positions = positions(&state);
    // Survivors 0, 1, 3, the clone of 0, two children of 2.
    assert_eq!(positions.len(), 6);
    assert_eq!(positions[..4], [[0.0; 3], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0; 3]]);
    let scales = state.get("gaussians.log_scales").unwrap();
    for child in [4, 5] {
        assert!((scales.row(child)[0].exp() - 0.05 / 1.6).abs() <= 1e-6);
        assert!((positions[child][0] - 2.0).abs() <= 0.5 && positions[child] != [2.0, 0.0, 0.0]);
    }
    assert_ne!(positions[4], positions[5]);
}

#[test]
fn gaussians_of_one_size_are_all_cloned_or_all_split() {
    let sizes_after = |split_above: f64| {
        let params = Density { split_above, ..density() };
        let mut control = AdaptiveDensity::new(GAUSSIANS, &params, 1.0, false).of_one_size();
        let mut optimizer = optimizer(four_gaussians());
        control.observe(&screen(&[1.0, 0.0, 1.0, 0.0]));
        after_step(&mut control, 10, &mut optimizer, 0);
        let state = optimizer.into_state();
        let scales = state.get("gaussians.log_scales").unwrap();
        (0..scales.rows()).map(|row| scales.row(row)[0].exp()).collect::<Vec<f32>>()
    };
    let agree = |found: &[f32], expected: &[f32]| {
        let is_near = |(found, expected): (&f32, &f32)| (found - expected).abs() <= 1e-6;
        assert!(found.len() == expected.len() && found.iter().zip(expected).all(is_near), "{found:?}, {expected:?}");
    };
    // All are drawn with the geometric mean of their sizes.
    let common = (0.001_f32 * 0.05).sqrt();
    agree(&sizes_after(0.01), &[0.001, 0.001, 0.05, 0.05, 0.001, 0.05]);
    agree(&sizes_after(0.005), &[0.001, 0.05, common / 1.6, common / 1.6, common / 1.6, common / 1.6]);
}

#[test]
fn unseen_and_quiet_gaussians_do_not_change() {
    let before = four_gaussians();
    assert_eq!(act(&density(), before.clone(), &[0.0; 4], 10), before);
    assert_eq!(act(&density(), before.clone(), &[1e-4; 4], 10), before);
    // Between two rounds, before the first and after the last.
    assert_eq!(act(&density(), before.clone(), &[1.0; 4], 11), before);
    assert_eq!(act(&Density { from: 10, ..density() }, before.clone(), &[1.0; 4], 10), before);
    assert_eq!(act(&Density { until: 10, ..density() }, before.clone(), &[1.0; 4], 10), before);
}

#[test]
fn means_cover_only_steps_with_a_visible_gaussian() {
    let mut control = AdaptiveDensity::new(GAUSSIANS, &density(), 1.0, false);
    let mut optimizer = optimizer(four_gaussians());
    // Seen once with 3e-4 and never again: mean 3e-4. Seen three times with 1e-4 twice: mean 1.67e-4, below 2e-4.
    for gradients in [[3e-4, 3e-4, 0.0, 0.0], [0.0, 1e-4, 0.0, 0.0], [0.0, 1e-4, 0.0, 0.0]] {
        control.observe(&screen(&gradients));
    }
    after_step(&mut control, 10, &mut optimizer, 0);
    assert_eq!(
        positions(&optimizer.into_state()),
        [[0., 0., 0.], [1., 0., 0.], [2., 0., 0.], [3., 0., 0.], [0., 0., 0.]]
    );
}

#[test]
fn the_cap_lets_the_largest_gradients_grow() {
    let capped = Density { max_count: 5, ..density() };
    let state = act(&capped, four_gaussians(), &[1.0, 2.0, 0.5, 0.5], 10);
    assert_eq!(positions(&state).len(), 5);
    assert_eq!(positions(&state)[4], [1.0, 0.0, 0.0]);
}

#[test]
fn transparent_and_oversized_gaussians_are_pruned() {
    let mut state = four_gaussians();
    let logits = vec![logit(0.004) as f32, logit(0.006) as f32, 0.0, 0.0];
    state.insert("gaussians.opacity_logits", Tensor::from_vec([4, 1], logits));
    assert_eq!(positions(&act(&density(), state.clone(), &[0.0; 4], 10)).len(), 3);
    // Sizes count only after the first opacity reset.
    let strict = Density { max_scale: 0.04, opacity_reset_interval: 15, ..density() };
    assert_eq!(positions(&act(&strict, state.clone(), &[0.0; 4], 10)).len(), 3);
    assert_eq!(positions(&act(&strict, state.clone(), &[0.0; 4], 20)), [[1.0, 0.0, 0.0]]);
    let few = Density { prune_above_count: 4, ..density() };
    assert_eq!(positions(&act(&few, state, &[0.0; 4], 10)).len(), 4);
}

#[test]
fn a_reset_lowers_opacity_and_clears_its_moments() {
    let resetting = Density { opacity_reset_interval: 5, ..density() };
    let mut control = AdaptiveDensity::new(GAUSSIANS, &resetting, 1.0, false);
    let mut state = four_gaussians();
    state.insert("gaussians.opacity_logits", Tensor::from_vec([4, 1], vec![-9.0_f32, 0.0, 1.0, 2.0]));
    let mut optimizer = optimizer(state);
    let gradient = Tensor::from_vec([4, 1], vec![0.5_f32; 4]);
    optimizer.step(&[("gaussians.opacity_logits", gradient)].into(), 1).unwrap();
    after_step(&mut control, 5, &mut optimizer, 0);
    let ceiling = logit(0.01) as f32;
    let logits = optimizer.tensor("gaussians.opacity_logits").unwrap().as_slice().to_vec();
    assert_eq!(logits[1..], [ceiling; 3]);
    assert!(logits[0] < -8.9);
    let (saved, _) = optimizer.save();
    let moments = saved.iter().filter(|(name, _)| name.ends_with("opacity_logits") && !name.starts_with("value"));
    assert!(moments.clone().count() == 2 && moments.flat_map(|(_, tensor)| &tensor.values).all(|&value| value == 0.0));
}

#[test]
fn statistics_survive_a_checkpoint() {
    let mut control = AdaptiveDensity::new(GAUSSIANS, &density(), 1.0, false);
    control.observe(&screen(&[0.1, 0.2, 0.0, 0.3]));
    let mut copy = AdaptiveDensity::new(GAUSSIANS, &density(), 1.0, false);
    copy.restore(control.save()).unwrap();
    let run = |control: &mut AdaptiveDensity| {
        let mut optimizer = optimizer(four_gaussians());
        after_step(control, 10, &mut optimizer, 7);
        optimizer.into_state()
    };
    assert_eq!(run(&mut control), run(&mut copy));
    assert!(copy.restore(serde_json::json!("nonsense")).is_err());
}

#[test]
fn harmonics_in_use_have_the_right_gradients() {
    let tensor = |shape: &[usize], seed| Tensor::from_vec(shape, check::noise(shape.iter().product(), seed));
    let (dc, rest) = (tensor(&[5, 1, 3], 1), tensor(&[5, 15, 3], 2));
    for degree in 1..=3 {
        check::gradients(
            |tape, vars| active_harmonics(tape, vars[0], vars[1], degree),
            &[dc.clone(), rest.clone()],
            1e-6,
        )
        .unwrap();
        check::gradients(|tape, vars| leading_harmonics(tape, vars[0], degree), &[tensor(&[5, 48], 3)], 1e-6).unwrap();
    }
}

#[test]
fn children_in_space_time_follow_the_longest_axis() {
    let mut state = four_gaussians();
    let mut rows = |attribute: &str, row: &[f32]| {
        state.insert(format!("gaussians.{attribute}"), Tensor::from_vec([4, row.len()], row.repeat(4)));
    };
    rows("log_scales", &[-20.0, -20.0, -2.0]);
    rows("log_scales_time", &[-20.0]);
    rows("times", &[0.5]);
    // An eighth of a turn from z towards t: half of the long axis lies along each.
    let half = (std::f32::consts::PI / 8.0).sin_cos();
    rows("rotations_left", &[half.1, 0.0, 0.0, -half.0]);
    rows("rotations_right", &[half.1, 0.0, 0.0, half.0]);
    let mut control = AdaptiveDensity::new(GAUSSIANS, &density(), 1.0, false).in_space_time();
    let mut optimizer = optimizer(state);
    control.observe(&screen(&[1.0; 4]));
    after_step(&mut control, 10, &mut optimizer, 0);
    let state = optimizer.into_state();
    let times = state.get("gaussians.times").unwrap().as_slice();
    assert_eq!(times.len(), 8, "every Gaussian was split");
    for (position, time) in positions(&state).iter().zip(times) {
        assert!(position[1].abs() <= 1e-6 && position[2].abs() > 1e-4, "{position:?}");
        assert!((position[2].abs() - (time - 0.5).abs()).abs() <= 1e-4, "{position:?} at {time}");
    }
    let shrunk = state.get("gaussians.log_scales_time").unwrap().as_slice();
    assert!(shrunk.iter().all(|value| (value - (-20.0 - 1.6_f32.ln())).abs() <= 1e-5));
}

/// Gradients of four Gaussians in one view; a Gaussian with a gradient of 0 is not visible.
fn view(gradients: [[f32; 2]; 4]) -> ScreenGradients {
    let visible = gradients.map(|gradient| gradient != [0.0; 2]).to_vec();
    ScreenGradients { gradient_ndc: gradients.to_vec(), visible, radius_px: vec![3.0; 4] }
}

/// Sum of gradients and number of steps of each Gaussian after one step with these views.
fn counted(gradient: BatchGradient, views: &[[[f32; 2]; 4]]) -> Vec<[f32; 2]> {
    let mut statistics = statistics::Statistics::default();
    let stats = ScreenStats::of_views(GAUSSIANS, views.iter().copied().map(view).collect());
    statistics.observe_gradient(&stats, gradient.into());
    statistics.rows().iter().map(|&[sum, steps, _]| [sum, steps]).collect()
}

#[test]
fn views_of_a_batch_count_as_if_each_were_alone() {
    // The loss of each view counts a quarter in the step: alone, these views would give gradients of 4, 4, 20 and 0.
    let (up, down, long) = ([1.0, 0.0], [-1.0, 0.0], [3.0, 4.0]);
    let nothing = [0.0; 2];
    let views =
        [[up, up, long, nothing], [nothing, down, long, nothing], [nothing; 4], [nothing, nothing, long, nothing]];
    let of_views = counted(BatchGradient::MeanOverViews, &views);
    assert_eq!(of_views, [[4.0, 1.0], [4.0, 1.0], [20.0, 1.0], [0.0, 0.0]]);
    // The norm of the sum: one view of four counts a quarter, opposite directions cancel, three equal ones add up.
    let of_sum = counted(BatchGradient::OfSum, &views);
    assert_eq!(of_sum, [[1.0, 1.0], [0.0, 1.0], [15.0, 1.0], [0.0, 0.0]]);
    for rule in [BatchGradient::MeanOverViews, BatchGradient::OfSum] {
        assert_eq!(
            counted(rule, &views[..1]),
            [[1.0, 1.0], [1.0, 1.0], [5.0, 1.0], [0.0, 0.0]],
            "{rule:?} of one view"
        );
    }
}

#[test]
fn the_rule_for_batches_decides_which_gaussians_grow() {
    let grown = |batch_gradient| {
        let params = Density { batch_gradient, gradient_threshold: 2.0, ..density() };
        let mut control = AdaptiveDensity::new(GAUSSIANS, &params, 1.0, false);
        let mut optimizer = optimizer(four_gaussians());
        let (one, opposite) = ([1.0, 0.0], [-1.0, 0.0]);
        let views = [[one, one, [0.0; 2], [0.0; 2]], [[0.0; 2], opposite, [0.0; 2], [0.0; 2]]];
        control.observe(&ScreenStats::of_views(GAUSSIANS, views.map(view).to_vec()));
        after_step(&mut control, 10, &mut optimizer, 0);
        positions(&optimizer.into_state()).len()
    };
    assert_eq!((grown(BatchGradient::MeanOverViews), grown(BatchGradient::OfSum)), (6, 4));
}

#[test]
fn small_images_limit_the_number_of_gaussians() {
    let grown = |detail: Option<Detail>| {
        let mut control = AdaptiveDensity::new(GAUSSIANS, &density(), 1.0, false);
        let mut optimizer = optimizer(four_gaussians());
        control.observe(&screen(&[0.1; 4]));
        let (random, notices) = (&mut Streams::new(0).step("fine", 10), &mut Vec::new());
        let (optimizer, iteration, surveys) = (&mut optimizer, 10, Vec::new());
        control
            .after_step(AfterStep { iteration, optimizer, detail, surveys, scene: &scene(), random, notices })
            .unwrap();
        optimizer.population_len(GAUSSIANS).unwrap()
    };
    let detail = |reduction| Some(Detail { reduction, progress: 0.0, limits_growth: true });
    assert_eq!([grown(None), grown(detail(1))], [8, 8]);
    // 4 + (0.98 · 20 + 4 − 4) / 16
    assert_eq!(grown(detail(4)), 5);
    assert_eq!(grown(Some(Detail { limits_growth: false, ..detail(4).unwrap() })), 8);
}

#[test]
fn temporal_pruning_removes_the_least_sensitive_share_at_its_steps() {
    let mut shared = Shared { density: density(), ..Shared::default() };
    shared.effects = Effects::Named(["temporal-pruning".to_owned()].into());
    shared.temporal_pruning = TemporalPruning { from: 30, interval: 15, share: 0.5, ..TemporalPruning::default() };
    let mut control = AdaptiveDensity::new(GAUSSIANS, &shared.density, 1.0, false).with_surveys(&shared, true);
    let asked: Vec<u64> = (1..80).filter(|&iteration| !control.surveys_at(iteration).is_empty()).collect();
    assert_eq!(asked, [30, 45, 60, 75]);
    assert!(asked.iter().all(|&iteration| control.reads_rows_at(iteration)));
    assert_eq!(control.surveys_at(45), [Survey::Sensitivity { views: 32 }]);
    let mut kept = |sensitivities: [f32; 4]| {
        let mut optimizer = optimizer(four_gaussians());
        let surveys = vec![(Survey::Sensitivity { views: 32 }, sensitivities.to_vec())];
        after_surveys(&mut control, 45, &mut optimizer, 0, surveys);
        optimizer.tensor("gaussians.positions").unwrap().as_slice().to_vec()
    };
    assert_eq!(kept([3.0, 0.5, 9.0, 0.1]), [0.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    // Two Gaussians are hidden at all surveyed times, and half of the other two are removed.
    let unknown = f32::INFINITY;
    assert_eq!(kept([unknown, 0.5, unknown, 0.1]), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    let off = AdaptiveDensity::new(GAUSSIANS, &shared.density, 1.0, false).with_surveys(&shared, false);
    assert!((1..80).all(|iteration| off.surveys_at(iteration).is_empty()), "earlier phases have no rounds");
}

#[test]
fn gaussians_grow_only_where_views_have_high_errors() {
    let mut shared = Shared { density: density(), ..Shared::default() };
    shared.effects = Effects::Named(["view-consistent-density".to_owned()].into());
    shared.view_consistency = ViewConsistency { min_error_px: 2.0, late_interval: 15, ..ViewConsistency::default() };
    let control = AdaptiveDensity::new(GAUSSIANS, &shared.density, 1.0, false).with_surveys(&shared, true);
    let Density { interval, until, .. } = shared.density;
    let survey = |by_loss| [Survey::HighError { views: 10, above: 0.1, by_loss }];
    assert_eq!(control.surveys_at(interval), survey(false));
    assert!(control.surveys_at(interval + 1).is_empty() && control.surveys_at(until + 1).is_empty());
    assert!([until, until + 15].iter().all(|&iteration| control.surveys_at(iteration) == survey(true)));
    assert!(control.reads_rows_at(until + 15));
    let after = |iteration, errors: [f32; 4], logits: [f32; 4]| {
        let mut control = control.clone();
        let mut optimizer = optimizer(four_gaussians());
        optimizer.edit("gaussians.opacity_logits", |own| own.copy_from_slice(&logits)).unwrap();
        control.observe(&screen(&[0.1; 4]));
        let surveys = vec![(survey(iteration >= until)[0], errors.to_vec())];
        after_surveys(&mut control, iteration, &mut optimizer, 0, surveys);
        optimizer.population_len(GAUSSIANS).unwrap()
    };
    let opaque = [2.0; 4];
    assert_eq!(after(interval, [2.0, 9.0, f32::INFINITY, 3.0], opaque), 8);
    assert_eq!(after(interval, [1.9, 0.0, f32::INFINITY, 3.0], opaque), 6);
    // Late rounds remove faint Gaussians and those with the largest errors, unless nothing was measured.
    let faint = [-5.0, 2.0, 2.0, -5.0];
    assert_eq!(after(until + 15, [0.0, 1.0, 0.1, f32::INFINITY], faint), 2);
    // With temporal pruning in the same step, a Gaussian stays only if both effects keep it.
    shared.effects = Effects::Named(["view-consistent-density", "temporal-pruning"].map(str::to_owned).into());
    shared.temporal_pruning = TemporalPruning { from: until, late_share: 0.25, ..TemporalPruning::default() };
    let mut control = AdaptiveDensity::new(GAUSSIANS, &shared.density, 1.0, false).with_surveys(&shared, true);
    assert_eq!(control.surveys_at(until), [survey(true)[0], Survey::Sensitivity { views: 32 }]);
    let mut optimizer = optimizer(four_gaussians());
    optimizer.edit("gaussians.opacity_logits", |own| own.copy_from_slice(&opaque)).unwrap();
    let measured = [vec![0.0, 1.0, 0.1, 0.2], vec![0.1, 1.0, 1.0, 1.0]];
    let surveys = control.surveys_at(until).into_iter().zip(measured).collect();
    after_surveys(&mut control, until, &mut optimizer, 0, surveys);
    assert_eq!(positions(&optimizer.into_state()), [[2.0, 0.0, 0.0], [3.0, 0.0, 0.0]]);
}

#[test]
fn late_rounds_wait_for_opacities_to_recover_and_end() {
    let mut shared = Shared { density: density(), ..Shared::default() };
    shared.effects = Effects::Named(["view-consistent-density".to_owned()].into());
    shared.view_consistency.late_interval = 200;
    let late = |opacity_reset_interval| {
        let density = Density { opacity_reset_interval, until: 1000, ..density() };
        let control = AdaptiveDensity::new(GAUSSIANS, &density, 1.0, false).with_surveys(&shared, true);
        (1000..3000).filter(|&iteration| !control.surveys_at(iteration).is_empty()).collect::<Vec<_>>()
    };
    assert_eq!(late(0), [1000, 1200, 1400, 1600, 1800]);
    assert_eq!(late(250), [1000, 1200, 1400, 1600, 1800], "the last reset is that of iteration 750");
    assert_eq!(late(333), [1200, 1400, 1600, 1800], "the last reset is that of iteration 999");
}
