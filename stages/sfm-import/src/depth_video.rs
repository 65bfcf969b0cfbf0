//! Videos of one moving camera with a depth sensor, in metres: what [`tum`](crate::tum) and [`scannet`](crate::scannet)
//! share.

use std::path::{Path, PathBuf};

use scene::{Intrinsics, RigidTransform, Split};

use crate::cloud_file::CloudSource;
use crate::files;
use crate::image_names::view_name;
use crate::lens::Lens;
use crate::params::{Format, Params};
use crate::source::{Frame, SourceCapture};
use crate::transforms::time_map;
use crate::{rig, split};

/// Where the centre of the first pixel is, which calibrations of OpenCV place at 0.
const FIRST_PIXEL: f64 = 0.5;

/// The pinhole of a calibration of OpenCV.
pub(crate) fn from_opencv(stated: Intrinsics) -> Intrinsics {
    Intrinsics { center_x: stated.center_x + FIRST_PIXEL, center_y: stated.center_y + FIRST_PIXEL, ..stated }
}

/// A training frame of the camera, without depth; `frame_index` counts from the first image of the video.
pub(crate) fn frame(
    image: PathBuf,
    lens: Lens,
    world_from_camera: &RigidTransform,
    (frame_index, time_secs): (u32, f64),
    stated_in: &Path,
) -> Frame {
    Frame {
        name: view_name(&files::name(&image)),
        split: Split::Train,
        image,
        stored_image: None,
        mask: None,
        depth: None,
        lens,
        camera_from_world: world_from_camera.inverse(),
        camera_index: 0,
        frame_index,
        time_secs,
        stated_in: stated_in.to_owned(),
    }
}

/// The capture of these frames, which are in the order of time. Depth of the training frames gives the points.
pub(crate) fn capture(
    dir: &Path,
    (format, dataset): (Format, &'static str),
    mut frames: Vec<Frame>,
    warnings: Vec<String>,
    params: &Params,
) -> SourceCapture {
    let rule = split::hold_out(&mut frames, params.is_static(), params);
    let times = time_map(&frames, false);
    let capture = SourceCapture { warnings, ..rig::capture(dir, (format, dataset), frames, vec![rule], params) };
    let has_depth = capture.frames.iter().any(|frame| frame.split == Split::Train && frame.depth.is_some());
    let cloud = has_depth.then_some(CloudSource::Depth);
    if capture.is_one_instant() {
        return SourceCapture { cloud, ..capture };
    }
    let time_rule = "(file time - min) / (max - min)".into();
    SourceCapture { cloud, time_map: times, time_rule, ..capture }
}

/// The notice of images that are skipped for lack of a pose.
pub(crate) fn skipped_notice(skipped: &[String], total: usize, reason: &str) -> Option<String> {
    let first = skipped.first()?;
    Some(format!("{} of {total} images are skipped: {reason} (e.g. {first})", skipped.len()))
}
