//! Whether images are views of one instant, although their names can be read as frames of a video.

use glam::DVec3;
use scene::statistics::median;

use super::places::after_camera;
use crate::source::Frame;

/// Angle between the axes of successive views above which they are not frames of a video: at two frames per second, a
/// camera that walks around its subject in a minute turns by 3° per frame, and features are hardly matched beyond 30°.
const PHOTOS_DEGREES: f64 = 15.0;
/// Numbers of cameras have at most three digits; `cam_0001` is a frame.
const CAMERA_DIGITS: usize = 3;
/// Rigs with such names have fewer cameras (Google's light-field videos: 46); more images with such names are a video.
const MOST_CAMERAS: usize = 100;

/// Why `frames`, which are in the order of their names, are probably views of one instant; `None` if they are probably a video,
/// or a rig with several instants.
pub(crate) fn reason(frames: &[Frame]) -> Option<String> {
    if frames.len() < 2 || frames.iter().any(|frame| frame.camera_index != frames[0].camera_index) {
        return None;
    }
    if frames.len() <= MOST_CAMERAS && frames.iter().all(|frame| is_camera(&frame.name)) {
        return Some(format!("images are named like cameras, e.g. {}", frames[0].name));
    }
    let degrees = median_turn_degrees(frames)?;
    (degrees > PHOTOS_DEGREES).then(|| format!("successive images are turned by {degrees:.0}°, more than in a video"))
}

fn is_camera(name: &str) -> bool {
    let digits = name.chars().rev().take_while(char::is_ascii_digit).count();
    digits <= CAMERA_DIGITS && after_camera(name) == Some("")
}

/// The median angle between the optical axes of successive frames.
fn median_turn_degrees(frames: &[Frame]) -> Option<f64> {
    let axis = |frame: &Frame| frame.camera_from_world.rotation.transpose() * DVec3::Z;
    let turns = frames.windows(2).map(|pair| axis(&pair[0]).angle_between(axis(&pair[1])));
    median(turns).map(f64::to_degrees)
}
