use serde_json::json;

use super::*;
use crate::artifact::LargestGradient;
use crate::data::{Dataset, NOTHING, Supplements};
use crate::methods;
use crate::scene_tests::TestScene;
use crate::trainer::{Earlier, Trainer};

/// Two short phases with density control, growing harmonics and both losses.
fn table(method: &str) -> Value {
    json!({
        "method": method,
        "iterations": { "coarse": 14, "fine": 15 },
        "batch": 2,
        "harmonics": { "interval": 6 },
        "loss": { "lambda_dssim": 0.2 },
        "density": { "from": 3, "interval": 5, "prune_interval": 5, "prune_above_count": 0, "gradient_threshold": 1e-6,
                     "opacity_reset_interval": 9, "max_count": 200 },
        "curve": { "points": 3, "views": 1 },
        "l4dgs": { "teacher": { "iterations": 3 } },
    })
}

fn params(method: &str, change: Value) -> TrainingParams {
    let mut table = table(method);
    table.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
    serde_json::from_value(table).unwrap()
}

fn to_the_end(mut trainer: Trainer<'_>) -> (Model, crate::trainer::Report) {
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    let report = trainer.report();
    (trainer.finish().unwrap(), report)
}

fn dataset() -> (tempfile::TempDir, Dataset, Supplements) {
    let dir = tempfile::tempdir().unwrap();
    let test_scene = TestScene::default();
    let dataset = Dataset::load(test_scene.write(dir.path()), 1).unwrap();
    let supplements = test_scene.supplements(&dataset);
    (dir, dataset, supplements)
}

/// The model after a round trip through files.
fn saved_and_opened(model: &Model) -> Model {
    let dir = tempfile::tempdir().unwrap();
    model.save(dir.path()).unwrap();
    engine::Artifact::open(dir.path()).unwrap()
}

fn assert_same_bytes(left: &Model, right: &Model, what: &str) {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    left.save(one.path()).unwrap();
    right.save(two.path()).unwrap();
    for file in ["model.json", "model.safetensors"] {
        let read = |dir: &tempfile::TempDir| std::fs::read(dir.path().join(file)).unwrap();
        assert!(read(&one) == read(&two), "{what}: {file} differs");
    }
}

/// The methods that share their first phase.
fn sharing_methods() -> Vec<&'static str> {
    let shares = |entry: &&methods::Registration| {
        let params = TrainingParams::of(entry.name).unwrap();
        !entry.shared_phases(&params.shared, &params.settings).unwrap().is_empty()
    };
    methods::registry().iter().filter(shares).map(|entry| entry.name).collect()
}

#[test]
fn a_training_from_a_shared_start_ends_in_the_same_bytes() {
    let (_dir, dataset, supplements) = dataset();
    let known = sharing_methods();
    assert!(known.contains(&"deformable4dgs"));
    let coarse = params("deformable4dgs", json!({ "stop_after": "coarse" }));
    let (start, _) = to_the_end(Trainer::new(&dataset, &NOTHING, &coarse).unwrap());
    assert_eq!(start.header.iterations, [("coarse".to_string(), 14)]);
    assert_ne!(start.header.n_gaussians, 30, "density control did nothing");
    let start = saved_and_opened(&start);
    for method in known {
        let params = params(method, json!({}));
        if shareable(&params)[0].recipe != offered(&coarse).unwrap().recipe {
            continue;
        }
        let (alone, _) = to_the_end(Trainer::new(&dataset, &supplements, &params).unwrap());
        let earlier = Earlier::default();
        let (shared, _) = to_the_end(Trainer::continue_from(&dataset, &supplements, &params, &start, earlier).unwrap());
        assert_same_bytes(&shared, &alone, method);
    }
}

#[test]
fn a_training_from_a_shared_teacher_ends_in_the_same_bytes() {
    let (_dir, dataset, supplements) = dataset();
    let taught = params("l4dgs", json!({ "stop_after": "teacher" }));
    let (start, report) = to_the_end(Trainer::new(&dataset, &supplements, &taught).unwrap());
    assert_eq!(start.header.iterations, [("coarse".to_string(), 14), ("teacher".to_string(), 3)]);
    assert!(report.seconds_by_phase.secs.contains_key("teacher"));
    let start = saved_and_opened(&start);
    let own =
        params("l4dgs", json!({ "l4dgs": { "teacher": { "iterations": 3 }, "shares": { "static_semantics": 0.5 } } }));
    let (alone, _) = to_the_end(Trainer::new(&dataset, &supplements, &own).unwrap());
    let from = |supplements| Trainer::continue_from(&dataset, supplements, &own, &start, Earlier::default());
    assert_same_bytes(&to_the_end(from(&supplements).unwrap()).0, &alone, "with other weights");
    assert!(from(&NOTHING).err().unwrap().to_string().contains("other prompts"));
}

#[test]
fn another_start_gives_another_model() {
    // A planted fault for the test above: its comparison must detect a start that does not belong to the training.
    let (_dir, dataset, _) = dataset();
    let coarse = params("deformable4dgs", json!({ "stop_after": "coarse" }));
    let (mut start, _) = to_the_end(Trainer::new(&dataset, &NOTHING, &coarse).unwrap());
    start.tensors.get_mut("gaussians.positions").unwrap().values[0] += 1e-3;
    let params = params("deformable4dgs", json!({}));
    let (alone, _) = to_the_end(Trainer::new(&dataset, &NOTHING, &params).unwrap());
    let (shared, _) =
        to_the_end(Trainer::continue_from(&dataset, &NOTHING, &params, &start, Earlier::default()).unwrap());
    assert_ne!(shared.tensors, alone.tensors);
}

#[test]
fn time_and_curve_include_the_start() {
    let (_dir, dataset, _) = dataset();
    let coarse = params("deformable4dgs", json!({ "stop_after": "coarse", "curve": { "points": 6, "views": 1 } }));
    let (start, report) = to_the_end(Trainer::new(&dataset, &NOTHING, &coarse).unwrap());
    let mut earlier: Earlier = serde_json::from_value(serde_json::to_value(&report).unwrap()).unwrap();
    assert_eq!((&earlier.clock, &earlier.curve), (&report.seconds_by_phase, &report.curve));
    earlier.clock.secs.get_mut("coarse").unwrap().insert("render".into(), 1000.0);
    let params = params("deformable4dgs", json!({ "curve": { "points": 6, "views": 1 } }));
    let (_, whole) = to_the_end(Trainer::continue_from(&dataset, &NOTHING, &params, &start, earlier).unwrap());
    assert!(whole.training_secs > 1000.0 && whole.training_secs < 1100.0);
    assert!((whole.ms_per_iteration_by_phase["coarse"]["render"] - 1e6 / 14.0).abs() <= 1e-6 * 1e6);
    let iterations: Vec<u64> = whole.curve.iter().map(|point| point.iteration).collect();
    assert!(
        iterations.is_sorted() && iterations.first() < Some(&14) && iterations.last() == Some(&29),
        "{iterations:?}"
    );
    let first_own = whole.curve.iter().find(|point| point.iteration > 14).unwrap();
    assert!(first_own.seconds > 1000.0);
    let values: f64 = whole.loss_shares.values().map(|share| share.value_share).sum();
    assert!((values - 1.0).abs() <= 1e-12);
    assert!(whole.loss_shares["photometric"].forward_secs.unwrap() > 0.0);
    let is_at_least = |(guard, count): (&String, &u64)| whole.guards[guard] >= *count;
    assert!(!report.largest_gradients.is_empty() && report.guards.iter().all(is_at_least));
    let is_as_large = |(name, before): (&String, &LargestGradient)| {
        whole.largest_gradients.get(name).is_some_and(|largest| largest.magnitude >= before.magnitude)
    };
    assert!(report.largest_gradients.iter().all(is_as_large));
}

#[test]
fn a_start_of_another_training_is_refused() {
    let (_dir, dataset, _) = dataset();
    let coarse = |change: Value| {
        let mut table = json!({ "stop_after": "coarse", "iterations": { "coarse": 3, "fine": 1 } });
        table.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        to_the_end(Trainer::new(&dataset, &NOTHING, &params("deformable4dgs", table)).unwrap()).0
    };
    let wanted = |method: &str| params(method, json!({ "iterations": { "coarse": 3, "fine": 1 } }));
    let refusal = |start: &Model, params: &TrainingParams| {
        let refused = Trainer::continue_from(&dataset, &NOTHING, params, start, Earlier::default());
        refused.err().expect("must be refused").to_string()
    };
    let (ours, seeded) = (wanted("deformable4dgs"), coarse(json!({ "seed": 3 })));
    assert!(Trainer::continue_from(&dataset, &NOTHING, &ours, &coarse(json!({})), Earlier::default()).is_ok());
    assert!(refusal(&seeded, &ours).contains("has other parameters than this training begins with: seed 3 → 0"));
    let degree = coarse(json!({ "harmonics": { "degree": 1, "interval": 6 } }));
    assert!(refusal(&degree, &ours).contains("harmonics.degree 1 → 3"));
    let whole = coarse(json!({ "stop_after": null }));
    assert!(refusal(&whole, &ours).contains("was not saved at the end of a shared phase"));
    let mut elsewhere = coarse(json!({}));
    elsewhere.header.scene_extent *= 2.0;
    assert!(refusal(&elsewhere, &ours).contains("another capture"));
    let no_phase: TrainingParams = serde_json::from_value(json!({ "method": "static3dgs" })).unwrap();
    assert!(refusal(&coarse(json!({})), &no_phase).contains("static3dgs shares no phase"));
}
