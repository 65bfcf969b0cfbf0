//! The whole stage on synthetic captures and benchmark files.

mod files;
mod filled;
mod real;
mod synthetic;
mod tools;
mod tracks;

use std::path::Path;

use engine::{Artifact as _, Coordinates, InputRecord, JobContext, Stage as _};
use scene::Capture;
use scene_synthesis::{CameraPath, Params as Scene, SceneKind, Truth};
use tempfile::TempDir;

use crate::{DepthFlowImport, Params, Priors};

/// Renders a small synthetic capture of five frames into `dir`.
fn capture(dir: &Path, scene: SceneKind, camera: CameraPath) -> Capture {
    capture_of(5, dir, scene, camera)
}

/// Renders a small synthetic capture into `dir`.
fn capture_of(frames: usize, dir: &Path, scene: SceneKind, camera: CameraPath) -> Capture {
    let params = Scene {
        scene,
        camera,
        width: 48,
        height: 32,
        frames,
        rig_cameras: 2,
        val_views: 0,
        test_views: 2,
        samples_per_pixel: 1,
        truths: [Truth::Depth, Truth::Flow, Truth::Velocity, Truth::Points].into(),
        ..Scene::default()
    };
    scene_synthesis::synthesize(&params, dir, 1, |_, _| Ok(())).unwrap()
}

/// Runs the stage on a capture, with `folder` as its source folder of maps.
fn run(capture: &Capture, folder: &Path, params: &Params) -> anyhow::Result<(TempDir, Priors, serde_json::Value)> {
    let root = tempfile::tempdir()?;
    let mut context = JobContext::detached(root.path())?;
    context.threads = 2;
    let record = InputRecord {
        producer: "capture".into(),
        coordinates: Coordinates::new(),
        artifact: Ok(capture.dir.clone()),
        measurements: serde_json::Value::Null,
        action_key: String::new(),
    };
    context.inputs.insert("capture".into(), vec![record]);
    context.sources.insert("folder".into(), folder.into());
    DepthFlowImport::run(&context, params)?.check()?;
    let priors = Priors::open(&root.path().join("output"))?;
    priors.check()?;
    priors.check_against(capture)?;
    let measurements = serde_json::Value::Object(context.measurements.borrow().clone());
    Ok((root, priors, measurements))
}

/// Asserts that the stage fails with a message that contains all `parts`.
fn assert_refused(capture: &Capture, folder: &Path, params: &Params, parts: &[&str]) {
    match run(capture, folder, params) {
        Ok(_) => panic!("accepted, instead of {parts:?}"),
        Err(error) => {
            let message = format!("{error:#}");
            for part in parts {
                assert!(message.contains(part), "{part:?} is not in {message:?}");
            }
        }
    }
}
