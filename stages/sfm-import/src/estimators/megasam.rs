//! MegaSaM (Li et al. 2025): `SCENE_sgd_cvd_hr.npz` with consistent video depth, or `SCENE_droid.npz` with the depth of
//! the tracking alone. Both contain the images to which the poses belong: resized and cropped by MegaSaM.

use std::path::{Path, PathBuf};

use scene::Camera;

use super::{Clip, Images, array, shape, wrong_shape};
use crate::error::{Result, bad};
use crate::files::children;
use crate::matrices::{pinhole, straightened, transform};
use crate::params::{Format, Params};
use crate::source::SourceCapture;
use crate::video_maps::VideoMaps;

/// Ends of the file names, the better depth first.
const ENDS: [&str; 2] = ["_sgd_cvd_hr.npz", "_droid.npz"];
/// The depth at which MegaSaM clips distant surfaces.
const CLIPPED: f32 = 99.9;

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    ENDS.iter().any(|end| !archives(dir, end).is_empty())
}

fn archives(dir: &Path, end: &str) -> Vec<PathBuf> {
    children(dir).into_iter().filter(|name| name.ends_with(end)).map(|name| dir.join(name)).collect()
}

/// Reads poses and intrinsics; decodes no map.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let found = ENDS.iter().map(|end| archives(dir, end)).find(|found| !found.is_empty()).unwrap_or_default();
    let [path] = found.as_slice() else {
        let hint = "put each scene into a separate folder";
        return Err(bad(format!("{} scenes of MegaSaM in one folder", found.len())).hint(hint).at(dir));
    };
    let depth = shape(path, "depths")?;
    let [count, height, width] = *depth else {
        return Err(wrong_shape("depths", &depth, "[frames, H, W]", path));
    };
    let expected = [
        ("images", shape(path, "images")?, vec![count, height, width, 3]),
        ("cam_c2w", shape(path, "cam_c2w")?, vec![count, 4, 4]),
        ("intrinsic", shape(path, "intrinsic")?, vec![3, 3]),
    ];
    if let Some((name, found, expected)) = expected.iter().find(|(_, found, expected)| found != expected) {
        return Err(wrong_shape(name, found, &format!("{expected:?}"), path));
    }
    let intrinsics = pinhole(&array(path, "intrinsic")?.values, (width as u32, height as u32));
    let poses = array(path, "cam_c2w")?;
    let camera = |pose: &[f64]| Camera { intrinsics, camera_from_world: straightened(transform(pose)).inverse() };
    let clip = Clip {
        format: Format::MegaSam,
        stated_in: path.clone(),
        cameras: poses.values.chunks_exact(16).map(camera).collect(),
        images: Images::Array { images: VideoMaps::member(path.clone(), "images", 3), white: 255.0 },
        depth: VideoMaps::member(path.clone(), "depths", 1),
        confidence: None,
        window: None,
        no_depth_from: CLIPPED,
        masks: Vec::new(),
        warnings: Vec::new(),
    };
    Ok(clip.capture(dir, params))
}
