//! The stage on a small capture and its renders.

use std::path::Path;

use engine::{Artifact, Coordinates, Failure, InputRecord, JobContext, Stage};
use glam::DVec3;
use rendering::{RenderedView, Renders, SemanticMaps};
use scene::capture::{CaptureInfo, CaptureWriter, Frame};
use scene::{Camera, Capture, Intrinsics, LabelMap, Protocol, Split, TimeMap};
use serde_json::Value;

use crate::artifact::Metrics;
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;
use crate::params::MetricEvaluationParams;
use crate::run::MetricEvaluation;

/// Width and height of all images.
pub(crate) const SIZE: [u32; 2] = [24, 16];

fn protocol() -> Protocol {
    Protocol {
        dataset: "synthetic".into(),
        split: "official".into(),
        width: SIZE[0],
        height: SIZE[1],
        resize: "analytic".into(),
        background: "black".into(),
        time: "seconds / 1".into(),
    }
}

/// A colour ramp, shifted by `shift`.
pub(crate) fn picture(shift: u8) -> image::RgbImage {
    image::RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| image::Rgb([3 * x as u8 + shift, 5 * y as u8, shift]))
}

/// Labels with a ball on the right half of the image.
fn labels() -> LabelMap {
    let labels = (0..SIZE[0] * SIZE[1]).map(|at| u8::from(at % SIZE[0] >= SIZE[0] / 2)).collect();
    LabelMap { width: SIZE[0], height: SIZE[1], labels }
}

/// Writes a capture with one training view and two test views from a moving camera.
pub(crate) fn write_capture(dir: &Path) -> Capture {
    write_capture_along(dir, |time_secs| DVec3::new(0.0, time_secs, -3.0))
}

/// Writes a capture with one training view and two test views from a camera at `position(time)`.
pub(crate) fn write_capture_along(dir: &Path, position: fn(f64) -> DVec3) -> Capture {
    write_capture_with(dir, position, |_| {})
}

/// Writes the capture of [`write_capture_along`] after `change` to each of its frames.
pub(crate) fn write_capture_with(dir: &Path, position: fn(f64) -> DVec3, change: impl Fn(&mut Frame)) -> Capture {
    let time_map = TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.5 };
    let info = CaptureInfo {
        name: "tiny".into(),
        pose_source: "analytic".into(),
        protocol: protocol(),
        background: [0.0; 3],
        time_map,
        class_names: vec!["ball".into()],
        bounds_world: None,
    };
    let intrinsics =
        Intrinsics { width: SIZE[0], height: SIZE[1], focal_x: 20.0, focal_y: 20.0, center_x: 12.0, center_y: 8.0 };
    let writer = CaptureWriter::create(dir, info).expect("created");
    for (name, split, time_secs) in
        [("train_0", Split::Train, 0.0), ("test_0", Split::Test, 0.0), ("test_1", Split::Test, 1.0)]
    {
        let mut frame = Frame {
            name: name.into(),
            split,
            camera: Camera::look_at(intrinsics, position(time_secs), DVec3::ZERO, DVec3::Y),
            camera_index: 0,
            frame_index: 2 * time_secs as u32,
            time_secs,
            image: picture(7),
            alpha: None,
            depth: None,
            flow: None,
            mask: Some(labels()),
            velocity: None,
        };
        change(&mut frame);
        writer.write_view(&frame).expect("written");
    }
    writer.finish().expect("a valid capture")
}

/// Writes renders of the capture's test views with a small error.
pub(crate) fn write_renders(dir: &Path, capture: &Capture) -> Renders {
    std::fs::create_dir_all(dir.join("images")).expect("folder made");
    let rendered = |view: &scene::View| {
        let image = Path::new("images").join(format!("{}.png", view.name));
        picture(10).save(dir.join(&image)).expect("image written");
        RenderedView {
            name: view.name.clone(),
            camera_index: view.camera_index,
            frame_index: view.frame_index,
            time_secs: view.time_secs,
            image,
            maps: None,
            semantics: None,
        }
    };
    let renders = Renders {
        dir: dir.into(),
        method: "static3dgs".into(),
        protocol: capture.protocol.clone(),
        split: Split::Test,
        prompts: Vec::new(),
        views: capture.views_of(Split::Test).map(|(_, view)| rendered(view)).collect(),
        n_gaussians: 1,
        model_size_bytes: 4,
    };
    renders.save(dir).expect("written");
    renders
}

fn run(root: &Path) -> anyhow::Result<Metrics> {
    run_with(root, &MetricEvaluationParams::default(), &[])
}

/// Runs the stage on `root/capture` and `root/renders`, with input folders by name.
pub(crate) fn run_with(
    root: &Path,
    params: &MetricEvaluationParams,
    folders: &[(&str, &Path)],
) -> anyhow::Result<Metrics> {
    let mut context = JobContext::detached(root)?;
    for port in ["capture", "renders"] {
        let record = InputRecord {
            producer: port.into(),
            coordinates: Coordinates::new(),
            artifact: Ok(root.join(port)),
            measurements: Value::Null,
            action_key: String::new(),
        };
        context.inputs.insert(port.into(), vec![record]);
    }
    context.sources = folders.iter().map(|(name, folder)| (name.to_string(), folder.to_path_buf())).collect();
    let metrics = MetricEvaluation::run(&context, params)?;
    metrics.check()?;
    Ok(metrics)
}

#[test]
fn the_stage_evaluates_the_split_in_capture_order() {
    let root = tempfile::tempdir().expect("temporary folder");
    let capture = write_capture(&root.path().join("capture"));
    write_renders(&root.path().join("renders"), &capture);
    let metrics = run(root.path()).expect("evaluated");
    metrics.check().expect("valid");
    assert_eq!(Metrics::open(&root.path().join("output")).expect("opened"), metrics);
    assert_eq!(metrics.images.iter().map(|image| image.name.as_str()).collect::<Vec<_>>(), ["test_0", "test_1"]);
    // Two of three channels are off by 3 of 255 levels.
    let expected = -10.0 * (2.0 / 3.0 * (3.0_f64 / 255.0).powi(2)).log10();
    let psnr = metrics.means[&Metric::Psnr].value().expect("defined");
    assert!((psnr - expected).abs() <= 1e-9, "{psnr} dB, expected {expected}");
}

/// Maps with two features per pixel; the first of two prompts selects the ball.
fn semantic_maps(features: [f32; 2]) -> SemanticMaps {
    let is_ball = labels().labels.iter().map(|label| f32::from(*label)).collect();
    let nowhere = vec![0.0; labels().labels.len()];
    SemanticMaps {
        width: SIZE[0],
        height: SIZE[1],
        alpha: vec![1.0; nowhere.len()],
        features: features.map(|value| vec![value; nowhere.len()]).to_vec(),
        relevancy: vec![is_ball, nowhere],
    }
}

/// Writes renders with these features for both test views, and with the prompts ball and unicorn.
fn write_semantics(dir: &Path, capture: &Capture, features: [[f32; 2]; 2]) {
    let mut renders = write_renders(dir, capture);
    renders.prompts = ["ball", "unicorn"].map(String::from).to_vec();
    for (view, features) in renders.views.iter_mut().zip(features) {
        let file = Path::new("images").join(format!("{}.exr", view.name));
        semantic_maps(features).write(&dir.join(&file)).expect("written");
        view.semantics = Some(file);
    }
    renders.save(dir).expect("written");
}

#[test]
fn prompts_and_features_are_compared_with_labels() {
    let root = tempfile::tempdir().expect("temporary folder");
    let capture = write_capture(&root.path().join("capture"));
    let renders_dir = root.path().join("renders");
    let evaluated = |features| {
        write_semantics(&renders_dir, &capture, features);
        let metrics = run(root.path()).expect("evaluated");
        metrics.check().expect("valid");
        metrics
    };
    let steady = evaluated([[1.0, 0.0], [2.0, 0.0]]);
    assert_eq!(steady.means[&Metric::PromptIou], Score::Value(1.0));
    assert_eq!(steady.means[&Metric::FeatureDrift], Score::Value(0.0));
    assert_eq!(steady.prompts["ball"], Score::Value(1.0));
    assert_eq!(steady.prompts["unicorn"], Score::undefined("no class of this name"));
    let flipping = evaluated([[1.0, 0.0], [-1.0, 0.0]]);
    assert_eq!(flipping.means[&Metric::FeatureDrift], Score::Value(1.0));

    let mut forged = steady.clone();
    forged.prompts.insert("ball".into(), Score::Value(0.5));
    assert!(forged.check().is_err());
}

#[test]
fn models_without_prompts_have_no_prompt_overlap() {
    let root = tempfile::tempdir().expect("temporary folder");
    let capture = write_capture(&root.path().join("capture"));
    let renders_dir = root.path().join("renders");
    write_renders(&renders_dir, &capture);
    let metrics = run(root.path()).expect("evaluated");
    assert!(!metrics.means.contains_key(&Metric::PromptIou) && !metrics.means.contains_key(&Metric::FeatureDrift));
    // Features without prompts have a drift, but no overlap.
    write_semantics(&renders_dir, &capture, [[1.0, 0.0]; 2]);
    for name in ["test_0", "test_1"] {
        let without_prompts = SemanticMaps { relevancy: Vec::new(), ..semantic_maps([1.0, 0.0]) };
        without_prompts.write(&renders_dir.join(format!("images/{name}.exr"))).expect("written");
    }
    let metrics = run(root.path()).expect("evaluated");
    assert_eq!(metrics.means[&Metric::FeatureDrift], Score::Value(0.0));
    assert!(metrics.means[&Metric::PromptIou].value().is_none());
    assert_eq!(metrics.prompts["unicorn"], Score::undefined("no class of this name"));
}

#[test]
fn incomplete_and_foreign_renders_are_refused() {
    let root = tempfile::tempdir().expect("temporary folder");
    let (capture_dir, renders_dir) = (root.path().join("capture"), root.path().join("renders"));
    let capture = write_capture(&capture_dir);
    let refused = |change: &dyn Fn(&mut Renders), message: &str| {
        let mut renders = write_renders(&renders_dir, &capture);
        change(&mut renders);
        renders.save(&renders_dir).expect("written");
        let error = run(root.path()).expect_err("must be refused");
        assert!(error.downcast_ref::<Failure>().is_some(), "not a typed failure: {error:#}");
        assert!(error.to_string().contains(message), "{error:#}");
    };
    refused(&|renders| drop(renders.views.pop()), "view test_1 of the capture has no render");
    refused(&|renders| renders.views[1].name = "test_9".into(), "view test_1 of the capture has no render");
    refused(&|renders| renders.split = Split::Train, "view train_0 of the capture has no render");
    refused(&|renders| renders.split = Split::Val, "the split has no images");
    refused(&|renders| renders.protocol.background = "white".into(), "the renders belong to another capture");
}

#[test]
fn wrong_parameters_and_unknown_keys_are_refused() {
    let none = MetricEvaluationParams { metrics: Default::default(), ..Default::default() };
    assert_eq!(MetricEvaluation::check_params(&none).len(), 1);
    assert!(MetricEvaluation::check_params(&Default::default()).is_empty());
    assert!(serde_json::from_str::<MetricEvaluationParams>(r#"{ "metric": ["psnr"] }"#).is_err());
    let some: MetricEvaluationParams = serde_json::from_str(r#"{ "metrics": ["psnr", "ms_ssim"] }"#).expect("parsed");
    assert_eq!(some.metrics, [Metric::Psnr, Metric::MsSsim].into());
}

#[test]
fn parameters_without_effect_are_refused() {
    let problems = |text: &str| {
        let params: MetricEvaluationParams = serde_json::from_str(text).expect("parsed");
        let problems = MetricEvaluation::check_params(&params).into_iter();
        problems.map(|problem| format!("{}: {}", problem.key, problem.message)).collect::<Vec<_>>()
    };
    let masked = r#"{ "metrics": ["psnr", "masked_psnr"] }"#;
    assert_eq!(problems(masked), ["metrics: \"masked_psnr\" needs a mask"]);
    let video = r#"{ "metrics": ["flicker", "subject_consistency", "flow_of_video"] }"#;
    let needs =
        ["subject_consistency", "flow_of_video"].map(|metric| format!("metrics: {metric:?} needs frame_features"));
    assert_eq!(problems(video), needs);
    for used in [
        "{}",
        // A recipe may take the folder away for some scenes.
        r#"{ "masks": { "foreground": { "keeps": "half", "allow_missing": true } } }"#,
        r#"{ "masks": { "foreground": { "folder": "masks", "keeps": "half", "allow_missing": true } } }"#,
        r#"{ "metrics": ["masked_psnr"], "masks": { "labels": "nonzero" } }"#,
        r#"{ "metrics": ["masked_psnr"], "masks": { "other": { "folder": "masks" } } }"#,
        r#"{ "metrics": ["flow_of_video"], "frame_features": "features" }"#,
    ] {
        assert_eq!(problems(used), Vec::<String>::new(), "{used}");
    }
}
