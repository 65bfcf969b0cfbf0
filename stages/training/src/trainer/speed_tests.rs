//! Effects that save time, for every method that offers them: each changes the result, and trainings with all of them are
//! as reproducible as others.

use std::collections::BTreeSet;

use shaders::rasteriser::Rendered;
use shaders::tape::{Tensor, Var};

use super::tests::{bits, dataset};
use super::*;
use crate::data::{Dataset, LoadedView, NOTHING};
use crate::effects::{Effect, Effects, KnownInputs, saves_time};
use crate::methods::{Registration, registry};
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;
use crate::shared::ViewConsistency;

/// Steps of each phase.
const STEPS: u64 = 12;

/// A short training of a method with density control, its usual effects on a capture without maps, and `saving`.
fn params(entry: &Registration, saving: &[&str]) -> TrainingParams {
    let mut params = TrainingParams::of(entry.name).unwrap();
    params.settings = entry.tiny();
    let shared = &mut params.shared;
    let capture = Facts::default();
    let known = KnownInputs::from([(CAPTURE, &capture)]);
    let effects = entry.effects();
    let usual = Effects::Auto.choose(&effects, &known).unwrap().on;
    let wanted: BTreeSet<String> = usual.into_iter().chain(saving.iter().map(|name| (*name).to_owned())).collect();
    shared.effects = Effects::Named(Effects::Named(wanted).choose(&effects, &known).unwrap().on);
    shared.iterations.values_mut().for_each(|steps| *steps = STEPS);
    (shared.density.from, shared.density.interval, shared.density.gradient_threshold) = (2, 3, 1e-6);
    shared.density.max_count = 200;
    // Both effects with surveys act in step 3, before cloning and splitting, and in step 12, after its end.
    (shared.temporal_pruning.from, shared.temporal_pruning.interval, shared.temporal_pruning.views) = (3, 9, 3);
    // Where the first phase already has `max_count` Gaussians, only the late rounds of `view-consistent-density` can act.
    shared.density.until = 9;
    shared.view_consistency =
        ViewConsistency { views: 3, min_error_px: 2.0, late_interval: 3, late_min_opacity: 0.3, ..Default::default() };
    shared.curve.points = 0;
    params
}

fn train(dataset: &Dataset, params: &TrainingParams) -> Model {
    let mut trainer = Trainer::new(dataset, &NOTHING, params).unwrap();
    while !trainer.is_done() {
        trainer.advance().unwrap_or_else(|error| panic!("{}: {error:#}", params.method));
    }
    trainer.finish().unwrap()
}

/// The methods that offer effects that save time, with these effects.
fn offers() -> Vec<(&'static Registration, Vec<Effect>)> {
    let saving = |entry: &Registration| entry.effects().into_iter().filter(saves_time).collect::<Vec<_>>();
    registry().iter().map(|entry| (entry, saving(entry))).filter(|(_, saving)| !saving.is_empty()).collect()
}

#[test]
fn every_effect_that_saves_time_changes_the_result() {
    let (_dir, dataset) = dataset(TestScene::default());
    let offers = offers();
    assert!(offers.len() >= 9, "{}", offers.len());
    for (entry, saving) in offers {
        let whole = train(&dataset, &params(entry, &[]));
        for effect in saving {
            let model = train(&dataset, &params(entry, &[effect.name]));
            let is_on = |decision: &Decision| decision.effect == effect.name && decision.on;
            assert!(model.header.effects.iter().any(is_on), "{}: {}", entry.name, effect.name);
            assert!(bits(&model) != bits(&whole), "{} with {} equals the whole", entry.name, effect.name);
        }
    }
}

#[test]
fn trainings_that_save_time_resume_to_the_same_bytes_with_any_number_of_threads() {
    let (_dir, dataset) = dataset(TestScene::default());
    for (entry, saving) in offers() {
        let names: Vec<&str> = saving.iter().map(|effect| effect.name).collect();
        let params = params(entry, &names);
        let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let undisturbed = pool(1).install(|| train(&dataset, &params));
        let model = pool(3).install(|| {
            let mut interrupted = Trainer::new(&dataset, &NOTHING, &params).unwrap();
            while !interrupted.is_done() {
                interrupted.advance().unwrap();
                if interrupted.steps().0.is_multiple_of(5) {
                    let checkpoint = interrupted.checkpoint().unwrap();
                    interrupted = Trainer::resume(&dataset, &NOTHING, &params, checkpoint).unwrap();
                }
            }
            interrupted.finish().unwrap()
        });
        assert!(bits(&model) == bits(&undisturbed), "{}", entry.name);
    }
}

#[test]
fn early_steps_see_reduced_views_and_late_steps_see_whole_ones() {
    let (_dir, dataset) = dataset(TestScene::default());
    let entry = crate::methods::find("deformable4dgs").unwrap();
    let params = params(entry, &["coarse-to-fine"]);
    let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    let mut sizes = Vec::new();
    while !trainer.is_done() {
        let mut tape = Tape::new(Device::Cpu);
        let mut observer = Trainer::resume(&dataset, &NOTHING, &params, trainer.checkpoint().unwrap()).unwrap();
        let (outcome, _) = observer.differentiate(&mut tape).unwrap();
        sizes.push(outcome.renders[0].size_px[0] as usize);
        trainer.advance().unwrap();
    }
    assert_eq!(
        sizes[..12],
        [8, 8, 8, 8, 8, 8, 8, 8, 12, 12, 12, 12],
        "24 px are reduced to 6, at least 8, then 8 and 12"
    );
    assert!(sizes[12..].iter().all(|&size| size == 24), "{sizes:?}");
}

#[test]
fn maps_of_the_full_size_exclude_reduced_images() {
    let effects = crate::methods::find("phys4dgs").unwrap().effects();
    let layers = Facts::default();
    let known = KnownInputs::from([(CAPTURE, &layers), (crate::effects::LAYERS, &layers)]);
    let wanted = Effects::Named(["+coarse-to-fine".to_owned()].into());
    let problems = wanted.choose(&effects, &known).unwrap_err();
    assert!(problems[0].message.contains("compares maps of the images' full size"), "{}", problems[0].message);
    assert!(wanted.choose(&effects, &KnownInputs::from([(CAPTURE, &layers)])).unwrap().on.contains("coarse-to-fine"));
}

/// A render of a view by a training before its first step, with the opacity logits as a leaf.
fn rendered(trainer: &Trainer<'_>, view: &LoadedView) -> (Tape<f32>, Var, Rendered) {
    let moment = trainer.moment(view.time, &view.camera);
    let mut tape = Tape::new(Device::Cpu);
    let mut splats = trainer.splats(&mut tape, &moment).unwrap();
    let logits = tape.value(splats.opacity_logits).clone();
    splats.opacity_logits = tape.leaf(logits);
    let settings = raster_settings(moment.scene, 0);
    let rendered = rasteriser::render(&mut tape, &splats, None, &view.camera, &settings).unwrap();
    (tape, splats.opacity_logits, rendered)
}

#[test]
fn the_sensitivity_is_the_squared_gradient_of_the_image() {
    let (_dir, dataset) = dataset(TestScene { train_views: 1, size: 16, ..TestScene::default() });
    let params = params(crate::methods::find("static3dgs").unwrap(), &[]);
    let trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    let view = &dataset.train[0];
    let (mut tape, opacity_logits, rendered) = rendered(&trainer, view);
    let logits = tape.value(opacity_logits).clone();
    let mut exact = vec![0.0; 30];
    for value in 0..16 * 16 * 3 {
        let mut one = Tensor::zeros([16, 16, 3]);
        one.make_mut()[value] = 1.0;
        let gradients = tape.backward(&[(rendered.color, one)]);
        let by_logit = gradients.get(opacity_logits).unwrap().as_slice();
        for (sum, (by_logit, logit)) in exact.iter_mut().zip(by_logit.iter().zip(logits.as_slice())) {
            let transparency = 1.0 - 1.0 / (1.0 + (-f64::from(*logit)).exp());
            *sum += (f64::from(*by_logit) / transparency).powi(2);
        }
    }
    let mut estimates = vec![0.0; 30];
    let rounds = 400;
    for round in 0..rounds {
        let random = &mut trainer.setup.streams().step("train", round);
        let found = trainer.squared_gradients(view, random.of("survey")).unwrap();
        estimates.iter_mut().zip(found).for_each(|(sum, value)| *sum += f64::from(value.unwrap()) / rounds as f64);
    }
    let largest = exact.iter().copied().fold(0.0, f64::max);
    assert!(largest > 0.0);
    for (row, (found, expected)) in estimates.iter().zip(&exact).enumerate() {
        // The relative deviation of a mean of 400 squares of normal values is 7 %.
        let allowed = 0.35 * expected + 0.01 * largest;
        assert!((found - expected).abs() <= allowed, "row {row}: {found:e} instead of {expected:e}");
    }
}

#[test]
fn high_errors_are_the_weights_in_the_pixels_of_large_errors() {
    let (_dir, dataset) = dataset(TestScene { train_views: 1, size: 16, ..TestScene::default() });
    let params = params(crate::methods::find("static3dgs").unwrap(), &[]);
    let trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
    let view = &dataset.train[0];
    let (mut tape, _, rendered) = rendered(&trainer, view);
    let value = |var| tape.value(var).as_slice();
    let (color, alpha, image) = (value(rendered.color), value(rendered.alpha), view.image::<f32>());
    let image = image.as_slice();
    let errors: Vec<f32> = color
        .chunks(3)
        .zip(image.chunks(3))
        .map(|(render, image)| render.iter().zip(image).map(|(render, image)| (render - image).abs() / 3.0).sum())
        .collect();
    let (min, max) = errors.iter().fold((1.0_f32, 0.0_f32), |(min, max), &error| (min.min(error), max.max(error)));
    let is_high = |error: f32| (error - min) / (max - min) > 0.4;
    // The weights of all Gaussians in a pixel add up to its alpha.
    let expected: f32 = errors.iter().zip(alpha).filter(|(error, _)| is_high(**error)).map(|(_, alpha)| alpha).sum();
    let found: Vec<f32> = trainer.high_errors(view, 0.4, false).unwrap().into_iter().map(Option::unwrap).collect();
    let sum: f32 = found.iter().sum();
    assert!(expected > 1.0 && (sum - expected).abs() < 1e-3 * expected, "{sum} instead of {expected}");
    assert!(
        errors.iter().filter(|&&error| is_high(error)).count() < errors.len() / 2,
        "the threshold selects some pixels"
    );
    let lambda = params.shared.loss.lambda_dssim;
    let target = tape.constant(view.image());
    let loss = shaders::losses::l1::l1_dssim(&mut tape, rendered.color, target, lambda);
    let loss = tape.value(loss).as_slice()[0];
    let by_loss = trainer.high_errors(view, 0.4, true).unwrap();
    assert!(
        by_loss.iter().zip(&found).all(|(weighted, error)| (weighted.unwrap() - loss * error).abs() <= 1e-6 * loss)
    );
}
