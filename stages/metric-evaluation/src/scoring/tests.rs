//! Metrics beyond pairs of images on a small capture: their inputs, and their outcome without these inputs.

use std::path::Path;

use engine::{Artifact as _, Digest, Failure, FailureKind, Source, Stage as _};
use glam::DVec3;
use rendering::{Renders, SurfaceMaps};
use scene::{Camera, DepthMap, Split, VelocityMap};

use crate::artifact::Metrics;
use crate::masks::{Keep, LabelMask, MaskFiles, MaskName, Masks};
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;
use crate::params::MetricEvaluationParams;
use crate::run::MetricEvaluation;
use crate::scoring::perceptual::NO_WEIGHTS;
use crate::tests::stage::{
    SIZE, picture, run_with, write_capture, write_capture_along, write_capture_with, write_renders,
};

/// Writes `capture` and `renders` into a folder.
fn world(camera: Option<fn(f64) -> DVec3>) -> (tempfile::TempDir, Renders) {
    let root = tempfile::tempdir().expect("temporary folder");
    let dir = root.path().join("capture");
    let capture = camera.map_or_else(|| write_capture(&dir), |position| write_capture_along(&dir, position));
    let renders = write_renders(&root.path().join("renders"), &capture);
    (root, renders)
}

fn masked(masks: Masks) -> MetricEvaluationParams {
    MetricEvaluationParams { masks, ..MetricEvaluationParams::default() }
}

fn labels(labels: LabelMask) -> MetricEvaluationParams {
    masked(Masks { labels, ..Masks::default() })
}

fn in_folder(folder: &str) -> MaskFiles {
    MaskFiles { folder: folder.into(), ..MaskFiles::default() }
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
    let psnr_of = |metrics: &Metrics| metrics.masked[&MaskName::Labels][&Metric::MaskedPsnr].value().expect("defined");
    let on_ball = run_with(root.path(), &labels(LabelMask::Nonzero), &[]).expect("evaluated");
    let expected = -10.0 * (2.0 / 3.0 * (3.0_f64 / 255.0).powi(2)).log10();
    assert!((psnr_of(&on_ball) - expected).abs() <= 1e-9, "{} instead of {expected}", psnr_of(&on_ball));
    assert!(on_ball.means[&Metric::Psnr].value().expect("defined") < expected - 5.0);
    let elsewhere = run_with(root.path(), &labels(LabelMask::Zero), &[]).expect("evaluated");
    assert!(psnr_of(&elsewhere) < expected - 5.0);
    assert_ne!(on_ball.judged_by(), elsewhere.judged_by(), "the pixels that a mask selects are part of the conditions");
    assert_eq!(on_ball.masked[&MaskName::Labels][&Metric::MaskedLpips], Score::undefined(NO_WEIGHTS));
    assert!(on_ball.means.keys().all(|metric| !metric.is_masked()), "a masked value belongs to its mask");
    let unmasked = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    assert!(unmasked.masked.is_empty());
}

#[test]
fn masked_metrics_stand_beside_those_of_the_mean_of_the_other_images() {
    let (root, renders) = world(None);
    let capture = root.path().join("capture");
    // The truths differ on the left by 100 levels, and on the right, where the ball is, by 40.
    for (view, [left, right]) in renders.views.iter().zip([[0, 100], [100, 140]]) {
        let truth = image::RgbImage::from_fn(SIZE[0], SIZE[1], |x, _| {
            image::Rgb([if x < SIZE[0] / 2 { left } else { right }; 3])
        });
        truth.save(capture.join("images").join(format!("{}.png", view.name))).expect("written");
    }
    let metrics = run_with(root.path(), &labels(LabelMask::Nonzero), &[]).expect("evaluated");
    let of_mean = &metrics.trivial.masked_mean_image[&MaskName::Labels];
    let expected = -20.0 * (40.0_f64 / 255.0).log10();
    assert!((of_mean[&Metric::MaskedPsnr] - expected).abs() <= 1e-6, "{of_mean:?} instead of {expected} dB");
    assert!(of_mean.contains_key(&Metric::MaskedSsim) && !of_mean.contains_key(&Metric::MaskedLpips), "{of_mean:?}");
    let line = format!("mean of the other images, mPSNR (labels): {expected:.2} dB");
    assert!(metrics.summary().contains(&line), "{}", metrics.summary());
    let mut forged = metrics;
    forged.trivial.masked_mean_image.clear();
    assert!(forged.check().is_err(), "the means differ from those of the images");
}

/// Writes a mask that is `value` in all pixels.
fn write_mask(folder: &Path, name: &str, size: [u32; 2], value: u8) {
    std::fs::create_dir_all(folder).expect("folder");
    image::GrayImage::from_pixel(size[0], size[1], image::Luma([value])).save(folder.join(name)).expect("written");
}

#[test]
fn mask_files_must_match_the_views() {
    let (root, _) = world(None);
    let folder = root.path().join("masks");
    std::fs::create_dir(&folder).expect("folder");
    let params = masked(Masks { co_visibility: in_folder("masks"), ..Masks::default() });
    let evaluated = || run_with(root.path(), &params, &[("co_visibility", &folder)]);
    assert_eq!(kind_of(&evaluated().expect_err("no mask")), FailureKind::MissingData);
    write_mask(&folder, "test_0.png", SIZE, 255);
    write_mask(&folder, "test_1.png.png", [SIZE[0], 3], 255);
    assert_eq!(kind_of(&evaluated().expect_err("another size")), FailureKind::BadInput);
    write_mask(&folder, "test_1.png.png", SIZE, 0);
    let metrics = evaluated().expect("evaluated");
    let red = image::RgbImage::from_pixel(SIZE[0], SIZE[1], image::Rgb([128, 0, 0]));
    red.save(folder.join("test_0.png")).expect("written");
    assert_eq!(evaluated().expect("evaluated"), metrics, "a mask may have a colour");
    let of_image = |at: usize, metric| &metrics.images[at].masked[&MaskName::CoVisibility][&metric];
    assert!(of_image(0, Metric::MaskedSsim).value().is_some());
    assert_eq!(*of_image(1, Metric::MaskedSsim), Score::undefined("the mask is empty"));
    let mean = &metrics.masked[&MaskName::CoVisibility][&Metric::MaskedPsnr];
    assert_eq!(mean, of_image(0, Metric::MaskedPsnr));
    let keeping = |keeps| {
        write_mask(&folder, "test_0.png", SIZE, 100);
        let files = MaskFiles { keeps, ..in_folder("masks") };
        let params = masked(Masks { co_visibility: files, ..Masks::default() });
        let found = run_with(root.path(), &params, &[("co_visibility", &folder)]).expect("evaluated");
        found.images[0].masked[&MaskName::CoVisibility][&Metric::MaskedPsnr].value().is_some()
    };
    assert_eq!([Keep::Nonzero, Keep::Zero, Keep::Half].map(keeping), [true, false, false]);
    let mut forged = metrics.clone();
    forged.masked.get_mut(&MaskName::CoVisibility).unwrap().insert(Metric::MaskedPsnr, Score::Value(1.0));
    assert!(forged.check().is_err());
}

#[test]
fn masks_of_one_job_are_kept_apart_and_one_may_be_missing() {
    let (root, renders) = world(None);
    // The left half of the first render is white; the masks select all pixels of one or of the other image.
    let path = renders.image_path(&renders.views[0]);
    image::RgbImage::from_pixel(SIZE[0], SIZE[1], image::Rgb([255; 3])).save(path).expect("written");
    let [visible, object] = ["covisible", "u2net"].map(|name| root.path().join(name));
    for (folder, values) in [(&visible, [255, 0]), (&object, [0, 255])] {
        write_mask(folder, "test_0.png", SIZE, values[0]);
        write_mask(folder, "test_1.png", SIZE, values[1]);
    }
    let optional = MaskFiles { allow_missing: true, ..in_folder("u2net") };
    let params = masked(Masks { co_visibility: in_folder("covisible"), foreground: optional, ..Masks::default() });
    let psnr = |metrics: &Metrics, mask| metrics.masked[&mask][&Metric::MaskedPsnr].value();
    let of_image = |metrics: &Metrics, at: usize| metrics.images[at].values[&Metric::Psnr].value();
    let both =
        run_with(root.path(), &params, &[("co_visibility", &visible), ("foreground", &object)]).expect("evaluated");
    let whole = [of_image(&both, 0), of_image(&both, 1)];
    let close = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| (a - b).abs() <= 1e-9);
    assert!(close(psnr(&both, MaskName::CoVisibility), whole[0]) && close(psnr(&both, MaskName::Foreground), whole[1]));
    assert!(whole[0] < whole[1]);
    // The folder of one mask is missing: its metrics are undefined with this reason, and the others are unchanged.
    let one = run_with(root.path(), &params, &[("co_visibility", &visible)]).expect("evaluated");
    assert_eq!(one.masked[&MaskName::CoVisibility], both.masked[&MaskName::CoVisibility]);
    let reason = "no foreground masks: u2net is missing";
    assert!(one.masked[&MaskName::Foreground].values().all(|score| *score == Score::undefined(reason)));
    assert_eq!(one.judged_by(), both.judged_by(), "masks have their own columns");
    let sources = MetricEvaluation::sources(&params);
    let optional = |name: &str| sources.iter().find(|source| source.name == name).map(|source| source.optional);
    assert_eq!(["co_visibility", "foreground", "lpips_weights"].map(optional), [Some(false), Some(true), Some(true)]);
}

#[test]
fn lpips_without_weights_is_undefined() {
    let (root, _) = world(None);
    let metrics = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    assert_eq!(metrics.means[&Metric::LpipsVgg], Score::undefined(NO_WEIGHTS));
    assert!(NO_WEIGHTS.contains("`pipeline data fetch lpips`"), "{NO_WEIGHTS}");
    let empty = root.path().join("weights");
    std::fs::create_dir(&empty).expect("folder");
    let params = MetricEvaluationParams { lpips_weights: "weights".into(), ..MetricEvaluationParams::default() };
    let metrics = run_with(root.path(), &params, &[("lpips_weights", &empty)]).expect("evaluated");
    let reason = "vgg16-397923af.pth is missing in the folder of LPIPS weights; `pipeline data fetch lpips` puts it into the \
                  folder lpips below the data root; torchvision publishes it: \
                  https://download.pytorch.org/models/vgg16-397923af.pth";
    assert_eq!(metrics.means[&Metric::LpipsVgg], Score::undefined(reason));
    assert_eq!(MetricEvaluation::sources(&params), [Source::required("lpips_weights", "weights".into())]);
    let by_convention = Source { name: "lpips_weights", path: "lpips".into(), optional: true };
    assert_eq!(MetricEvaluation::sources(&MetricEvaluationParams::default()), [by_convention]);
    let without = MetricEvaluationParams { lpips_weights: "".into(), ..MetricEvaluationParams::default() };
    assert!(MetricEvaluation::sources(&without).is_empty());
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

/// Writes the file that binds a folder of features to these renders.
fn write_hashes(folder: &Path, renders: &Renders) {
    let line = |view| {
        let path = renders.image_path(view);
        format!("{}  {}\n", Digest::of_file(&path).expect("read"), path.file_name().unwrap().to_string_lossy())
    };
    std::fs::write(folder.join("images.sha256"), renders.views.iter().map(line).collect::<String>()).expect("written");
}

/// Floaters of a render with surfaces at `covered` columns, all at depth 2. In the capture, the left half is empty, which
/// only alpha shows, and the depth of the four top rows is unknown.
fn floaters(has_alpha: bool, covered: fn(u32) -> bool) -> Score {
    let root = tempfile::tempdir().expect("temporary folder");
    let [width, height] = SIZE;
    let is_empty = |x: u32| x < width / 2;
    let pixels = move || (0..width * height).map(move |at| [at % width, at / width]);
    let capture = write_capture_with(
        &root.path().join("capture"),
        |_| DVec3::new(0.0, 0.0, -3.0),
        |frame| {
            let alpha = |x, _| image::Luma([if is_empty(x) { 0 } else { 255 }]);
            frame.alpha = has_alpha.then(|| image::GrayImage::from_fn(width, height, alpha));
            let depth_view = pixels().map(|[x, y]| if is_empty(x) || y < 4 { 0.0 } else { 2.0 }).collect();
            frame.depth = Some(DepthMap { width, height, depth_view });
        },
    );
    let dir = root.path().join("renders");
    let mut renders = write_renders(&dir, &capture);
    let alpha: Vec<f32> = pixels().map(|[x, _]| f32::from(u8::from(covered(x)))).collect();
    let maps = SurfaceMaps {
        width,
        height,
        depth_view: alpha.iter().map(|alpha| 2.0 * alpha).collect(),
        velocity_world: vec![[0.0; 3]; alpha.len()],
        flow_px: vec![[0.0; 2]; alpha.len()],
        moving: vec![0.0; alpha.len()],
        alpha,
    };
    for view in &mut renders.views {
        let file = Path::new("images").join(format!("{}.exr", view.name));
        maps.write(&dir.join(&file)).expect("written");
        view.maps = Some(file);
    }
    renders.save(&dir).expect("written");
    let metrics = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    metrics.means[&Metric::FloaterArea].clone()
}

#[test]
fn a_perfect_render_of_a_capture_with_holes_in_its_depth_has_no_floaters() {
    let perfect: fn(u32) -> bool = |x| x >= SIZE[0] / 2;
    assert_eq!(floaters(true, perfect), Score::Value(0.0));
    assert_eq!(floaters(false, perfect), Score::Value(0.0));
    // Half of the columns are empty; the others have depth in 12 of 16 rows.
    assert_eq!(floaters(true, |_| true), Score::Value(16.0 / (16.0 + 12.0)));
    assert_eq!(floaters(false, |_| true), Score::Value(0.0), "without alpha, an opaque pixel may show a surface");
}

#[test]
fn motion_in_a_scene_of_small_units_is_measured() {
    let root = tempfile::tempdir().expect("temporary folder");
    let [width, height] = SIZE;
    let capture = write_capture_with(
        &root.path().join("capture"),
        |_| DVec3::new(0.0, 0.0, -3e-4),
        |frame| {
            // A second training camera shows how far away the scene is.
            if frame.name == "test_0" {
                frame.split = Split::Train;
                frame.camera = Camera::look_at(frame.camera.intrinsics, DVec3::X * 3e-4, DVec3::ZERO, DVec3::Y);
            }
            let velocity_world = vec![[2e-4, 0.0, 0.0]; (width * height) as usize];
            frame.velocity = Some(VelocityMap { width, height, velocity_world });
        },
    );
    write_renders(&root.path().join("renders"), &capture);
    let metrics = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    let moving = &metrics.means[&Metric::PsnrMoving];
    assert!(moving.value().is_some(), "a scene of 0.0003 units that moves by its size in 1.5 s: {moving:?}");
}

#[test]
fn moving_surfaces_stand_beside_those_of_the_mean_of_the_other_images() {
    let root = tempfile::tempdir().expect("temporary folder");
    let [width, height] = SIZE;
    let is_moving = |at: u32| at % width >= width / 2;
    let capture = write_capture_with(
        &root.path().join("capture"),
        |_| DVec3::new(0.0, 0.0, -3.0),
        |frame| {
            let velocity = |at: u32| [if is_moving(at) { 1.0 } else { 0.0 }, 0.0, 0.0];
            let velocity_world = (0..width * height).map(velocity).collect();
            frame.velocity = Some(VelocityMap { width, height, velocity_world });
            // The truths differ by 100 levels on the left, and by 40 on the right, which moves.
            let [left, right] = if frame.name == "test_0" { [0, 100] } else { [100, 140] };
            frame.image = image::RgbImage::from_fn(width, height, |x, _| {
                image::Rgb([if is_moving(x) { right } else { left }; 3])
            });
        },
    );
    write_renders(&root.path().join("renders"), &capture);
    let metrics = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    let expected = -20.0 * (40.0_f64 / 255.0).log10();
    let of_mean = metrics.trivial.moving_mean_image[&Metric::PsnrMoving];
    assert!((of_mean - expected).abs() <= 1e-6, "{of_mean} instead of {expected} dB");
    assert!(metrics.summary().contains(&format!("mean of the other images, PSNR moving: {expected:.2} dB")));
    let mut forged = metrics;
    forged.trivial.moving_mean_image.clear();
    assert!(forged.check().is_err(), "the means differ from those of the images");
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
fn folders_outside_of_the_data_root_are_problems() {
    let keys = |params: MetricEvaluationParams| {
        MetricEvaluation::check_params(&params).into_iter().map(|problem| problem.key).collect::<Vec<_>>()
    };
    assert_eq!(
        keys(masked(Masks { foreground: in_folder("../masks"), ..Masks::default() })),
        ["masks.foreground.folder"]
    );
    let inverted = MaskFiles { keeps: Keep::Zero, ..in_folder("masks") };
    assert!(keys(masked(Masks { other: inverted, ..Masks::default() })).is_empty());
    let outside = MetricEvaluationParams { lpips_weights: "../weights".into(), ..MetricEvaluationParams::default() };
    assert_eq!(keys(outside), ["lpips_weights"]);
}
