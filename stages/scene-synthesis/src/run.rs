//! The stage: renders every shot and writes the capture.

use std::path::Path;

use captures::{CaptureArtifact, all_views, pixels_per_view, with_sizes};
use engine::{Facts, JobContext, ParamProblem, PlanContext, Port, Resources, Stage, Work};
use rayon::prelude::*;
use scene::camera::common_view_volume;
use scene::{Camera, Capture, CaptureInfo, CaptureWriter, Frame, PointCloud, Protocol, TimeMap, facts};

use crate::params::{Background, Bounds, CameraPath, Params, Truth};
use crate::render::{render, surface_points};
use crate::scenes;
use crate::shots::{Shot, shots};
use crate::world::World;

/// Number of views per thread between two progress reports.
const VIEWS_PER_REPORT: usize = 4;

/// The stage `scene-synthesis`.
pub struct SceneSynthesis;

impl Stage for SceneSynthesis {
    type Params = Params;
    type Output = CaptureArtifact;

    const ID: &'static str = "scene-synthesis";
    const ABOUT: &'static str = "renders an analytic dynamic scene with exact depth, flow, masks and velocity";

    fn ports() -> Vec<Port> {
        Vec::new()
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    /// Every fact is known, because the world is a function of the parameters.
    fn facts(params: &Params, _context: &PlanContext<'_>) -> Facts {
        let moves = scenes::build(params).bodies.iter().any(|body| body.label != 0);
        let views = [params.training_views(), params.val_views, params.test_views];
        with_sizes(Facts::default(), (params.width, params.height), views)
            .with(facts::TIMES, params.frames)
            .with(facts::MOVING, moves && params.frames > 1)
            .with(facts::VIEW_DEPENDENT, params.specular > 0.0)
            .with(facts::TELEPORTING_CAMERA, params.camera == CameraPath::Hemisphere)
            .with(facts::POINTS, params.wants(Truth::Points))
            .with(facts::DEPTH, params.wants(Truth::Depth))
            .with(facts::FLOW, params.wants(Truth::Flow))
            .with(facts::NORMALS, false)
            .with(facts::VELOCITY, params.wants(Truth::Velocity))
            .with(facts::MASKS, params.wants(Truth::Masks))
    }

    /// Rays that are cast.
    fn work(params: &Params, context: &PlanContext<'_>) -> Option<Work> {
        let known = Self::facts(params, context);
        let pixels = all_views(&known)? * pixels_per_view(&known)?;
        Work::of("", pixels * f64::from(params.samples_per_pixel))
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 }
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<CaptureArtifact> {
        let report = |done: usize, total: usize| {
            context.progress(done as u64, total as u64, "views");
            if context.should_stop() { Err(context.interrupted()) } else { Ok(()) }
        };
        Ok(CaptureArtifact(synthesize(params, context.output_dir(), context.threads, report)?))
    }
}

/// Renders a capture into `dir` with `threads` threads (0 uses all cores). The bytes do not depend on the number of
/// threads.
///
/// `report(done, total)` is called with the number of written views and all views; its error stops the rendering.
pub fn synthesize(
    params: &Params,
    dir: &Path,
    threads: usize,
    report: impl Fn(usize, usize) -> anyhow::Result<()>,
) -> anyhow::Result<Capture> {
    if let Some(problem) = params.problems().first() {
        anyhow::bail!("{} {}", problem.key, problem.message);
    }
    let world = scenes::build(params);
    let shots = shots(params, world.center_world);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let mut writer = CaptureWriter::create(dir, info(params, &world, &shots))?;
    let mut done = 0;
    for some in shots.chunks(VIEWS_PER_REPORT * pool.current_num_threads()) {
        report(done, shots.len())?;
        let write = |shot: &Shot| writer.write_view(&scaled_frame(render(&world, shot, params), params.scale));
        pool.install(|| some.par_iter().try_for_each(write))?;
        done += some.len();
    }
    report(done, shots.len())?;
    if params.wants(Truth::Points) {
        let training = params.training_views();
        let points = surface_points(&world, &shots[..training], params);
        writer.write_points(&scaled_points(points, params.scale))?;
    }
    Ok(writer.finish()?)
}

/// A frame of the scene with all lengths multiplied by `scale`; image, alpha, flow and labels do not change.
fn scaled_frame(mut frame: Frame, scale: f64) -> Frame {
    frame.camera = scaled_camera(frame.camera, scale);
    if let Some(depth) = &mut frame.depth {
        depth.depth_view.iter_mut().for_each(|depth| *depth *= scale as f32);
    }
    if let Some(velocity) = &mut frame.velocity {
        velocity.velocity_world.as_flattened_mut().iter_mut().for_each(|speed| *speed *= scale as f32);
    }
    frame
}

fn scaled_camera(mut camera: Camera, scale: f64) -> Camera {
    camera.camera_from_world.translation *= scale;
    camera
}

fn scaled_points(mut points: PointCloud, scale: f64) -> PointCloud {
    points.positions.as_flattened_mut().iter_mut().for_each(|coordinate| *coordinate *= scale as f32);
    points
}

/// The bounds of the capture, world.
fn bounds_world(params: &Params, world: &World, shots: &[Shot]) -> Option<[[f64; 3]; 2]> {
    match params.bounds {
        Bounds::Exact => Some(world.bounds_world.map(|corner| corner.map(|coordinate| params.scale * coordinate))),
        Bounds::Cameras => {
            let training = shots[..params.training_views()].iter();
            let cameras: Vec<Camera> = training.map(|shot| scaled_camera(shot.camera, params.scale)).collect();
            common_view_volume(&cameras).map(|ball| ball.bounds_world())
        }
    }
}

/// The description of the capture without its views.
fn info(params: &Params, world: &World, shots: &[Shot]) -> CaptureInfo {
    let background = match params.background {
        Background::White => "white",
        Background::Black => "black",
        Background::None => "none",
    };
    let camera = match params.camera {
        CameraPath::Hemisphere => "hemisphere",
        CameraPath::Orbit => "orbit",
        CameraPath::Arc => "arc",
        CameraPath::Rig => "rig",
    };
    let (train, val, test) = (params.training_views(), params.val_views, params.test_views);
    CaptureInfo {
        name: params.scene.to_string(),
        pose_source: "analytic".into(),
        protocol: Protocol {
            dataset: "synthetic".into(),
            split: format!("{camera} {train}/{val}/{test}"),
            width: params.width,
            height: params.height,
            resize: "analytic".into(),
            background: background.into(),
            time: "index / (count - 1)".into(),
        },
        background: [params.background.intensity() as f32; 3],
        time_map: TimeMap { start_secs: 0.0, end_secs: params.duration_secs(), frame_secs: 1.0 / params.fps },
        class_names: world.class_names.clone(),
        bounds_world: bounds_world(params, world, shots),
    }
}
