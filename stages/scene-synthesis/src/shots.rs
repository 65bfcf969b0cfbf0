//! Which camera looks when: the capture protocol.

use std::f64::consts::{FRAC_PI_6, PI, TAU};

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Camera, Intrinsics, Split};

use crate::params::{CameraPath, Params};

/// Of all cameras from the centre, scene units (as D-NeRF).
const DISTANCE: f64 = 4.0;
/// Steepest random camera: above it, `up` loses its meaning.
const MAX_SINE_ELEVATION: f64 = 0.9;
/// Lowest random camera: just above the floor, so that it does not hide everything.
const MIN_SINE_ELEVATION: f64 = 0.1;
/// Elevation of cameras that go round.
const ELEVATION: f64 = FRAC_PI_6;
/// How far an arc swings to either side.
const ARC_HALF: f64 = FRAC_PI_6;
/// Separates the random cameras from the random phases of the same seed.
const CAMERA_STREAM: u64 = 1;

/// One image to take.
#[derive(Clone, Debug)]
pub struct Shot {
    /// The view's name.
    pub name: String,
    /// What it may be used for.
    pub split: Split,
    /// Pinhole and pose.
    pub camera: Camera,
    /// Which camera of a rig; held-out cameras come after the training cameras.
    pub camera_index: u32,
    /// The nearest frame at or before the time.
    pub frame_index: u32,
    /// When.
    pub time_secs: f64,
}

/// All images of the capture, with cameras about the point `center_world`.
pub fn shots(params: &Params, center_world: DVec3) -> Vec<Shot> {
    let mut shots = training_shots(params);
    shots.extend(held_out_shots(params, Split::Val, params.val_views));
    shots.extend(held_out_shots(params, Split::Test, params.test_views));
    shots.iter_mut().for_each(|shot| shot.camera = centred(shot.camera, center_world));
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
        // Share of the way; a closed orbit does not see its first position twice.
        let share = frame as f64 / (params.frames - 1).max(1) as f64;
        let turn = TAU * frame as f64 / params.frames as f64;
        let name = format!("train_{frame:04}");
        match params.camera {
            CameraPath::Hemisphere => shots.push(shot(name, 0, frame, random_direction(&mut random))),
            CameraPath::Orbit => shots.push(shot(name, 0, frame, (turn, ELEVATION + 0.2 * (2.0 * turn).sin()))),
            CameraPath::Arc => shots.push(shot(name, 0, frame, arc(share))),
            CameraPath::Rig => shots.extend(
                (0..params.rig_cameras)
                    .map(|index| shot(format!("cam{index:02}_{frame:04}"), index, frame, rig(params, index as f64))),
            ),
        }
    }
    shots
}

/// Cameras that training does not have, near those that it has, at times between its frames (at frames for a rig).
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
        // Val and test walk in opposite directions, so that they share no camera.
        let way = if split == Split::Test { share } else { 1.0 - share + 0.31 / count as f64 };
        let (azimuth, elevation) = match params.camera {
            CameraPath::Hemisphere | CameraPath::Orbit => (TAU * way, ELEVATION),
            CameraPath::Arc => (arc(1.0 - way).0, ELEVATION + 0.1),
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

/// Uniform over the sphere between the lowest and the highest elevation.
fn random_direction(random: &mut ChaCha8Rng) -> (f64, f64) {
    let azimuth = random.random_range(0.0..TAU);
    (azimuth, random.random_range(MIN_SINE_ELEVATION..MAX_SINE_ELEVATION).asin())
}

/// A swing to the right and back to the left, in front of the scene.
fn arc(share: f64) -> (f64, f64) {
    (-0.5 * PI + ARC_HALF * (TAU * share).sin(), ELEVATION + 0.1 * (2.0 * TAU * share).cos())
}

/// Camera `position` (which may lie between two) of a half circle in front of the scene, alternating in height.
fn rig(params: &Params, position: f64) -> (f64, f64) {
    let share = (position + 0.5) / params.rig_cameras as f64;
    (-PI + PI * share, ELEVATION + 0.15 * (PI * position).cos())
}

/// A camera in the given direction from the origin, looking at it.
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
    Camera::look_at(intrinsics, DISTANCE * direction, DVec3::ZERO, DVec3::Z)
}

/// The camera, moved with the origin that it looks at to `center_world`.
fn centred(mut camera: Camera, center_world: DVec3) -> Camera {
    let pose = &mut camera.camera_from_world;
    pose.translation -= pose.rotation * center_world;
    camera
}
