//! The stage on artifacts on disk.

use std::path::Path;

use engine::{Artifact, Coordinates, Failure, InputRecord, JobContext, Stage};
use glam::DVec3;
use metric_evaluation::{Degenerate, TrivialOverlap, evaluate_folders};
use rendering::{RenderedView, Renders};
use scene::capture::{CaptureInfo, CaptureWriter, Frame};
use scene::{Camera, Intrinsics, Split, TimeMap};
use serde_json::{Value, json};
use training::{Model, ModelHeader, NamedTensor};

use super::*;
use crate::artifact::ReportFolder;
use crate::run::TableGeneration;

fn coordinates(method: &str) -> Coordinates {
    [("scene", "trex"), ("method", method), ("seed", "0")].map(|(axis, value)| (axis.into(), value.into())).into()
}

fn record(node: &str, method: &str, artifact: Result<&Path, Failure>, measurements: Value) -> InputRecord {
    InputRecord {
        producer: format!("{node}/trex/{method}/0"),
        coordinates: coordinates(method),
        artifact: artifact.map(Path::to_path_buf),
        measurements,
        action_key: format!("{node}-0123456789abcdef"),
    }
}

/// Writes a model, its renders and their metrics, all for ground truth of one colour.
fn write_artifacts(root: &Path) {
    write_artifacts_for(root, &image::RgbImage::from_pixel(8, 8, image::Rgb([90; 3])));
}

/// Writes a model, its renders, which have one colour, and their metrics.
fn write_artifacts_for(root: &Path, true_image: &image::RgbImage) {
    let [model, renders, metrics] = ["model", "renders", "metrics"].map(|name| root.join(name));
    [&model, &renders.join("images"), &metrics]
        .into_iter()
        .for_each(|dir| std::fs::create_dir_all(dir).expect("folder"));
    let header = ModelHeader {
        method: "static3dgs".into(),
        method_params: json!({ "schedule_scale": 0.25 }),
        protocol: protocol(8),
        background: [1.0; 3],
        time_map: TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 },
        scene_extent: 1.0,
        unit_world: 1.0,
        time_count: 2,
        sh_degree: 0,
        n_gaussians: 7,
        iterations: vec![("train".into(), 10)],
        seed: 0,
        effects: Vec::new(),
        prompts: Vec::new(),
    };
    let tensor = NamedTensor { shape: vec![7, 3], values: vec![0.5; 21] };
    Model { header, tensors: [("gaussians.positions".to_owned(), tensor)].into() }.save(&model).expect("written");
    image(&renders.join("images/test_0.png"), 100);
    let view = RenderedView {
        name: "test_0".into(),
        camera_index: 0,
        frame_index: 0,
        time_secs: 0.0,
        image: "images/test_0.png".into(),
        maps: None,
        semantics: None,
    };
    let rendered = Renders {
        dir: renders.clone(),
        method: "static3dgs".into(),
        protocol: protocol(8),
        split: Split::Test,
        prompts: Vec::new(),
        views: vec![view],
        n_gaussians: 7,
        model_size_bytes: 84,
    };
    rendered.save(&renders).expect("written");
    let truth = root.join("truth");
    std::fs::create_dir(&truth).expect("folder");
    true_image.save(truth.join("test_0.png")).expect("image written");
    let mut judged = evaluate_folders(&renders.join("images"), &truth).expect("judged");
    (judged.method, judged.protocol) = ("static3dgs".into(), protocol(8));
    let trivial = TrivialOverlap { constant: 0.25, spatial_prior: 0.5 };
    judged.prompts.insert("ball".into(), Score::Value(0.75));
    judged.trivial_prompts.insert("ball".into(), trivial);
    judged.images[0].prompt_ious.insert("ball".into(), 0.75);
    judged.images[0].trivial_ious.insert("ball".into(), trivial);
    judged.write(&metrics).expect("written");
}

/// Writes a capture with the rendered view; its record has neither method nor seed.
fn capture_record(root: &Path) -> InputRecord {
    let dir = root.join("capture");
    let info = CaptureInfo {
        name: "trex".into(),
        pose_source: "analytic".into(),
        protocol: protocol(8),
        background: [1.0; 3],
        time_map: TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 },
        class_names: Vec::new(),
        bounds_world: None,
    };
    let intrinsics = Intrinsics { width: 8, height: 8, focal_x: 8.0, focal_y: 8.0, center_x: 4.0, center_y: 4.0 };
    let writer = CaptureWriter::create(&dir, info).expect("a capture");
    for (name, split, level) in [("train_0", Split::Train, 80), ("test_0", Split::Test, 90)] {
        let frame = Frame {
            name: name.into(),
            split,
            camera: Camera::look_at(intrinsics, DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, DVec3::Y),
            camera_index: 0,
            frame_index: 0,
            time_secs: 0.0,
            image: image::RgbImage::from_pixel(8, 8, image::Rgb([level; 3])),
            alpha: None,
            depth: None,
            flow: None,
            mask: None,
            velocity: None,
        };
        writer.write_view(&frame).expect("written");
    }
    writer.finish().expect("a capture");
    let coordinates = [("scene".to_owned(), "trex".to_owned())].into();
    InputRecord { coordinates, ..record("capture", "", Ok(&dir), Value::Null) }
}

/// Writes a PNG image of 8×8 px in a single colour.
fn image(path: &Path, level: u8) {
    let capture_image = image::RgbImage::from_pixel(8, 8, image::Rgb([level; 3]));
    capture_image.save(path).expect("image written");
}

#[test]
fn artifacts_and_failures_become_a_report() {
    let root = tempfile::tempdir().expect("folder");
    write_artifacts(root.path());
    let mut context = JobContext::detached(root.path()).expect("context");
    let failure = Failure::new(FailureKind::OutOfMemory, "out of memory").at("/some/path");
    let rate = |median: f64| json!({ "median": median, "mean": median, "p95_ms": 1.0, "frames": 5 });
    let trained = json!({
        "training_secs": 12.5, "total_secs": 20.0, "peak_memory_bytes": 3_000_000_u64, "ms_per_iteration": 4.5,
        "curve": [{ "seconds": 1.0, "iteration": 10, "n_gaussians": 7, "psnr_val": 20.0, "loss": 0.1 }],
        "phases": { "blend": 3.0 }, "device": "cpu", "threads": 2, "job": { "wall_secs": 20.0 },
        "machine": { "cpu": "Processor 1", "cores": null, "hardware_threads": 4 }
    });
    let rendered = json!({ "fps_raster": rate(90.0), "fps_model": rate(80.0), "fps_delivered": rate(60.0) });
    for (port, node, measured) in
        [("model", "train", trained), ("renders", "render", rendered), ("metrics", "metrics", Value::Null)]
    {
        let dir = root.path().join(port);
        let records = vec![
            record(node, "static3dgs", Ok(&dir), measured),
            record(node, "deformable4dgs", Err(failure.clone()), Value::Null),
        ];
        context.inputs.insert(port.into(), records);
    }
    context.inputs.insert("capture".into(), vec![capture_record(root.path())]);
    let folder = TableGeneration::run(&context, &TableGenerationParams::default()).expect("a report");
    assert_eq!(ReportFolder::open(&root.path().join("output")).expect("opened"), folder);
    let [good, bad] = folder.report.runs.as_slice() else { panic!("two runs") };
    let value = |column| good.figures[&column].value();
    assert_eq!(value(Column::TrainingSecs), Some(12.5));
    assert_eq!(value(Column::PeakMemoryMb), Some(3.0));
    assert_eq!(value(Column::Gaussians), Some(7.0));
    assert_eq!(value(Column::SizeMb), Some(84e-6));
    assert_eq!(value(Column::FpsDelivered), Some(60.0));
    assert!(value(Column::PSNR).is_some_and(|psnr| (psnr - 28.13).abs() <= 0.01));
    assert_eq!((good.jobs["model"].key.as_str(), good.jobs["model"].wall_secs), ("train-012345", Some(20.0)));
    assert_eq!(good.machines["training"].line(), "cpu (Processor 1), 2 threads");
    assert_eq!((good.schedule_scale, good.frames.len()), (Some(0.25), 1));
    let failure = bad.failure.as_ref().expect("a failure");
    assert_eq!((failure.producer.as_str(), failure.message.as_str()), ("train/trex/deformable4dgs/0", "out of memory"));
    let text = folder.markdown().expect("read");
    assert!(text.contains("| trex | ball | 0.750 | 0.250 | 0.500 |"), "{text}");
    assert!(text.contains("| deformable4dgs | OOM |"), "{text}");
    assert!(!text.contains("/some/path"), "paths differ between machines");
    let page = std::fs::read_to_string(root.path().join("output/index.html")).expect("read");
    assert_eq!(page.matches("src=\"data:image/jpeg;base64,").count(), 3, "ground truth, render and error map");
    assert!(page.contains("static3dgs: error map of trex, view test_0"), "{page}");
    assert_eq!(super::page::problems(&page), Vec::<String>::new());
    let zooms = [r##"<figure id="view-0-0"><a class="pair" href="#view-0-0">"##, r##"href="#view-0-1">next"##];
    zooms.iter().for_each(|link| assert!(page.contains(link), "{link} is missing"));
}

#[test]
fn renders_of_one_colour_are_degenerate() {
    let root = tempfile::tempdir().expect("folder");
    write_artifacts_for(
        root.path(),
        &image::RgbImage::from_fn(8, 8, |x, y| image::Rgb([30 * x as u8, 0, 9 * y as u8])),
    );
    let mut context = JobContext::detached(root.path()).expect("context");
    for (port, node) in [("model", "train"), ("renders", "render"), ("metrics", "metrics")] {
        let measured =
            if port == "model" { json!({ "notices": ["density control was stopped"] }) } else { Value::Null };
        context.inputs.insert(port.into(), vec![record(node, "static3dgs", Ok(&root.path().join(port)), measured)]);
    }
    context.inputs.insert("capture".into(), Vec::new());
    let folder = TableGeneration::run(&context, &TableGenerationParams::default()).expect("a report");
    let [run] = folder.report.runs.as_slice() else { panic!("one run") };
    let degenerate = run.degenerate.as_ref().expect("degenerate");
    assert_eq!((degenerate.kind, run.outcome()), (Degenerate::NoVariance, "degenerate"));
    assert!(degenerate.message.starts_with("every render has a single colour: "), "{degenerate:?}");
    let [notice, few, short] = degenerate.advice.as_slice() else { panic!("three causes: {degenerate:?}") };
    assert_eq!(notice, "density control was stopped");
    assert!(few.starts_with("7 Gaussians are left") && short.starts_with("a schedule of 25 %"), "{degenerate:?}");
    let above = run.figures[&Column::AboveConstant].value().expect("a value");
    let constant = run.figures[&Column::PsnrConstant].value().expect("a value");
    assert!((run.figures[&Column::PSNR].value().expect("a value") - above - constant).abs() <= 1e-9);
}

#[test]
fn seeds_with_the_same_jobs_are_one_run() {
    let root = tempfile::tempdir().expect("folder");
    write_artifacts(root.path());
    let mut context = JobContext::detached(root.path()).expect("context");
    let seeds = |port: &str, node: &str, keys: [&str; 2]| -> (String, Vec<InputRecord>) {
        let dir = root.path().join(port);
        let of_seed = |(seed, key): (&str, &str)| {
            let same = record(node, "static3dgs", Ok(&dir), Value::Null);
            let coordinates = [("seed".to_owned(), seed.to_owned())].into_iter();
            let coordinates = same.coordinates.clone().into_iter().chain(coordinates).collect();
            InputRecord { coordinates, action_key: key.into(), ..same }
        };
        (port.into(), ["0", "1"].into_iter().zip(keys).map(of_seed).collect())
    };
    context.inputs.insert("capture".into(), vec![capture_record(root.path())]);
    let mut runs_with = |trained: [&str; 2]| {
        context.inputs.extend([
            seeds("model", "train", trained),
            seeds("renders", "render", ["r", "r"]),
            seeds("metrics", "metrics", ["m", "m"]),
        ]);
        crate::collect::Inputs::open(&context).expect("opened").runs().expect("runs").len()
    };
    assert_eq!(runs_with(["a", "a"]), 1, "the axis changes no parameter");
    assert_eq!(runs_with(["a", "b"]), 2, "equal results of two trainings are two runs");
}

#[test]
fn a_run_without_an_axis_of_others_has_its_own_row() {
    let root = tempfile::tempdir().expect("folder");
    write_artifacts(root.path());
    let mut context = JobContext::detached(root.path()).expect("context");
    let input = |port: &str, key: &str, readout: Option<&str>| {
        let same = record(port, "static3dgs", Ok(&root.path().join(port)), Value::Null);
        let further = readout.map(|readout| [("readout", readout), ("ablation", "full")]).into_iter().flatten();
        let further = further.map(|(axis, value)| (axis.to_owned(), value.to_owned()));
        let coordinates = same.coordinates.clone().into_iter().chain(further).collect();
        InputRecord { coordinates, action_key: key.into(), ..same }
    };
    context.inputs.extend([
        ("capture".to_owned(), vec![capture_record(root.path())]),
        ("model".to_owned(), vec![input("model", "trained", None)]),
    ]);
    for port in ["renders", "metrics"] {
        context.inputs.insert(port.into(), vec![input(port, "whole", None), input(port, "direct", Some("direct"))]);
    }
    let runs = crate::collect::Inputs::open(&context).expect("opened").runs().expect("runs");
    let found: Vec<_> = runs.iter().map(|run| (run.row.as_str(), run.jobs["metrics"].key.as_str())).collect();
    assert_eq!(found, [("static3dgs", "whole"), ("static3dgs ablation=full readout=direct", "direct")]);
    assert_eq!(runs[0].axes, BTreeMap::new());
    assert_eq!(runs[1].axes, BTreeMap::from([("readout".to_owned(), "direct".to_owned())]), "without that of variants");
    assert!(runs.iter().all(|run| run.jobs["model"].key == "trained"));
}

#[test]
fn two_jobs_on_a_port_with_the_same_axis_values_are_refused() {
    let root = tempfile::tempdir().expect("folder");
    write_artifacts(root.path());
    let runs = |second: InputRecord| {
        let mut context = JobContext::detached(root.path()).expect("context");
        context.inputs.insert("capture".into(), vec![capture_record(root.path())]);
        for port in ["model", "renders", "metrics"] {
            let first = record(port, "static3dgs", Ok(&root.path().join(port)), Value::Null);
            context.inputs.insert(port.into(), vec![first]);
        }
        context.inputs.entry("metrics".into()).or_default().push(second);
        crate::collect::Inputs::open(&context).expect("opened").runs()
    };
    let second = || record("metrics-val", "static3dgs", Ok(&root.path().join("metrics")), Value::Null);
    let error = runs(second()).expect_err("values of two splits in one row");
    let failure = error.downcast_ref::<Failure>().expect("a failure");
    let (first, other) = ("metrics/trex/static3dgs/0", "metrics-val/trex/static3dgs/0");
    assert_eq!(failure.message, format!("{first} and {other} on the port `metrics` have the same axis values"));
    assert_eq!(failure.kind, FailureKind::BadInput);
    let mut with_axis = second();
    with_axis.coordinates.insert("split".into(), "val".into());
    let rows: Vec<String> = runs(with_axis).expect("two runs").into_iter().map(|run| run.row).collect();
    assert_eq!(rows, ["static3dgs", "static3dgs split=val"]);
}

#[test]
fn unreadable_measurements_name_their_producer() {
    let root = tempfile::tempdir().expect("folder");
    write_artifacts(root.path());
    let mut context = JobContext::detached(root.path()).expect("context");
    let dir = root.path().join("model");
    let wrong = json!({ "training_secs": "fast" });
    context.inputs.insert("model".into(), vec![record("train", "static3dgs", Ok(&dir), wrong)]);
    context.inputs.extend(["renders", "metrics", "capture"].map(|port| (port.to_owned(), Vec::new())));
    let error = TableGeneration::run(&context, &TableGenerationParams::default()).expect_err("must fail");
    assert!(error.to_string().contains("train/trex/static3dgs/0"), "{error:#}");
}

#[test]
fn invalid_tolerances_and_unknown_keys_are_rejected() {
    for tolerance in [f64::NAN, 0.0, -1.0] {
        let params = TableGenerationParams { reproduced_within_db: tolerance, ..Default::default() };
        assert_eq!(TableGeneration::check_params(&params).len(), 1);
    }
    assert!(TableGeneration::check_params(&TableGenerationParams::default()).is_empty());
    assert!(serde_json::from_str::<TableGenerationParams>(r#"{ "titel": "x" }"#).is_err());
}
