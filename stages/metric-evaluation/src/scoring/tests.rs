//! Metrics beyond pairs of images on a small capture: their inputs, and their outcome without these inputs.

use std::path::Path;

use engine::{Digest, Failure, FailureKind, Source, Stage as _};
use glam::DVec3;
use rendering::Renders;

use crate::artifact::Metrics;
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;
use crate::params::{Keep, MaskSource, MetricEvaluationParams};
use crate::run::MetricEvaluation;
use crate::scoring::perceptual::NO_WEIGHTS;
use crate::tests::stage::{SIZE, picture, run_with, write_capture, write_capture_along, write_renders};

/// Writes `capture` and `renders` into a folder.
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
fn labels_restrict_masked_metrics() {
    let (root, renders) = world(None);
    // The ball is on the right, so an error on the left must be ignored.
    let path = renders.image_path(&renders.views[0]);
    let mut image = picture(10);
    image.enumerate_pixels_mut().filter(|(x, ..)| *x < SIZE[0] / 2).for_each(|(.., pixel)| pixel.0 = [255; 3]);
    image.save(path).expect("written");
    let on_ball = run_with(root.path(), &masked(MaskSource::Labels, Keep::Nonzero), &[]).expect("evaluated");
    let expected = -10.0 * (2.0 / 3.0 * (3.0_f64 / 255.0).powi(2)).log10();
    let masked_psnr = on_ball.means[&Metric::MaskedPsnr].value().expect("defined");
    assert!((masked_psnr - expected).abs() <= 1e-9, "{masked_psnr} instead of {expected}");
    assert!(on_ball.means[&Metric::Psnr].value().expect("defined") < expected - 5.0);
    let elsewhere = run_with(root.path(), &masked(MaskSource::Labels, Keep::Zero), &[]).expect("evaluated");
    assert!(elsewhere.means[&Metric::MaskedPsnr].value().expect("defined") < expected - 5.0);
    assert_ne!(on_ball.judged_by(), elsewhere.judged_by(), "masks are part of the conditions");
    assert_eq!(on_ball.means[&Metric::MaskedLpips], Score::undefined(NO_WEIGHTS));
    let unmasked = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    assert!(!unmasked.means.contains_key(&Metric::MaskedPsnr));
}

#[test]
fn mask_files_must_match_the_views() {
    let (root, _) = world(None);
    let folder = root.path().join("masks");
    std::fs::create_dir(&folder).expect("folder");
    let write = |name: &str, size: [u32; 2], value: u8| {
        image::GrayImage::from_pixel(size[0], size[1], image::Luma([value])).save(folder.join(name)).expect("written");
    };
    let evaluated = || run_with(root.path(), &masked(MaskSource::Files, Keep::Nonzero), &[("mask_folder", &folder)]);
    assert_eq!(kind_of(&evaluated().expect_err("no mask")), FailureKind::MissingData);
    write("test_0.png", SIZE, 255);
    write("test_1.png.png", [SIZE[0], 3], 255);
    assert_eq!(kind_of(&evaluated().expect_err("another size")), FailureKind::BadInput);
    write("test_1.png.png", SIZE, 0);
    let metrics = evaluated().expect("evaluated");
    let scores: Vec<&Score> = metrics.images.iter().map(|image| &image.values[&Metric::MaskedSsim]).collect();
    assert!(scores[0].value().is_some(), "{scores:?}");
    assert_eq!(*scores[1], Score::undefined("the mask is empty"));
    assert_eq!(metrics.means[&Metric::MaskedPsnr], metrics.images[0].values[&Metric::MaskedPsnr]);
}

#[test]
fn lpips_without_weights_is_undefined() {
    let (root, _) = world(None);
    let metrics = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    assert_eq!(metrics.means[&Metric::LpipsVgg], Score::undefined(NO_WEIGHTS));
    let empty = root.path().join("weights");
    std::fs::create_dir(&empty).expect("folder");
    let params = MetricEvaluationParams { lpips_weights: "lpips".into(), ..MetricEvaluationParams::default() };
    let metrics = run_with(root.path(), &params, &[("lpips_weights", &empty)]).expect("evaluated");
    let reason = "vgg16-397923af.pth is missing in the folder of LPIPS weights; torchvision publishes it: \
                  https://download.pytorch.org/models/vgg16-397923af.pth";
    assert_eq!(metrics.means[&Metric::LpipsVgg], Score::undefined(reason));
    assert_eq!(MetricEvaluation::sources(&params), [Source { name: "lpips_weights", path: "lpips".into() }]);
}

#[test]
fn flicker_needs_a_fixed_camera() {
    let flicker =
        |root: &Path| -> Metrics { run_with(root, &MetricEvaluationParams::default(), &[]).expect("evaluated") };
    let (moving, _) = world(None);
    assert!(!flicker(moving.path()).means.contains_key(&Metric::Flicker));
    let (root, renders) = world(Some(|_| DVec3::new(0.0, 0.0, -3.0)));
    assert_eq!(flicker(root.path()).means[&Metric::Flicker], Score::Value(0.0), "the error is constant");
    picture(7).save(renders.image_path(&renders.views[1])).expect("written");
    let expected = 2.0 / 3.0 * 3.0 / 255.0;
    let found = flicker(root.path()).means[&Metric::Flicker].value().expect("defined");
    assert!((found - expected).abs() <= 1e-12, "two of three channels jump by three levels: {found}");
}

/// Writes a `.npy` file with one f64 vector.
fn write_vector(path: &Path, values: &[f64]) {
    write_array(path, &[values.len()], values);
}

/// Writes a `.npy` file of f64 values.
fn write_array(path: &Path, shape: &[usize], values: &[f64]) {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({sides}), }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{header:<117}\n").as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    std::fs::write(path, bytes).expect("written");
}

/// Writes the file that ties a folder of features to these renders.
fn write_hashes(folder: &Path, renders: &Renders) {
    let line = |view| {
        let path = renders.image_path(view);
        format!("{}  {}\n", Digest::of_file(&path).expect("read"), path.file_name().unwrap().to_string_lossy())
    };
    std::fs::write(folder.join("images.sha256"), renders.views.iter().map(line).collect::<String>()).expect("written");
}

#[test]
fn flows_of_renders_and_ground_truth_are_compared() {
    let (root, renders) = world(Some(|_| DVec3::new(0.0, 0.0, -3.0)));
    let folder = root.path().join("features");
    let [width, height] = SIZE.map(|side| side as usize);
    let write = |kind: &str, shape: &[usize], flow: [f64; 2]| {
        std::fs::create_dir_all(folder.join(kind)).expect("folder");
        let count = shape.iter().product::<usize>() / 2;
        write_array(&folder.join(kind).join("test_1.npy"), shape, &flow.repeat(count));
    };
    let evaluated = || run_with(root.path(), &MetricEvaluationParams::default(), &[("frame_features", &folder)]);
    write("flow_of_renders", &[height, width, 2], [4.0, 1.0]);
    write_hashes(&folder, &renders);
    assert!(!evaluated().expect("evaluated").means.contains_key(&Metric::FlowOfVideo), "no flow of the truth");
    write("flow_of_truth", &[height, width, 2], [1.0, -3.0]);
    assert_eq!(evaluated().expect("evaluated").means[&Metric::FlowOfVideo], Score::Value(5.0));
    write("flow_of_truth", &[width, height, 2], [1.0, -3.0]);
    assert_eq!(kind_of(&evaluated().expect_err("another size")), FailureKind::BadInput);
    std::fs::remove_file(folder.join("flow_of_truth/test_1.npy")).expect("removed");
    assert_eq!(kind_of(&evaluated().expect_err("a flow is missing")), FailureKind::MissingData);
}

#[test]
fn features_of_other_renders_are_refused() {
    let (root, renders) = world(None);
    let folder = root.path().join("features");
    std::fs::create_dir_all(folder.join("subject")).expect("folder");
    write_vector(&folder.join("subject/test_0.npy"), &[1.0, 0.0]);
    write_vector(&folder.join("subject/test_1.npy"), &[3.0, 4.0]);
    let evaluated = || run_with(root.path(), &MetricEvaluationParams::default(), &[("frame_features", &folder)]);
    assert_eq!(kind_of(&evaluated().expect_err("no hashes")), FailureKind::MissingData);
    write_hashes(&folder, &renders);
    let metrics = evaluated().expect("evaluated");
    let found = metrics.means[&Metric::SubjectConsistency].value().expect("defined");
    assert!((found - 0.6).abs() <= 1e-12, "{found}");
    assert!(!metrics.means.contains_key(&Metric::BackgroundConsistency), "no features of the background");
    write_vector(&folder.join("subject/test_1.npy"), &[3.0]);
    assert_eq!(kind_of(&evaluated().expect_err("another length")), FailureKind::BadInput);
    picture(50).save(renders.image_path(&renders.views[0])).expect("written");
    assert!(
        evaluated()
            .expect_err("another render")
            .to_string()
            .contains("the features belong to another render of test_0")
    );
}

#[test]
fn unused_and_missing_folders_are_problems() {
    let keys = |params: MetricEvaluationParams| {
        MetricEvaluation::check_params(&params).into_iter().map(|problem| problem.key).collect::<Vec<_>>()
    };
    assert_eq!(keys(masked(MaskSource::Files, Keep::Nonzero)), ["mask_folder"]);
    let unread = MetricEvaluationParams { mask_folder: "masks".into(), ..MetricEvaluationParams::default() };
    assert_eq!(keys(unread), ["mask_folder"]);
    let outside = MetricEvaluationParams { lpips_weights: "../weights".into(), ..MetricEvaluationParams::default() };
    assert_eq!(keys(outside), ["lpips_weights"]);
}
