//! The whole stage on synthetic captures with known labels.

use std::path::Path;

use depth_flow_import::Priors;
use engine::{Artifact as _, Coordinates, Facts, InputRecord, JobContext, PlanContext, Stage as _};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Capture, LabelMap, Mask, Split, facts};
use scene_synthesis::{CameraPath, Params as Scene, SceneKind, Truth};
use tempfile::TempDir;

use crate::params::{LayerSource, Polarity};
use crate::run::polarity_advice;
use crate::{LayerSplit, Layers, Params};

/// Renders a small capture with the given maps into `dir`.
pub(crate) fn capture(dir: &Path, scene: SceneKind, camera: CameraPath, truths: &[Truth]) -> Capture {
    capture_of(5, dir, scene, camera, truths)
}

/// Like [`capture`], with `frames` frames.
pub(crate) fn capture_of(frames: usize, dir: &Path, scene: SceneKind, camera: CameraPath, truths: &[Truth]) -> Capture {
    let params = Scene {
        scene,
        camera,
        width: 64,
        height: 64,
        frames,
        rig_cameras: 2,
        val_views: 0,
        test_views: 0,
        samples_per_pixel: 1,
        truths: truths.iter().copied().collect(),
        ..Scene::default()
    };
    scene_synthesis::synthesize(&params, dir, 1, |_, _| Ok(())).unwrap()
}

/// One producer whose artifact is in `dir`.
fn input(dir: &Path) -> Vec<InputRecord> {
    vec![InputRecord {
        producer: "test".into(),
        coordinates: Coordinates::new(),
        artifact: Ok(dir.into()),
        measurements: serde_json::Value::Null,
        action_key: String::new(),
    }]
}

/// Runs the stage with the given artifact folder of priors and source folder of masks.
pub(crate) fn run(
    capture: &Capture,
    priors: Option<&Path>,
    folder: &Path,
    params: &Params,
) -> anyhow::Result<(TempDir, Layers)> {
    run_measured(capture, priors, folder, params).map(|(root, layers, _)| (root, layers))
}

/// Like [`run`], with the measurements.
pub(crate) fn run_measured(
    capture: &Capture,
    priors: Option<&Path>,
    folder: &Path,
    params: &Params,
) -> anyhow::Result<(TempDir, Layers, serde_json::Map<String, serde_json::Value>)> {
    let root = tempfile::tempdir()?;
    let mut context = JobContext::detached(root.path())?;
    context.inputs.insert("capture".into(), input(&capture.dir));
    context.inputs.insert("priors".into(), priors.map(input).unwrap_or_default());
    context.sources.insert("folder".into(), folder.into());
    LayerSplit::run(&context, params)?.check()?;
    let layers = Layers::open(&root.path().join("output"))?;
    layers.check()?;
    layers.check_against(capture)?;
    let measurements = context.measurements.borrow().clone();
    Ok((root, layers, measurements))
}

/// Priors with exact depth and flow, with noise of `sigma_px` on the flow, and without velocity, which would reveal the
/// answer.
fn priors(capture: &Capture, sigma_px: f32) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut normal = || sigma_px * ((0..12).map(|_| random.random::<f32>()).sum::<f32>() - 6.0);
    let frame_secs = capture.time_map.frame_secs;
    let mut view = |view: &scene::View| {
        let mut maps = depth_flow_import::ViewMaps { depth: capture.load_depth(view).unwrap(), ..Default::default() };
        maps.flow = capture.load_flow(view).unwrap().map(|mut map| {
            map.flow_px.iter_mut().flatten().for_each(|value| *value += normal());
            let next = |other: &scene::View| {
                other.camera == view.camera && (other.time_secs - view.time_secs - frame_secs).abs() < 1e-6
            };
            depth_flow_import::FlowPrior {
                map,
                camera_to: view.camera,
                time_to_secs: view.time_secs + frame_secs,
                view_to: capture.views.iter().position(next),
            }
        });
        Priors::write_view(dir.path(), &view.name, view.camera, &maps).unwrap()
    };
    let views = capture.views.iter().map(&mut view).collect();
    Priors::save(dir.path(), "capture", views).unwrap();
    dir
}

/// Intersection over union of masks and true labels, over all views that have a mask.
pub(crate) fn agreement(capture: &Capture, layers: &Layers) -> f64 {
    let (mut both, mut either) = (0, 0);
    for (index, view) in capture.views.iter().enumerate() {
        let (Some(found), Some(truth)) = (layers.load_moving(index).unwrap(), capture.load_mask(view).unwrap()) else {
            continue;
        };
        for (found, truth) in found.labels.iter().zip(&truth.labels) {
            both += usize::from(*found != 0 && *truth != 0);
            either += usize::from(*found != 0 || *truth != 0);
        }
    }
    f64::from(both as u32) / f64::from(either as u32)
}

const FLOW_AND_LABELS: [Truth; 3] = [Truth::Depth, Truth::Flow, Truth::Masks];

fn residual_flow() -> Params {
    Params { source: LayerSource::ResidualFlow, ..Params::default() }
}

#[test]
fn temporal_medians_segment_what_moves_before_static_cameras() {
    let params = Params { source: LayerSource::TemporalMedian, dilation_px: 1, ..Params::default() };
    let nothing = Path::new("");
    let dir = tempfile::tempdir().unwrap();
    let rig = capture(dir.path(), SceneKind::BouncingSpheres, CameraPath::Rig, &[Truth::Masks]);
    let (_root, layers) = run(&rig, None, nothing, &params).unwrap();
    let found = agreement(&rig, &layers);
    // Widened by a pixel all around, and blind where a ball is seen twice.
    assert!(found >= 0.5, "{found}");
    let wide = Params { dilation_px: 8, ..params.clone() };
    let (_root, layers) = run(&rig, None, nothing, &wide).unwrap();
    assert!(agreement(&rig, &layers) < 0.8 * found, "widened masks fit worse");
    let dir = tempfile::tempdir().unwrap();
    let moving = capture(dir.path(), SceneKind::BouncingSpheres, CameraPath::Arc, &[Truth::Masks]);
    let error = run(&moving, None, nothing, &params).unwrap_err().to_string();
    assert!(error.contains("every camera pose"), "{error}");
}

#[test]
fn residual_flow_segments_moving_instances() {
    for (scene, camera) in [
        (SceneKind::BouncingSpheres, CameraPath::Arc),
        (SceneKind::BouncingSpheres, CameraPath::Rig),
        (SceneKind::SwingingArm, CameraPath::Arc),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let capture = capture(dir.path(), scene, camera, &FLOW_AND_LABELS);
        // Motion below five standard deviations of the noise is not detected, e.g. the arm near its axis.
        for sigma_px in [0.0, 0.04] {
            let priors = priors(&capture, sigma_px);
            let params = Params { min_residual_px: 0.2, ..residual_flow() };
            let (_root, layers) = run(&capture, Some(priors.path()), Path::new(""), &params).unwrap();
            let agreement = agreement(&capture, &layers);
            eprintln!("{scene:?} {camera:?}, noise {sigma_px} px: IoU {agreement:.3}");
            assert!(agreement > 0.9, "{scene:?} {camera:?} {sigma_px}: {agreement}");
            assert_eq!(layers.source, "residual-flow");
            // The last frame has no flow. In a rig, flow leads to it; for a moving camera, none does.
            let unknown = layers.views.iter().filter(|view| view.moving.is_none()).count();
            assert_eq!(unknown, usize::from(camera == CameraPath::Arc));
        }
    }
}

#[test]
fn flow_of_another_capture_is_rejected() {
    // Planted fault: priors of the same scene with other cameras.
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let arc = capture(dir.path(), SceneKind::BouncingSpheres, CameraPath::Arc, &FLOW_AND_LABELS);
    let rig = capture(other.path(), SceneKind::BouncingSpheres, CameraPath::Rig, &FLOW_AND_LABELS);
    let error = run(&arc, Some(priors(&rig, 0.0).path()), Path::new(""), &residual_flow()).err().unwrap();
    assert!(format!("{error:#}").contains("another capture"), "{error:#}");
}

#[test]
fn nothing_moves_in_a_static_scene_despite_noise() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc, &FLOW_AND_LABELS);
    for sigma_px in [0.0, 0.1, 0.7] {
        let priors = priors(&capture, sigma_px);
        let (_root, layers) = run(&capture, Some(priors.path()), Path::new(""), &residual_flow()).unwrap();
        assert!(layers.moving_share() <= 1e-3, "{sigma_px}: {}", layers.moving_share());
    }
    let priors = priors(&capture, 0.7);
    let sensitive = Params { noise_multiple: 0.0, ..residual_flow() };
    let (_root, layers) = run(&capture, Some(priors.path()), Path::new(""), &sensitive).unwrap();
    assert!(layers.moving_share() > 0.3, "the test is blind to noise: {}", layers.moving_share());
}

#[test]
fn exact_velocity_and_labels_take_precedence() {
    let dir = tempfile::tempdir().unwrap();
    let labelled = capture(dir.path(), SceneKind::SwingingArm, CameraPath::Arc, &[Truth::Masks]);
    let (_root, layers) = run(&labelled, None, Path::new(""), &Params::default()).unwrap();
    assert_eq!((layers.source.as_str(), agreement(&labelled, &layers)), ("masks", 1.0));
    let rests = Params { polarity: Polarity::SetRests, ..Params::default() };
    let (_root, layers) = run(&labelled, None, Path::new(""), &rests).unwrap();
    assert_eq!(agreement(&labelled, &layers), 0.0);

    let dir = tempfile::tempdir().unwrap();
    let moving = capture(dir.path(), SceneKind::SwingingArm, CameraPath::Arc, &[Truth::Velocity]);
    let (_root, layers) = run(&moving, None, Path::new(""), &Params::default()).unwrap();
    assert_eq!(layers.source, "velocity");
    let share = layers.moving_share();
    assert!(share > 0.01, "{share}");
    let dir = tempfile::tempdir().unwrap();
    let both = capture(dir.path(), SceneKind::SwingingArm, CameraPath::Arc, &[Truth::Velocity, Truth::Masks]);
    let (_root, layers) = run(&both, None, Path::new(""), &Params::default()).unwrap();
    assert_eq!(layers.source, "velocity+masks");
    assert!(layers.moving_share() >= share && agreement(&both, &layers) > 0.95);
}

#[test]
fn a_capture_without_evidence_is_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let bare = capture(dir.path(), SceneKind::SwingingArm, CameraPath::Arc, &[Truth::Depth]);
    let refusal = |params: &Params| format!("{:#}", run(&bare, None, Path::new(""), params).err().unwrap());
    let error = refusal(&Params::default());
    assert!(error.contains("nothing determines what moves") && error.contains("port priors"), "{error}");
    let error = refusal(&residual_flow());
    assert!(error.contains("residual flow needs depth and flow"), "{error}");
}

#[test]
fn masks_in_files_follow_polarity_and_threshold() {
    let (dir, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture(dir.path(), SceneKind::SwingingArm, CameraPath::Arc, &[Truth::Masks]);
    let files = Params { source: LayerSource::Files, folder: "mask".into(), ..Params::default() };
    let error = run(&capture, None, &folder.path().join("none"), &files).err().unwrap();
    assert!(format!("{error:#}").contains("no such folder of masks"), "{error:#}");
    // A soft matte: 255 inside, 20 outside. One file has twice the size and the number of its frame as its name.
    for (index, view) in capture.views_of(Split::Train) {
        let truth = Mask::from(&capture.load_mask(view).unwrap().unwrap());
        let grey = |inside: bool| if inside { 255 } else { 20 };
        let double = index == 1;
        let side = if double { 128 } else { 64 };
        let scale = side / 64;
        let at = |x: u32, y: u32| truth.inside[(y / scale * 64 + x / scale) as usize];
        let labels = (0..side * side).map(|pixel| grey(at(pixel % side, pixel / side))).collect();
        let name = if double { format!("{:05}", view.frame_index) } else { view.name.clone() };
        LabelMap { width: side, height: side, labels }.write(&folder.path().join(format!("{name}.png"))).unwrap();
    }
    let matte = Params { threshold: 127, ..files.clone() };
    let (_root, layers) = run(&capture, None, folder.path(), &matte).unwrap();
    assert_eq!(agreement(&capture, &layers), 1.0);
    let error = run(&capture, None, folder.path(), &files).err().unwrap();
    assert!(format!("{error:#}").contains("every pixel of every mask moves"), "{error:#}");
    let inverted = Params { polarity: Polarity::SetRests, ..matte };
    assert_eq!(agreement(&capture, &run(&capture, None, folder.path(), &inverted).unwrap().1), 0.0);
}

#[test]
fn the_advice_on_polarity_fits_the_place_of_the_masks() {
    let advice = |source, polarity| polarity_advice(0.9, source, polarity).unwrap_or_default();
    assert!(advice("files", Polarity::Auto).contains("set polarity"));
    assert!(advice("masks", Polarity::Auto).contains("invert their files"));
    assert!(advice("masks", Polarity::SetRests).contains("remove polarity"));
    assert_eq!(advice("masks", Polarity::SetMoves), "");
    assert!(advice("files", Polarity::SetRests).contains("remove polarity"));
    assert_eq!(advice("residual-flow", Polarity::Auto), "", "polarity is for masks");
    assert_eq!(polarity_advice(0.5, "masks", Polarity::Auto), None);
}

#[test]
fn masks_of_the_capture_that_say_that_everything_moves_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(dir.path(), SceneKind::BouncingSpheres, CameraPath::Arc, &[Truth::Masks]);
    for view in &capture.views {
        let path = dir.path().join(view.mask.as_ref().unwrap());
        image::GrayImage::from_pixel(64, 64, image::Luma([1])).save(path).unwrap();
    }
    let error = format!("{:#}", run(&capture, None, dir.path(), &Params::default()).unwrap_err());
    assert!(error.contains("every pixel of every mask moves") && error.contains("polarity"), "{error}");
}

#[test]
fn priors_are_read_only_if_they_decide() {
    let unread = |source: LayerSource, capture: Facts| {
        let context = PlanContext { data_root: Path::new(""), inputs: [("capture".to_owned(), vec![capture])].into() };
        let params = Params { source, ..Params::default() };
        let resolution = LayerSplit::resolve(params.clone(), &context).unwrap();
        assert_eq!(resolution.params, params);
        resolution.unread.contains("priors")
    };
    let masked = || Facts::default().with(facts::MASKS, true);
    assert!(unread(LayerSource::Auto, masked()));
    assert!(unread(LayerSource::Files, Facts::default()));
    assert!(!unread(LayerSource::Auto, Facts::default()), "an unknown fact may be false");
    assert!(!unread(LayerSource::Auto, Facts::default().with(facts::VELOCITY, false)));
    assert!(!unread(LayerSource::ResidualFlow, masked()));
}

#[test]
fn values_that_the_source_does_not_read_are_refused() {
    let problems = |params: Params| -> Vec<String> {
        let problems = LayerSplit::check_params(&params).into_iter();
        problems.map(|problem| format!("{}: {}; {}", problem.key, problem.message, problem.hint.unwrap())).collect()
    };
    let unread = |key: &str, source: &str, reader: &str| {
        vec![format!("{key}: source = \"{source}\" does not read it; remove {key}, or set source = \"{reader}\"")]
    };
    let auto = Params::default();
    let [flow, median, files] = [LayerSource::ResidualFlow, LayerSource::TemporalMedian, LayerSource::Files]
        .map(|source| Params { source, ..Params::default() });
    let files = Params { folder: "mask".into(), ..files };
    for source in [&auto, &flow, &median, &files] {
        assert_eq!(problems(source.clone()), Vec::<String>::new());
    }
    assert_eq!(problems(Params { threshold: 127, ..auto.clone() }), unread("threshold", "auto", "files"));
    let rests = |params: &Params| problems(Params { polarity: Polarity::SetRests, ..params.clone() });
    assert_eq!(rests(&flow), unread("polarity", "residual-flow", "files"));
    assert_eq!([rests(&auto), rests(&files)], [Vec::new(), Vec::<String>::new()]);
    let sensitive = |params: &Params| problems(Params { noise_multiple: 3.0, ..params.clone() });
    assert_eq!(sensitive(&median), unread("noise_multiple", "temporal-median", "residual-flow"));
    assert_eq!([sensitive(&auto), sensitive(&flow)], [Vec::new(), Vec::<String>::new()]);
    let wide = |params: &Params| problems(Params { dilation_px: 8, ..params.clone() });
    assert_eq!(wide(&files), unread("dilation_px", "files", "temporal-median"));
    assert_eq!(wide(&median), Vec::<String>::new());
}
