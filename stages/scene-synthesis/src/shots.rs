//! The shots of a capture: cameras and times of all views.

use std::f64::consts::{FRAC_PI_6, PI, TAU};

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Camera, Intrinsics, Split};

use crate::params::{CameraPath, Params};

/// Sine of the highest elevation of a random camera; near the zenith, `up` is undefined.
const MAX_SINE_ELEVATION: f64 = 0.9;
/// Sine of the lowest elevation of a random camera: just above the floor, so that the floor does not hide the scene.
const MIN_SINE_ELEVATION: f64 = 0.1;
/// Mean elevation of all other cameras, in radians.
const ELEVATION: f64 = FRAC_PI_6;
/// Random stream of the cameras, separate from that of the phases of motion.
const CAMERA_STREAM: u64 = 1;

/// One view to render.
#[derive(Clone, Debug)]
pub(crate) struct Shot {
    /// Name of the view.
    pub(crate) name: String,
    /// Purpose of the view.
    pub(crate) split: Split,
    /// Intrinsics and pose.
    pub(crate) camera: Camera,
    /// Number of the camera; held-out cameras come after the training cameras.
    pub(crate) camera_index: u32,
    /// The last frame at or before the time.
    pub(crate) frame_index: u32,
    /// Time in seconds.
    pub(crate) time_secs: f64,
}

/// All shots of a capture, with cameras around the point `center_world`.
pub(crate) fn shots(params: &Params, center_world: DVec3) -> Vec<Shot> {
    let mut shots = training_shots(params);
    shots.extend(held_out_shots(params, Split::Val, params.val_views));
    shots.extend(held_out_shots(params, Split::Test, params.test_views));
    shots.iter_mut().for_each(|shot| shot.camera = centered(shot.camera, center_world));
    shots
}

/// One camera per frame, or every camera of the rig at every frame.
fn training_shots(params: &Params) -> Vec<Shot> {
    let mut random = ChaCha8Rng::seed_from_u64(params.seed);
    random.set_stream(CAMERA_STREAM);
    let shot = |name: String, camera_index: usize, frame: usize, (azimuth, elevation): (f64, f64)| Shot {
        name,
        split: Split::Train,
        camera: camera(params, azimuth, elevation),
        camera_index: camera_index as u32,
        frame_index: frame as u32,
        time_secs: frame as f64 / params.fps,
    };
    let mut shots = Vec::new();
    for frame in 0..params.frames {
        // Shares of an open path and of a closed orbit, which does not repeat its first position.
        let share = frame as f64 / (params.frames - 1).max(1) as f64;
        let turn = TAU * frame as f64 / params.frames as f64;
        let name = format!("train_{frame:04}");
        match params.camera {
            CameraPath::Hemisphere => shots.push(shot(name, 0, frame, random_direction(&mut random))),
            CameraPath::Orbit => shots.push(shot(name, 0, frame, (turn, ELEVATION + 0.2 * (2.0 * turn).sin()))),
            CameraPath::Arc => shots.push(shot(name, 0, frame, arc(params, share))),
            CameraPath::Rig => shots.extend(
                (0..params.rig_cameras)
                    .map(|index| shot(format!("cam{index:02}_{frame:04}"), index, frame, rig(params, index as f64))),
            ),
        }
    }
    shots
}

/// Shots with held-out cameras near the training cameras, at times between training frames (at frames for a rig).
fn held_out_shots(params: &Params, split: Split, count: usize) -> impl Iterator<Item = Shot> {
    let held_out_index = match (params.camera, split) {
        (CameraPath::Rig, Split::Test) => params.rig_cameras + 1,
        (CameraPath::Rig, _) => params.rig_cameras,
        (_, Split::Test) => 2,
        (_, _) => 1,
    };
    let prefix = if split == Split::Test { "test" } else { "val" };
    (0..count).map(move |index| {
        let share = (index as f64 + 0.5) / count as f64;
        let between_secs = share * params.duration_secs();
        // Val and test cameras move in opposite directions, so that they share no pose.
        let way = if split == Split::Test { share } else { 1.0 - share + 0.31 / count as f64 };
        let (azimuth, elevation) = match params.camera {
            CameraPath::Hemisphere | CameraPath::Orbit => (TAU * way, ELEVATION),
            CameraPath::Arc => (arc(params, 1.0 - way).0, ELEVATION + nod(params)),
            CameraPath::Rig => {
                rig(params, (params.rig_cameras / 2) as f64 - if split == Split::Test { 0.5 } else { 0.25 })
            }
        };
        let frame_index = (between_secs * params.fps).floor();
        let time_secs = if params.camera == CameraPath::Rig { frame_index / params.fps } else { between_secs };
        Shot {
            name: format!("{prefix}_{index:04}"),
            split,
            camera: camera(params, azimuth, elevation),
            camera_index: held_out_index as u32,
            frame_index: frame_index as u32,
            time_secs,
        }
    })
}

/// A random azimuth and elevation, uniform on the sphere between the lowest and the highest elevation.
fn random_direction(random: &mut ChaCha8Rng) -> (f64, f64) {
    let azimuth = random.random_range(0.0..TAU);
    (azimuth, random.random_range(MIN_SINE_ELEVATION..MAX_SINE_ELEVATION).asin())
}

/// Azimuth and elevation at a share of the way of an arc: a swing to the right and to the left, in front of the scene.
fn arc(params: &Params, share: f64) -> (f64, f64) {
    let swing = params.swing_degrees.to_radians();
    (-0.5 * PI + swing * (TAU * share).sin(), ELEVATION + nod(params) * (2.0 * TAU * share).cos())
}

/// How far an arc goes upwards and downwards, in radians: 0.1 for a swing of 30°, and in proportion to it. The held-out
/// cameras stay within it, because a narrow arc says nothing about views from far above.
fn nod(params: &Params) -> f64 {
    0.1 * params.swing_degrees.to_radians() / FRAC_PI_6
}

/// Azimuth and elevation of a camera in a rig: a half circle in front of the scene, alternating in height. A fractional
/// `position` lies between two cameras.
fn rig(params: &Params, position: f64) -> (f64, f64) {
    let share = (position + 0.5) / params.rig_cameras as f64;
    (-PI + PI * share, ELEVATION + 0.15 * (PI * position).cos())
}

/// A camera that looks at the origin from the given direction.
fn camera(params: &Params, azimuth: f64, elevation: f64) -> Camera {
    let (width, height) = (f64::from(params.width), f64::from(params.height));
    let focal = 0.5 * width / (0.5 * params.field_of_view_degrees.to_radians()).tan();
    let intrinsics = Intrinsics {
        width: params.width,
        height: params.height,
        focal_x: focal,
        focal_y: focal,
        center_x: 0.5 * width,
        center_y: 0.5 * height,
    };
    let (sin, cos) = elevation.sin_cos();
    let direction = DVec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
    Camera::look_at(intrinsics, params.camera_distance * direction, DVec3::ZERO, DVec3::Z)
}

/// Translates a camera that looks at the origin so that it looks at `center_world`.
fn centered(mut camera: Camera, center_world: DVec3) -> Camera {
    let pose = &mut camera.camera_from_world;
    pose.translation -= pose.rotation * center_world;
    camera
}
