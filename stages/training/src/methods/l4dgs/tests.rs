use std::collections::BTreeSet;

use serde_json::{Value, json};
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Device;

use super::*;
use crate::artifact::Model;
use crate::check::Table as _;
use crate::data::{Dataset, FeatureTokens, Streams, Supplements};
use crate::method::is_seed;
use crate::params::TrainingParams;
use crate::player::Player;
use crate::scene_tests::TestScene;
use crate::trainer::Trainer;
use settings::TeacherSettings;
use tokens::{CELLS, TokenGrid};

fn dataset(scene: TestScene) -> (tempfile::TempDir, Dataset) {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::load(scene.write(dir.path()), 1).unwrap();
    (dir, dataset)
}

/// Trains to the end; returns the model and the names of the operations that ran.
fn train(dataset: &Dataset, supplements: &Supplements, params: Value) -> (Model, BTreeSet<String>) {
    let params: TrainingParams = serde_json::from_value(params).unwrap();
    let mut trainer = Trainer::new(dataset, supplements, &params).unwrap();
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    let operations = trainer.report().kernels_ms.into_keys().collect();
    (trainer.finish().unwrap(), operations)
}

/// Parameters of a few steps per phase with these effects.
fn few_steps(method: &str, effects: &[&str]) -> Value {
    let hexplane = serde_json::to_value(HexplaneSettings::tiny()).unwrap();
    json!({
        "method": method,
        "effects": effects,
        // The losses of `fine` are measured for eight steps and act in the other four.
        "iterations": { "coarse": 3, "fine": 12 },
        "curve": { "points": 0 },
        "deformable4dgs": hexplane,
        "l4dgs": serde_json::to_value(L4dgsSettings::tiny()).unwrap(),
    })
}

/// All semantic losses with this share.
fn shares(share: f64) -> Value {
    let losses = ["static_semantics", "perceptual_semantics", "static_depth", "dynamic_semantics", "dynamic_depth"];
    losses.into_iter().map(|loss| (loss.to_owned(), json!(share))).collect::<serde_json::Map<_, _>>().into()
}

fn names(model: &Model) -> BTreeSet<&str> {
    model.tensors.keys().map(String::as_str).collect()
}

#[test]
fn without_effects_training_equals_the_base_bytewise() {
    let (_dir, dataset) = dataset(TestScene::default());
    let supplements = TestScene::default().supplements(&dataset);
    let (model, operations) = train(&dataset, &supplements, few_steps("l4dgs", &["motion"]));
    let (base, base_operations) = train(&dataset, &supplements, few_steps("deformable4dgs", &["motion"]));
    assert_eq!(operations, base_operations);
    assert_eq!(names(&model), names(&base));
    for name in model.tensors.keys() {
        assert_eq!(bits(&model, name), bits(&base, name), "{name}");
    }
    // Planted fault: every further effect changes the Gaussians.
    for effect in ["dynamic-semantics", "static-semantics", "dynamic-depth", "static-depth"] {
        let mut params = few_steps("l4dgs", &["motion", effect]);
        // Large enough for changes, which hardly have a gradient before something moves.
        params["l4dgs"]["shares"] = shares(1e6);
        let (other, _) = train(&dataset, &supplements, params);
        assert!(names(&other).is_superset(&names(&base)));
        let positions = |model: &Model| model.tensors["gaussians.positions"].values.clone();
        assert_ne!(positions(&other), positions(&base), "{effect} does nothing");
    }
}

#[test]
fn only_the_perceptual_reading_of_equation_3_trains_colours() {
    let (_dir, dataset) = dataset(TestScene::default());
    let supplements = TestScene::default().supplements(&dataset);
    let params = few_steps("l4dgs", &["motion", "static-semantics", "perceptual-semantics"]);
    let params: TrainingParams = serde_json::from_value(params).unwrap();
    let mut trainer = Trainer::new(&dataset, &supplements, &params).unwrap();
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    let influence = trainer.report().influence;
    let reaches = |loss: &str| {
        let norms = &influence["fine"].losses[loss].norms;
        ["colours", "semantics"].map(|group| norms.contains_key(group))
    };
    assert_eq!(reaches("perceptual_semantics"), [true, false]);
    assert_eq!(reaches("static_semantics"), [false, true]);
}

#[test]
fn depth_behind_a_moving_subject_is_not_compared() {
    let (_dir, dataset) = dataset(TestScene::default());
    let params = few_steps("l4dgs", &["motion", "static-depth"]);
    let trained = |depth_is_static: bool, factor: f32, has_masks: bool| {
        let mut supplements = TestScene::default().supplements(&dataset);
        supplements.depth_is_static = depth_is_static;
        for (priors, moving) in supplements.priors.iter_mut().zip(&supplements.moving) {
            let depths = priors.depth.as_mut().unwrap().depth_view.iter_mut();
            let of_subject = depths.zip(&moving.as_ref().unwrap().labels).filter(|(_, label)| **label != 0);
            of_subject.for_each(|(depth, _)| *depth *= factor);
        }
        supplements.moving.retain(|_| has_masks);
        bits(&train(&dataset, &supplements, params.clone()).0, "gaussians.positions")
    };
    assert_eq!(trained(true, 2.0, true), trained(true, 1.0, true));
    assert_ne!(trained(true, 1.0, true), trained(false, 1.0, true), "depth of the scene itself is compared everywhere");
    assert_ne!(trained(false, 2.0, true), trained(false, 1.0, true));
    assert_eq!(trained(true, 1.0, false), trained(false, 1.0, false), "without masks, no subject is known");
}

/// The values of a tensor of a model, as bits.
fn bits(model: &Model, tensor: &str) -> Vec<u32> {
    model.tensors[tensor].values.iter().map(|value| value.to_bits()).collect()
}

#[test]
fn losses_start_at_their_shares_in_images_of_any_size() {
    let effects = ["motion", "static-semantics", "static-depth", "dynamic-semantics", "dynamic-depth"];
    for size in [16, 48] {
        let scene = TestScene { size, ..TestScene::default() };
        let (_dir, dataset) = dataset(scene);
        let supplements = scene.supplements(&dataset);
        let mut params = few_steps("l4dgs", &effects);
        params["iterations"]["fine"] = json!(40);
        params["l4dgs"]["interval"] = json!(2);
        params["l4dgs"]["dynamic_interval"] = json!(2);
        params["l4dgs"]["shares"] = shares(0.05);
        let params: TrainingParams = serde_json::from_value(params).unwrap();
        let mut trainer = Trainer::new(&dataset, &supplements, &params).unwrap();
        while !trainer.is_done() {
            trainer.advance().unwrap();
        }
        let fine = &trainer.report().influence["fine"];
        let units: Vec<&str> = fine.units.keys().map(String::as_str).collect();
        assert_eq!(units, ["spread of depth", "static_depth", "static_semantics"]);
        for loss in ["static_semantics", "static_depth"] {
            // Every second step but the eight that measure.
            assert_eq!(fine.losses[loss].acted, 12, "{loss}");
            let shares = fine.shares(loss);
            let of_all_steps = shares.iter().find(|share| share.group == "positions").unwrap().share;
            let while_acting = of_all_steps * 20.0 / 12.0;
            println!("{loss} at {size} px: {while_acting:.3}, {:?}", fine.units);
            assert!((0.01..0.25).contains(&while_acting), "{loss} at {size} px: {while_acting}");
        }
    }
}

#[test]
fn a_further_phase_changes_no_draw_of_the_others() {
    let (_dir, dataset) = dataset(TestScene::default());
    let supplements = TestScene::default().supplements(&dataset);
    let (base, _) = train(&dataset, &supplements, few_steps("deformable4dgs", &["motion"]));
    let mut params = few_steps("l4dgs", &["motion", "static-semantics"]);
    params["l4dgs"]["shares"] = shares(0.0);
    let (with_teacher, _) = train(&dataset, &supplements, params);
    assert_eq!(with_teacher.header.iterations.len(), base.header.iterations.len() + 1);
    for tensor in base.tensors.keys() {
        assert_eq!(bits(&with_teacher, tensor), bits(&base, tensor), "{tensor}");
    }
}

/// Expected tensors, phases and operations for a set of effects.
struct Expected {
    effects: &'static [&'static str],
    teacher: bool,
    semantics: bool,
    prompts: bool,
}

#[test]
fn disabled_effects_add_no_tensors_phase_or_operations() {
    let (_dir, dataset) = dataset(TestScene::default());
    let supplements = TestScene::default().supplements(&dataset);
    let row = |effects, teacher, semantics, prompts| Expected { effects, teacher, semantics, prompts };
    let rows = [
        row(&["motion", "dynamic-semantics"], true, true, false),
        row(&["static-semantics"], true, true, false),
        row(&["motion", "dynamic-depth"], false, false, false),
        row(&["motion", "static-depth"], false, false, false),
        row(&["motion", "attention-focus", "language"], false, false, false),
        row(&["motion", "static-depth", "attention-focus"], true, false, false),
        row(&["motion", "static-semantics", "language"], true, true, true),
    ];
    for Expected { effects, teacher, semantics, prompts } in rows {
        let (model, operations) = train(&dataset, &supplements, few_steps("l4dgs", effects));
        let names = names(&model);
        let phases: Vec<&str> = model.header.iterations.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(phases.contains(&TEACHER), teacher, "{effects:?}");
        assert_eq!(names.iter().any(|name| belongs(name, TEACHER)), teacher, "{effects:?}");
        assert_eq!(names.contains(SEMANTICS), semantics, "{effects:?}");
        assert_eq!(names.contains(TEXT), prompts, "{effects:?}");
        for operation in ["convolution", "top_k_attention", "group_norm"] {
            assert_eq!(operations.contains(operation), teacher, "{operation} with {effects:?}");
        }
        let needs_tokens = effects.iter().any(|name| name.ends_with("semantics") || name.ends_with("depth"));
        assert_eq!(operations.contains("average_pool"), needs_tokens, "{effects:?}");
    }
}

#[test]
fn auto_effects_train_without_features_or_depth() {
    let (_dir, dataset) = dataset(TestScene::default());
    // Neither features nor depth: there are no prompts, and frames without depth are skipped.
    let mut params = few_steps("l4dgs", &[]);
    params["effects"] = json!("auto");
    let (model, _) = train(&dataset, &Supplements::default(), params);
    assert!(names(&model).contains(SEMANTICS) && !names(&model).contains(TEXT));
    assert!(model.header.prompts.is_empty());
}

#[test]
fn each_phase_trains_only_its_own_tensors() {
    let (_dir, dataset) = dataset(TestScene::default());
    let supplements = TestScene::default().supplements(&dataset);
    let with = |teacher: u64, fine: u64| {
        let mut params = few_steps("l4dgs", &["motion", "static-semantics", "attention-focus", "language"]);
        params["iterations"] = json!({ "coarse": 3, "fine": fine });
        params["l4dgs"]["teacher"]["iterations"] = json!(teacher);
        train(&dataset, &supplements, params).0
    };
    let (untaught, taught, finished) = (with(0, 0), with(3, 0), with(3, 4));
    for name in finished.tensors.keys() {
        let learnt_here = |phase: &Model, before: &Model| {
            before.tensors.contains_key(name) && phase.tensors[name].values != before.tensors[name].values
        };
        if belongs(name, TEACHER) {
            assert_eq!(learnt_here(&taught, &untaught), name != TEXT, "{name} in teacher");
            assert!(!learnt_here(&finished, &taught), "{name} in fine");
        } else if untaught.tensors.contains_key(name) {
            assert!(!learnt_here(&taught, &untaught), "{name} in teacher");
        }
    }
    assert_ne!(finished.tensors["gaussians.sh_dc"].values, taught.tensors["gaussians.sh_dc"].values);
}

#[test]
fn token_grids_follow_the_image_shape() {
    let grid = |height, width| TokenGrid::of_image(height, width, &settings::TeacherSettings::default());
    assert_eq!(grid(96, 96), TokenGrid { rows: 24, columns: 24 });
    assert_eq!(grid(800, 800), TokenGrid { rows: 24, columns: 24 });
    assert_eq!(grid(1014, 1352), TokenGrid { rows: 18, columns: 24 });
    assert_eq!(grid(3, 900), TokenGrid { rows: 1, columns: 24 });
    let sizes = [[3, 900], [96, 96], [191, 191], [192, 192], [800, 800], [1014, 1352]];
    assert_eq!(sizes.map(|[height, width]| grid(height, width).reduction(height, width)), [1, 1, 1, 2, 8, 14]);
}

#[test]
fn in_large_images_density_control_sees_what_it_sees_without_semantics() {
    let scene = TestScene { size: 32, ..TestScene::default() };
    let (_dir, dataset) = dataset(scene);
    let supplements = scene.supplements(&dataset);
    let with = |method: &str, effects: &[&str], share: f64| {
        let mut params = few_steps(method, effects);
        params["l4dgs"]["teacher"]["tokens_per_side"] = json!(2);
        params["l4dgs"]["shares"] = shares(share);
        params["density"] = json!({ "from": 0, "interval": 2, "gradient_threshold": 1e-7 });
        train(&dataset, &supplements, params).0
    };
    let base = with("deformable4dgs", &["motion"], 1.0);
    // Too small to survive the rounding of the photometric gradients.
    let semantics = ["motion", "static-semantics", "dynamic-semantics"];
    let [negligible, acting] = [1e-30, 1.0].map(|share| with("l4dgs", &semantics, share));
    for tensor in base.tensors.keys() {
        assert_eq!(bits(&negligible, tensor), bits(&base, tensor), "{tensor}");
    }
    assert_ne!(base.tensors["gaussians.positions"].shape[0], 30, "density control changed nothing");
    assert_ne!(bits(&acting, "gaussians.positions"), bits(&base, "gaussians.positions"));
}

#[test]
fn cells_belong_to_their_token_row_by_row() {
    let grid = TokenGrid { rows: 2, columns: 3 };
    let (height, width) = (2 * CELLS, 3 * CELLS);
    let cells = grid.cell_values(height, width, (0..height * width).map(|pixel| pixel as f64).collect());
    // The fourth token begins in the second row of tokens, first column.
    let first_pixel = CELLS * width;
    let expected: Vec<f64> =
        (0..CELLS * CELLS).map(|at| (first_pixel + at / CELLS * width + at % CELLS) as f64).collect();
    assert_eq!(cells.as_slice()[3 * CELLS * CELLS..][..CELLS * CELLS], expected);
}

#[test]
fn invalid_l4dgs_settings_are_refused() {
    assert!(L4dgsSettings::default().check().keys().is_empty());
    let with = |teacher| L4dgsSettings { teacher, ..L4dgsSettings::default() };
    let bad = [
        ("interval", L4dgsSettings { interval: 0, ..L4dgsSettings::default() }),
        ("ramp", L4dgsSettings { ramp: [5, 4], ..L4dgsSettings::default() }),
        ("semantic_rate", L4dgsSettings { semantic_rate: f64::NAN, ..L4dgsSettings::default() }),
        ("teacher.heads", with(TeacherSettings { heads: 3, ..TeacherSettings::default() })),
        ("teacher.theta", with(TeacherSettings { theta: 1.5, ..TeacherSettings::default() })),
    ];
    bad.iter().for_each(|(key, settings)| assert_eq!(settings.check().keys(), [*key]));
}

/// Classes of the test scene: the red, green and blue blobs, and the dark background.
const CLASSES: usize = 4;
/// Width of the classes' embeddings.
const EMBEDDING: usize = 8;

/// The class of a colour: its largest channel, or the background where no opaque Gaussian is visible.
fn class_of(color: &[f32]) -> usize {
    let largest = (0..3).max_by(|&a, &b| color[a].total_cmp(&color[b])).unwrap();
    if color[largest] >= 0.5 { largest } else { 3 }
}

/// Tokens of one pixel each with the class visible in the training views, and one embedding per class.
fn class_features(dataset: &Dataset) -> FeatureTokens {
    let embedding = |class: usize| (0..EMBEDDING).map(move |at| f32::from(u8::from(at == class)));
    let mut visual = vec![None; dataset.capture.views.len()];
    for view in &dataset.train {
        let image = view.to_training::<f32>().image;
        let tokens = image.as_slice().chunks(3).flat_map(|color| embedding(class_of(color))).collect();
        visual[view.index] = Some(Tensor::from_vec([view.camera.height, view.camera.width, EMBEDDING], tokens));
    }
    FeatureTokens {
        visual,
        text: Tensor::from_vec([CLASSES, EMBEDDING], (0..CLASSES).flat_map(embedding).collect()),
        prompts: ["red", "green", "blue", "dark"].map(String::from).to_vec(),
    }
}

/// Intersection over union of the pixels selected by `prompt` (relevancy) and those of `class` (colour of the render).
fn overlap(player: &Player, time_secs: f64, camera: &PinholeCamera, prompt: usize, class: usize) -> f64 {
    let color = player.render(time_secs, camera).unwrap();
    let prompts = player.prompts().unwrap();
    let relevancy = player.prompt_relevancy(time_secs, camera, &prompts).unwrap().unwrap();
    let pixels = color.as_slice().chunks(3).zip(relevancy.as_slice().chunks(CLASSES));
    let [mut both, mut either] = [0.0, 0.0];
    for (color, relevancy) in pixels {
        let (is_class, is_prompt) = (class_of(color) == class, relevancy[prompt] > 0.5);
        both += f64::from(u8::from(is_class && is_prompt));
        either += f64::from(u8::from(is_class || is_prompt));
    }
    both / either
}

#[test]
fn a_prompt_selects_pixels_of_its_class() {
    let (_dir, dataset) = dataset(TestScene { train_views: 10, size: 40, ..TestScene::default() });
    let supplements = Supplements { features: Some(class_features(&dataset)), ..Supplements::default() };
    let params = json!({
        "method": "l4dgs",
        "effects": ["motion", "static-semantics", "dynamic-semantics", "attention-focus", "language"],
        "iterations": { "coarse": 150, "fine": 300 },
        "curve": { "points": 0 },
        "learning_rates": { "sh_dc": 1e-2, "scale": 1e-2, "position": { "start": 1e-3, "end": 1e-4, "steps": 450 } },
        "l4dgs": {
            "hexplane": { "channels": 4, "spatial_resolution": 8, "width": 16 },
            "teacher": { "iterations": 400, "pixels_per_token": 2, "channels": [8, 16, 16], "width": 32, "decoder_width": 32, "rate": 3e-3 },
            "ramp": [0, 50],
            "semantic_rate": 2e-2,
        },
    });
    let (model, _) = train(&dataset, &supplements, params);
    let player = Player::new(&model).unwrap();
    assert_eq!(player.prompt_names(), ["red", "green", "blue", "dark"]);
    for view in dataset.train.iter().step_by(4) {
        let time_secs = dataset.capture.views[view.index].time_secs;
        for prompt in 0..3 {
            let right = overlap(&player, time_secs, &view.camera, prompt, prompt);
            let wrong = overlap(&player, time_secs, &view.camera, prompt, (prompt + 1) % 3);
            assert!(right >= 0.3 && wrong <= 0.1, "prompt {prompt} overlaps {right:.2}, another {wrong:.2}");
        }
    }
}

#[test]
fn seeds_are_born_with_the_meaning_of_their_pixels() {
    let scene = TestScene { train_views: 10, size: 40, ..TestScene::default() };
    let (_dir, dataset) = dataset(scene);
    let supplements = Supplements { features: Some(class_features(&dataset)), ..scene.supplements(&dataset) };
    let mut params = few_steps("l4dgs", &["motion", "seed-from-masks", "static-semantics", "language"]);
    params["l4dgs"]["teacher"] = json!({
        "iterations": 400, "pixels_per_token": 2, "channels": [8, 16, 16], "width": 32, "decoder_width": 32, "rate": 3e-3,
    });
    // Semantic features keep their first values.
    params["l4dgs"]["semantic_rate"] = json!(1e-9);
    let (model, _) = train(&dataset, &supplements, params);
    let player = Player::new(&model).unwrap();
    let relevancy = player.gaussian_relevancy(&player.prompts().unwrap()).unwrap().unwrap();
    let colors = model.tensors["gaussians.sh_dc"].values.chunks(3);
    let lives = model.tensors["gaussians.seed_lives"].values.as_chunks::<5>().0;
    let rows = lives.iter().zip(colors).zip(relevancy.chunks(CLASSES));
    let of_seeds: Vec<_> = rows.filter(|((life, _), _)| is_seed(life)).collect();
    // The seeds with the prompt of their colour, or with another one.
    let with_prompt = |shift: usize| {
        let selected = |((_, color), relevancy): &&((_, &[f32]), &[f32])| {
            let class = (0..3).max_by(|&a, &b| color[a].total_cmp(&color[b])).unwrap();
            relevancy[(class + shift) % 3] > 0.5
        };
        of_seeds.iter().filter(selected).count()
    };
    let [right, wrong] = [0, 1].map(with_prompt);
    let all = of_seeds.len();
    assert!(all > 100 && 3 * right >= 2 * all && 4 * wrong <= right, "{right} of {all}, {wrong} with another prompt");
}

#[test]
fn a_model_without_semantics_has_no_relevancy() {
    let (_dir, dataset) = dataset(TestScene::default());
    let (model, _) = train(&dataset, &Supplements::default(), few_steps("l4dgs", &["motion"]));
    let (player, view) = (Player::new(&model).unwrap(), &dataset.train[0]);
    assert!(player.render_semantics(0.0, &view.camera).unwrap().is_none() && player.prompts().is_none());
    assert!(player.prompt_names().is_empty());
    // Semantics without imported features: the model renders its own features, but has no prompts.
    let (model, _) = train(&dataset, &Supplements::default(), few_steps("l4dgs", &["static-semantics", "language"]));
    let player = Player::new(&model).unwrap();
    let semantics = player.render_semantics(0.0, &view.camera).unwrap().unwrap();
    assert_eq!(semantics.features.shape(), [view.camera.height, view.camera.width, 4]);
    assert!(player.prompts().is_none() && player.prompt_names().is_empty());
}

#[test]
fn the_teacher_distinguishes_different_images() {
    let settings = L4dgsSettings::tiny().teacher;
    let teacher = Teacher::new(&settings);
    let mut state = ModelState::<f64>::new();
    teacher.insert(&mut state, None, None, Streams::new(1));
    let output = |shift: usize| {
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let value = |at: usize| if (at / 3 + shift) % 16 < 6 { 0.9 } else { 0.1 * (at % 3) as f64 };
        let image = tape.constant(Tensor::from_vec([16, 16, 3], (0..16 * 16 * 3).map(value).collect()));
        let output = teacher.observe(&mut tape, &model, TokenGrid { rows: 4, columns: 4 }, image, None);
        let attention = tape.value(output.probabilities).clone();
        for row in 0..16 {
            assert!((attention.row(row).iter().sum::<f64>() - 1.0).abs() <= 1e-12);
            assert!(attention.row(row).iter().filter(|&&p| p > 0.0).count() <= settings.heads * settings.top_k);
        }
        tape.value(output.features).clone()
    };
    assert_eq!(output(0), output(0));
    assert_ne!(output(0), output(5));
}
