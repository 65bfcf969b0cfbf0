//! Judges on a small capture: what they need, and what they say where it is not there.

use std::path::Path;

use engine::{Digest, Failure, FailureKind, Source, Stage as _};
use glam::DVec3;
use rendering::Renders;

use crate::stage_tests::{SIZE, picture, run_with, write_capture, write_capture_along, write_renders};
use crate::{Keep, MaskSource, Metric, MetricEvaluation, MetricEvaluationParams, Metrics, Score};

/// A folder with `capture` and `renders`.
fn world(camera: Option<fn(f64) -> DVec3>) -> (tempfile::TempDir, Renders) {
    let root = tempfile::tempdir().expect("temporary folder");
    let dir = root.path().join("capture");
    let capture = camera.map_or_else(|| write_capture(&dir), |position| write_capture_along(&dir, position));
    let renders = write_renders(&root.path().join("renders"), &capture);
    (root, renders)
}

fn masked(mask: MaskSource, mask_keeps: Keep) -> MetricEvaluationParams {
    MetricEvaluationParams { mask, mask_keeps, ..MetricEvaluationParams::default() }
}

fn kind_of(error: &anyhow::Error) -> FailureKind {
    error.downcast_ref::<Failure>().unwrap_or_else(|| panic!("not a typed failure: {error:#}")).kind
}

#[test]
fn labels_mask_what_is_judged() {
    let (root, renders) = world(None);
    // The ball is on the right: an error on the left must not count.
    let path = renders.image_path(&renders.views[0]);
    let mut image = picture(10);
    image.enumerate_pixels_mut().filter(|(x, ..)| *x < SIZE[0] / 2).for_each(|(.., pixel)| pixel.0 = [255; 3]);
    image.save(path).expect("written");
    let on_ball = run_with(root.path(), &masked(MaskSource::Labels, Keep::Nonzero), &[]).expect("judged");
    let expected = -10.0 * (2.0 / 3.0 * (3.0_f64 / 255.0).powi(2)).log10();
    let masked_psnr = on_ball.means[&Metric::MaskedPsnr].value().expect("defined");
    assert!((masked_psnr - expected).abs() <= 1e-9, "{masked_psnr} instead of {expected}");
    assert!(on_ball.means[&Metric::Psnr].value().expect("defined") < expected - 5.0);
    let elsewhere = run_with(root.path(), &masked(MaskSource::Labels, Keep::Zero), &[]).expect("judged");
    assert!(elsewhere.means[&Metric::MaskedPsnr].value().expect("defined") < expected - 5.0);
    assert_ne!(on_ball.judged_by(), elsewhere.judged_by(), "masks are part of who judged what");
    assert_eq!(on_ball.means[&Metric::MaskedLpips], Score::undefined("no weights of LPIPS were given"));
    let unmasked = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("judged");
    assert!(!unmasked.means.contains_key(&Metric::MaskedPsnr));
}

#[test]
fn masks_in_files_are_those_of_the_views() {
    let (root, _) = world(None);
    let folder = root.path().join("masks");
    std::fs::create_dir(&folder).expect("folder");
    let write = |name: &str, size: [u32; 2], value: u8| {
        image::GrayImage::from_pixel(size[0], size[1], image::Luma([value])).save(folder.join(name)).expect("written");
    };
    let judged = || run_with(root.path(), &masked(MaskSource::Files, Keep::Nonzero), &[("mask_folder", &folder)]);
    assert_eq!(kind_of(&judged().expect_err("no mask")), FailureKind::MissingData);
    write("test_0.png", SIZE, 255);
    write("test_1.png.png", [SIZE[0], 3], 255);
    assert_eq!(kind_of(&judged().expect_err("another size")), FailureKind::BadInput);
    write("test_1.png.png", SIZE, 0);
    let metrics = judged().expect("judged");
    let scores: Vec<&Score> = metrics.images.iter().map(|image| &image.values[&Metric::MaskedSsim]).collect();
    assert!(scores[0].value().is_some(), "{scores:?}");
    assert_eq!(*scores[1], Score::undefined("the mask is empty"));
    assert_eq!(metrics.means[&Metric::MaskedPsnr], metrics.images[0].values[&Metric::MaskedPsnr]);
}

#[test]
fn without_weights_lpips_says_so() {
    let (root, _) = world(None);
    let metrics = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("judged");
    assert_eq!(metrics.means[&Metric::LpipsVgg], Score::undefined("no weights of LPIPS were given"));
    let empty = root.path().join("weights");
    std::fs::create_dir(&empty).expect("folder");
    let params = MetricEvaluationParams { lpips_weights: "lpips".into(), ..MetricEvaluationParams::default() };
    let metrics = run_with(root.path(), &params, &[("lpips_weights", &empty)]).expect("judged");
    let reason = "no vgg16-397923af.pth among the weights of LPIPS";
    assert_eq!(metrics.means[&Metric::LpipsVgg], Score::undefined(reason));
    assert_eq!(MetricEvaluation::sources(&params), [Source { name: "lpips_weights", path: "lpips".into() }]);
}

#[test]
fn only_a_camera_at_rest_flickers() {
    let flicker = |root: &Path| -> Metrics { run_with(root, &MetricEvaluationParams::default(), &[]).expect("judged") };
    let (moving, _) = world(None);
    assert!(!flicker(moving.path()).means.contains_key(&Metric::Flicker));
    let (root, renders) = world(Some(|_| DVec3::new(0.0, 0.0, -3.0)));
    assert_eq!(flicker(root.path()).means[&Metric::Flicker], Score::Value(0.0), "the error stays");
    picture(7).save(renders.image_path(&renders.views[1])).expect("written");
    let expected = 2.0 / 3.0 * 3.0 / 255.0;
    let found = flicker(root.path()).means[&Metric::Flicker].value().expect("defined");
    assert!((found - expected).abs() <= 1e-12, "two of three channels jump by three levels: {found}");
}

/// A `.npy` file of one f64 vector.
fn write_vector(path: &Path, values: &[f64]) {
    write_array(path, &[values.len()], values);
}

/// A `.npy` file of f64.
fn write_array(path: &Path, shape: &[usize], values: &[f64]) {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({sides}), }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{header:<117}\n").as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    std::fs::write(path, bytes).expect("written");
}

/// The file that says that the folder describes these renders.
fn write_hashes(folder: &Path, renders: &Renders) {
    let line = |view| {
        let path = renders.image_path(view);
        format!("{}  {}\n", Digest::of_file(&path).expect("read"), path.file_name().unwrap().to_string_lossy())
    };
    std::fs::write(folder.join("images.sha256"), renders.views.iter().map(line).collect::<String>()).expect("written");
}

#[test]
fn the_flow_of_renders_is_compared_with_that_of_the_truth() {
    let (root, renders) = world(Some(|_| DVec3::new(0.0, 0.0, -3.0)));
    let folder = root.path().join("features");
    let [width, height] = SIZE.map(|side| side as usize);
    let write = |kind: &str, shape: &[usize], flow: [f64; 2]| {
        std::fs::create_dir_all(folder.join(kind)).expect("folder");
        let count = shape.iter().product::<usize>() / 2;
        write_array(&folder.join(kind).join("test_1.npy"), shape, &flow.repeat(count));
    };
    let judged = || run_with(root.path(), &MetricEvaluationParams::default(), &[("frame_features", &folder)]);
    write("flow_of_renders", &[height, width, 2], [4.0, 1.0]);
    write_hashes(&folder, &renders);
    assert!(!judged().expect("judged").means.contains_key(&Metric::FlowOfVideo), "no flow of the truth");
    write("flow_of_truth", &[height, width, 2], [1.0, -3.0]);
    assert_eq!(judged().expect("judged").means[&Metric::FlowOfVideo], Score::Value(5.0));
    write("flow_of_truth", &[width, height, 2], [1.0, -3.0]);
    assert_eq!(kind_of(&judged().expect_err("another size")), FailureKind::BadInput);
    std::fs::remove_file(folder.join("flow_of_truth/test_1.npy")).expect("removed");
    assert_eq!(kind_of(&judged().expect_err("a flow is missing")), FailureKind::MissingData);
}

#[test]
fn consistency_is_of_the_very_renders_that_have_features() {
    let (root, renders) = world(None);
    let folder = root.path().join("features");
    std::fs::create_dir_all(folder.join("subject")).expect("folder");
    write_vector(&folder.join("subject/test_0.npy"), &[1.0, 0.0]);
    write_vector(&folder.join("subject/test_1.npy"), &[3.0, 4.0]);
    let judged = || run_with(root.path(), &MetricEvaluationParams::default(), &[("frame_features", &folder)]);
    assert_eq!(kind_of(&judged().expect_err("no hashes")), FailureKind::MissingData);
    write_hashes(&folder, &renders);
    let metrics = judged().expect("judged");
    let found = metrics.means[&Metric::SubjectConsistency].value().expect("defined");
    assert!((found - 0.6).abs() <= 1e-12, "{found}");
    assert!(!metrics.means.contains_key(&Metric::BackgroundConsistency), "no features of the background");
    write_vector(&folder.join("subject/test_1.npy"), &[3.0]);
    assert_eq!(kind_of(&judged().expect_err("another length")), FailureKind::BadInput);
    picture(50).save(renders.image_path(&renders.views[0])).expect("written");
    assert!(judged().expect_err("another render").to_string().contains("features of another render of test_0"));
}

#[test]
fn folders_that_nobody_reads_and_masks_without_folder_are_problems() {
    let keys = |params: MetricEvaluationParams| {
        MetricEvaluation::check_params(&params).into_iter().map(|problem| problem.key).collect::<Vec<_>>()
    };
    assert_eq!(keys(masked(MaskSource::Files, Keep::Nonzero)), ["mask_folder"]);
    let unread = MetricEvaluationParams { mask_folder: "masks".into(), ..MetricEvaluationParams::default() };
    assert_eq!(keys(unread), ["mask_folder"]);
    let outside = MetricEvaluationParams { lpips_weights: "../weights".into(), ..MetricEvaluationParams::default() };
    assert_eq!(keys(outside), ["lpips_weights"]);
}
