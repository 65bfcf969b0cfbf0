use std::collections::BTreeMap;

use engine::{Failure, FailureKind};
use serde_json::{Value, json};

use super::*;
use crate::data::{Dataset, NOTHING, Streams, ViewSampler};
use crate::methods;
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;

pub(super) fn dataset(scene: TestScene) -> (tempfile::TempDir, Dataset) {
    let dir = tempfile::tempdir().unwrap();
    let capture = scene.write(dir.path());
    (dir, Dataset::load(capture, 2).unwrap())
}

pub(super) fn params(value: Value) -> TrainingParams {
    serde_json::from_value(value).unwrap()
}

/// Every mechanism within 40 steps: two phases, density control, growing harmonics, both losses, the curve.
fn busy_params() -> TrainingParams {
    params(json!({
        "method": "deformable4dgs",
        "iterations": { "coarse": 18, "fine": 22 },
        "batch": 2,
        "harmonics": { "interval": 7 },
        "loss": { "lambda_dssim": 0.2 },
        "density": { "from": 3, "interval": 5, "prune_interval": 5, "prune_above_count": 0, "gradient_threshold": 1e-6,
                     "opacity_reset_interval": 9, "max_count": 200 },
        "curve": { "points": 3, "views": 2 },
        "deformable4dgs": { "channels": 4, "spatial_resolution": 6, "width": 8 },
    }))
}

fn train_to_end(mut trainer: Trainer<'_>) -> Model {
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    trainer.finish().unwrap()
}

/// The model, and the measurements.
fn train_and_measure(mut trainer: Trainer<'_>) -> (Model, Report) {
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    let report = trainer.report();
    (trainer.finish().unwrap(), report)
}

/// The measurements that neither depend on time nor are part of the model.
fn reproducible(report: &Report) -> Value {
    let Report { influence, skipped_work, largest_gradients, guards, .. } = report;
    json!([influence, skipped_work, largest_gradients, guards])
}

/// Bit patterns of every tensor, so that −0 and 0 differ.
pub(super) fn bits(model: &Model) -> BTreeMap<&str, Vec<u32>> {
    model
        .tensors
        .iter()
        .map(|(name, tensor)| (name.as_str(), tensor.values.iter().map(|v| v.to_bits()).collect()))
        .collect()
}

#[test]
fn a_training_resumed_anywhere_ends_in_the_same_bytes() {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = busy_params();
    let (undisturbed, expected) = train_and_measure(Trainer::new(&dataset, &NOTHING, &params).unwrap());
    assert!(undisturbed.header.n_gaussians > 30, "density control did nothing");
    // In the coarse phase, on a density round, just before and after the switch of phases, and in the fine phase.
    for stop_after in [1, 10, 17, 18, 19, 31, 39] {
        let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
        (0..stop_after).for_each(|_| trainer.advance().unwrap());
        let dir = tempfile::tempdir().unwrap();
        trainer.checkpoint().unwrap().save(dir.path()).unwrap();
        drop(trainer);
        let checkpoint = Checkpoint::load(dir.path(), &serde_json::to_value(&params).unwrap()).unwrap();
        let resumed = Trainer::resume(&dataset, &NOTHING, &params, checkpoint).unwrap();
        let (resumed, report) = train_and_measure(resumed);
        assert_eq!(resumed.header, undisturbed.header, "stopped after {stop_after}");
        assert_eq!(bits(&resumed), bits(&undisturbed), "stopped after {stop_after}");
        assert_eq!(reproducible(&report), reproducible(&expected), "stopped after {stop_after}");
    }
}

#[test]
fn every_method_resumed_in_any_phase_ends_in_the_same_bytes() {
    let scene = poison_tests::Scene::new();
    for entry in methods::registry() {
        let params = poison_tests::all_effects(entry.name);
        let undisturbed = train_to_end(Trainer::new(&scene.dataset, &scene.supplements, &params).unwrap());
        for (phase, checkpoint) in poison_tests::checkpoints(&scene, &params) {
            let resumed = Trainer::resume(&scene.dataset, &scene.supplements, &params, checkpoint).unwrap();
            assert_eq!(bits(&train_to_end(resumed)), bits(&undisturbed), "{} resumed in {phase}", entry.name);
        }
    }
}

#[test]
fn sampling_the_influence_of_losses_changes_no_bit() {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = busy_params();
    let mut unsampled = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    unsampled.setup.samples_influence = false;
    let mut sampled = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    while !sampled.is_done() {
        sampled.advance().unwrap();
        unsampled.advance().unwrap();
    }
    let influence = sampled.report().influence;
    assert!(unsampled.report().influence["fine"].losses["photometric"].iterations.is_empty());
    assert_eq!(influence["coarse"].losses["photometric"].iterations, [0; 0], "a single loss is not compared");
    assert_eq!(influence["fine"].losses["photometric"].iterations, [6, 17]);
    assert_eq!(bits(&sampled.finish().unwrap()), bits(&unsampled.finish().unwrap()));
}

/// The report of a short training. The losses of `l4dgs` act from its ninth step on, after their units have been measured.
fn report_of_few_steps(scene: &poison_tests::Scene, mut params: TrainingParams) -> Report {
    let count = if params.method == "l4dgs" { 16 } else { 8 };
    params.shared.iterations.values_mut().for_each(|steps| *steps = count);
    let mut trainer = Trainer::new(&scene.dataset, &scene.supplements, &params).unwrap();
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    trainer.report()
}

#[test]
fn every_loss_that_acted_has_seconds() {
    let scene = poison_tests::Scene::new();
    for entry in crate::methods::registry() {
        let report = report_of_few_steps(&scene, poison_tests::all_effects(entry.name));
        assert!(report.loss_shares.contains_key("photometric"), "{}", entry.name);
        let is_sampled = |loss: &str| {
            let mut of_phases = report.influence.values().filter_map(|phase| phase.losses.get(loss));
            of_phases.any(|loss| !loss.iterations.is_empty())
        };
        for (name, share) in &report.loss_shares {
            let [forward, backward] = [share.forward_secs, share.backward_secs].map(|secs| secs.unwrap_or(0.0) > 0.0);
            assert_eq!([forward, backward], [true, is_sampled(name)], "{}: {name}: {share:?}", entry.name);
        }
    }
}

#[test]
fn a_later_step_of_a_slot_samples_only_what_the_slot_lacks() {
    let mut params = poison_tests::all_effects("l4dgs");
    params.settings["interval"] = json!(5);
    let report = report_of_few_steps(&poison_tests::Scene::new(), params);
    let sampled = |loss: &str| report.influence["fine"].losses[loss].iterations.clone();
    assert_eq!([sampled("photometric"), sampled("static_semantics")], [[4, 12], [10, 15]]);
}

#[test]
fn every_loss_of_every_method_is_sampled() {
    let scene = poison_tests::Scene::new();
    for entry in crate::methods::registry() {
        let report = report_of_few_steps(&scene, poison_tests::all_effects(entry.name));
        for (phase, influence) in report.influence {
            assert!(influence.steps > 0, "{} in {phase}", entry.name);
            for loss in influence.losses.keys().filter(|loss| *loss != "photometric") {
                let is_declared = entry.losses.iter().any(|declared| declared.name == loss);
                assert!(is_declared, "{}: LOSSES lacks {loss}", entry.name);
            }
            let losses = influence.losses.iter().filter(|_| influence.losses.len() > 1);
            for (name, loss) in losses {
                let is_finite = loss.norms.values().flatten().all(|norm| norm.is_finite());
                let is_sampled = !loss.iterations.is_empty() && (name != "photometric" || !loss.norms.is_empty());
                assert!(is_finite && is_sampled, "{} in {phase}: {name} has {loss:?}", entry.name);
            }
        }
    }
}

#[test]
fn a_regulariser_of_differences_that_no_plane_has_is_not_evaluated() {
    let has_smoothness = |train_views: usize| {
        let (_dir, dataset) = dataset(TestScene { train_views, ..TestScene::default() });
        let (_, report) = train_and_measure(Trainer::new(&dataset, &NOTHING, &busy_params()).unwrap());
        ["spatial_smoothness", "temporal_smoothness", "time_to_one"]
            .map(|loss| report.influence["fine"].losses.contains_key(loss))
    };
    // 2 and 3 texels along time.
    assert_eq!(has_smoothness(8), [true, false, true]);
    assert_eq!(has_smoothness(9), [true; 3]);
}

#[test]
fn a_wrong_random_state_in_a_checkpoint_is_detected() {
    // A planted fault for the test above: its comparison must detect a wrong view order.
    let (_dir, dataset) = dataset(TestScene::default());
    let params = busy_params();
    let undisturbed = train_to_end(Trainer::new(&dataset, &NOTHING, &params).unwrap());
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    (0..10).for_each(|_| trainer.advance().unwrap());
    let mut checkpoint = trainer.checkpoint().unwrap();
    checkpoint.progress.state.sampler = ViewSampler::new(dataset.train.len(), Streams::new(99).views("fine"));
    let resumed = train_to_end(Trainer::resume(&dataset, &NOTHING, &params, checkpoint).unwrap());
    assert_ne!(bits(&resumed), bits(&undisturbed));
}

#[test]
fn a_restored_state_saves_the_same_values() {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = busy_params();
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    (0..31).for_each(|_| trainer.advance().unwrap());
    let (saved, tensors) = trainer.state.save();
    assert!(saved.hooks.iter().any(|hook| !hook.is_null()) && saved.iteration == 13 && saved.phase == 1);
    let restored = TrainState::restore(&trainer.setup, saved.clone(), &tensors).unwrap();
    assert_eq!(restored.save(), (saved, tensors));
}

#[test]
fn a_rollback_replays_the_steps_to_the_same_state() {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = busy_params();
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    (0..7).for_each(|_| trainer.advance().unwrap());
    trainer.start_speculation();
    // Density control acts and the harmonics grow in these steps.
    (0..8).for_each(|_| trainer.step(speculation::Mode::Checked).unwrap());
    let (state, history) = (trainer.state.save(), trainer.telemetry.history.clone());
    let speculation = trainer.speculation.take().unwrap();
    trainer.roll_back(speculation).unwrap();
    assert_eq!(trainer.state.save(), state);
    assert_eq!(trainer.telemetry.history, history);
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = busy_params();
    let train = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| train_to_end(Trainer::new(&dataset, &NOTHING, &params).unwrap()))
    };
    let one = train(1);
    for threads in [2, 3] {
        let many = train(threads);
        assert_eq!(one.header, many.header);
        assert_eq!(bits(&one), bits(&many), "{threads} threads");
    }
}

#[test]
fn another_seed_trains_another_model() {
    let (_dir, dataset) = dataset(TestScene::default());
    let train = |seed: u64| {
        let params =
            params(json!({ "seed": seed, "iterations": { "train": 5 }, "initial_points": { "random_count": 50 } }));
        train_to_end(Trainer::new(&dataset, &NOTHING, &params).unwrap())
    };
    assert_eq!(bits(&train(1)), bits(&train(1)));
    assert_ne!(bits(&train(1)), bits(&train(2)));
}

#[test]
fn one_frame_is_overfitted() {
    let (_dir, dataset) = dataset(TestScene { train_views: 1, ..TestScene::default() });
    for method in ["static3dgs", "deformable4dgs"] {
        let params = params(json!({
            "method": method,
            "iterations": if method == "static3dgs" { json!({ "train": 600 }) } else { json!({ "coarse": 300, "fine": 500 }) },
            "loss": { "lambda_dssim": 0.0 },
            "density": { "from": 50, "until": 400, "gradient_threshold": 1e-4, "opacity_reset_interval": 0 },
            "learning_rates": {
                "position": { "start": 2e-3, "end": 2e-5, "steps": 600 },
                "scale": 2e-2,
                "rotation": 1e-2,
                "sh_dc": 2e-2,
            },
            "deformable4dgs": { "channels": 4, "spatial_resolution": 8, "width": 16 },
        }));
        let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
        while !trainer.is_done() {
            trainer.advance().unwrap();
        }
        let view = &dataset.train[0];
        let mut tape = Tape::new(Device::Cpu);
        let splats = trainer.splats(&mut tape, &trainer.moment(view.time, &view.camera)).unwrap();
        let settings = raster_settings(&dataset.scene, trainer.state.sh_degree);
        let rendered = rasteriser::render(&mut tape, &splats, None, &view.camera, &settings).unwrap();
        let psnr = curve::psnr(&to_bytes(tape.value(rendered.color)).values, &view.pixels);
        assert!(psnr >= 30.0, "{method} reaches {psnr:.2} dB on its only frame");
    }
}

#[test]
fn a_moving_model_beats_a_static_one_on_motion() {
    // Without validation views the curve is measured on training views, because this test is about fitting.
    let (_dir, dataset) = dataset(TestScene { train_views: 12, val_views: 0, travel: 1.2, ..TestScene::default() });
    let last_psnr = |value: Value| {
        let params = params(value);
        let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
        while !trainer.is_done() {
            trainer.advance().unwrap();
        }
        trainer.report().curve.last().unwrap().psnr_val
    };
    let fixed = last_psnr(json!({ "method": "static3dgs", "iterations": { "train": 600 } }));
    let moving = last_psnr(json!({
        "method": "deformable4dgs",
        "iterations": { "coarse": 100, "fine": 500 },
        "deformable4dgs": {
            "channels": 8,
            "spatial_resolution": 16,
            "width": 32,
            "plane_rate": { "start": 5e-3, "end": 5e-4, "steps": 500 },
            "network_rate": { "start": 5e-4, "end": 5e-5, "steps": 500 },
        },
    }));
    assert!(moving >= fixed + 2.0, "moving {moving:.2} dB, static {fixed:.2} dB");
}

#[test]
fn a_non_finite_value_ends_the_training_at_its_step() {
    let (_dir, dataset) = dataset(TestScene::default());
    let failure = |value: Value| {
        let params = params(value);
        let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
        let error = (0..50).find_map(|_| trainer.advance().err()).expect("an overflow within 50 steps");
        error.downcast::<Failure>().expect("a typed failure")
    };
    let overflow = failure(json!({ "iterations": { "train": 50 }, "learning_rates": { "sh_dc": 1e38 } }));
    assert_eq!(overflow.kind, FailureKind::Diverged);
    assert!(overflow.message.starts_with("gaussians.sh_dc is not finite at iteration"), "{overflow}");
    assert!(overflow.message.contains("phase train"), "{overflow}");
    let rough = failure(json!({ "iterations": { "train": 50 }, "loss": { "lambda_dssim": 1e39 } }));
    assert!(rough.message.starts_with("loss photometric is not finite at iteration 1"), "{rough}");
    assert!(rough.message.contains("phase train"), "{rough}");
}

#[test]
fn pruning_that_would_empty_the_model_stops_and_says_so() {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = params(json!({
        "iterations": { "train": 50 },
        "density": { "from": 0, "prune_interval": 10, "min_opacity": 0.999 },
    }));
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    (0..50).for_each(|_| trainer.advance().unwrap());
    let notices = trainer.report().notices;
    let [notice] = &notices[..] else { panic!("one notice: {notices:?}") };
    assert!(notice.starts_with("pruning stopped at iteration 10: it would have left 0 of"), "{notice}");
    let model = trainer.finish().unwrap();
    assert!(model.header.n_gaussians > 0);
    // Gaussians are at least as opaque at iteration 10 as at the start, and training continues.
    let opacities = &model.tensors["gaussians.opacity_logits"].values;
    assert!(opacities.iter().any(|&logit| logit > -2.5), "{opacities:?}");
}
