//! MonST3R (Zhang et al. 2025), which aligns the pointmaps of DUSt3R (Wang et al. 2024) over a video: `pred_traj.txt`,
//! `pred_intrinsics.txt` and, per frame, `frame_0000.png`, `frame_0000.npy` (depth), `conf_0.npy` and `dynamic_mask_0.png`.
//!
//! A line of the trajectory is an index, the position and the quaternion (w, x, y, z), from camera to world: unlike the files of
//! TUM, whose quaternions end with w.

use std::path::Path;

use engine::{Failure, FailureKind};
use glam::{DQuat, DVec3};
use scene::{Camera, RigidTransform};

use super::{Clip, Images};
use crate::error::{Result, bad};
use crate::files::{image_size, read_text};
use crate::matrices::pinhole;
use crate::number_lines::lines;
use crate::params::{Format, Params};
use crate::source::SourceCapture;
use crate::video_maps::VideoMaps;

/// Poses, one per line.
const POSES: &str = "pred_traj.txt";
/// Rows of the matrices of intrinsics, one per line.
const INTRINSICS: &str = "pred_intrinsics.txt";

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    [POSES, INTRINSICS].iter().all(|name| dir.join(name).is_file()) && dir.join("frame_0000.npy").is_file()
}

/// Reads poses and intrinsics; decodes no map.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let stated_in = dir.join(POSES);
    let (poses, intrinsics) = (numbers::<8>(&stated_in)?, numbers::<9>(&dir.join(INTRINSICS))?);
    let count = poses.len();
    if intrinsics.len() != count {
        return Err(
            bad(format!("{count} poses, but {} lines of intrinsics", intrinsics.len())).at(dir.join(INTRINSICS))
        );
    }
    let files = |name: &dyn Fn(usize) -> String| (0..count).map(|at| dir.join(name(at))).collect::<Vec<_>>();
    let images = files(&|at| format!("frame_{at:04}.png"));
    let depths = files(&|at| format!("frame_{at:04}.npy"));
    if let Some(missing) = images.iter().chain(&depths).find(|path| !path.is_file()) {
        let failure = Failure::new(FailureKind::MissingData, format!("{count} poses, but this file is missing"));
        return Err(failure.hint("name the whole output folder of MonST3R").at(missing));
    }
    let size = image_size(images.first().ok_or_else(|| bad("there are no poses").at(&stated_in))?)?;
    let confidence = files(&|at| format!("conf_{at}.npy"));
    let has_confidence = confidence.iter().all(|path| path.is_file());
    let masks = files(&|at| format!("dynamic_mask_{at}.png"));
    let camera = |(pose, rows): (&[f64; 8], &[f64; 9])| {
        let [_, x, y, z, qw, qx, qy, qz] = *pose;
        let rotation = glam::DMat3::from_quat(DQuat::from_xyzw(qx, qy, qz, qw).normalize());
        let world_from_camera = RigidTransform { rotation, translation: DVec3::new(x, y, z) };
        Camera { intrinsics: pinhole(rows, size), camera_from_world: world_from_camera.inverse() }
    };
    let clip = Clip {
        format: Format::Monst3r,
        stated_in,
        cameras: poses.iter().zip(&intrinsics).map(camera).collect(),
        images: Images::Files(images),
        depth: VideoMaps::files(depths),
        confidence: has_confidence.then(|| VideoMaps::files(confidence)),
        window: None,
        no_depth_from: f32::INFINITY,
        masks: masks.into_iter().map(|path| path.is_file().then_some(path)).collect(),
        warnings: Vec::new(),
    };
    Ok(clip.capture(dir, params))
}

/// The numbers of a text file, N per line.
fn numbers<const N: usize>(path: &Path) -> Result<Vec<[f64; N]>> {
    let text = read_text(path)?;
    let numbers = lines(&text).map(|line| line.finite(""));
    numbers.collect::<Result<_>>().map_err(|failure| failure.at(path))
}
