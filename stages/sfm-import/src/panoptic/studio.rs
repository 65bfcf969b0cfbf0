//! The layout of the Panoptic Studio's toolbox: `calibration_SEQUENCE.json` with the cameras of the dome, and the frames of
//! its high-definition cameras in `hdImgs/00_CC/00_CC_FFFFFFFF.jpg` or `hdVideos/hd_00_CC.mp4`.
//!
//! Poses are world-to-camera with OpenCV's axes, in centimetres, which become metres here. Distortion is OpenCV's.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use glam::{DMat3, DVec3};
use scene::{Intrinsics, RigidTransform};
use serde::Deserialize;

use super::DATA_SET;
use crate::cloud_file::CloudSource;
use crate::error::{Result, bad};
use crate::files::{children, read_text};
use crate::lens::{Distortion, Lens};
use crate::params::{Format, Params};
use crate::rig::{self, RigCamera, Video, videos};
use crate::source::SourceCapture;

/// Metres per unit of the file.
const METRES: f64 = 0.01;
/// The folder of extracted frames.
const FRAMES: &str = "hdImgs";
/// The folder of videos.
const VIDEOS: &str = "hdVideos";

#[derive(Deserialize)]
struct Calibration {
    cameras: Vec<Stated>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Stated {
    name: String,
    #[serde(rename = "type")]
    kind: String,
    resolution: [u32; 2],
    #[serde(rename = "K")]
    matrix: [[f64; 3]; 3],
    dist_coef: [f64; 5],
    #[serde(rename = "R")]
    rotation: [[f64; 3]; 3],
    t: [[f64; 1]; 3],
}

/// The calibration file of a capture with frames.
pub(super) fn calibration(dir: &Path) -> Option<PathBuf> {
    let is_calibration = |name: &String| name.starts_with("calibration") && name.ends_with(".json");
    let name = children(dir).into_iter().find(is_calibration)?;
    [FRAMES, VIDEOS].iter().any(|folder| dir.join(folder).is_dir()).then(|| dir.join(name))
}

pub(super) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let path = calibration(dir).ok_or_else(|| bad("there is no calibration_*.json").at(dir))?;
    let not_valid = |error| bad(format!("not a calibration of the Panoptic Studio ({error})")).at(&path);
    let stated: Calibration = serde_json::from_str(&read_text(&path)?).map_err(not_valid)?;
    let mut warnings = Vec::new();
    let has_frames = |camera: &&Stated| {
        let [folder, file] = camera.places(dir);
        camera.kind == "hd" && (folder.is_dir() || file.is_file())
    };
    let high: Vec<&Stated> = stated.cameras.iter().filter(|camera| camera.kind == "hd").collect();
    let present: Vec<&Stated> = high.iter().copied().filter(has_frames).collect();
    if present.is_empty() {
        let message =
            format!("neither {FRAMES} nor {VIDEOS} has any of the {} hd cameras of the calibration", high.len());
        let hint = "download the videos with getData.sh of panoptic-toolbox (hdVideos/hd_00_00.mp4), or extract frames \
                    with its hdImgsExtractor.sh (hdImgs/00_00/00_00_00000000.jpg)";
        return Err(Failure::new(FailureKind::MissingData, message).hint(hint).at(dir));
    }
    if present.len() < high.len() {
        warnings.push(format!("{} of {} hd cameras have frames", present.len(), high.len()));
    }
    let video = |camera: &&Stated| {
        let [folder, file] = camera.places(dir);
        Video::in_folder_or_file(camera.name.clone(), &folder, &file)
    };
    let mut videos = present.iter().map(video).collect::<Result<Vec<_>>>()?;
    videos::check_rates(&videos, params.fps, &mut warnings);
    videos::select(&mut videos, params, None, &mut warnings).map_err(|failure| failure.at(dir))?;
    let cameras: Vec<RigCamera> = present.iter().zip(videos).map(|(stated, video)| stated.camera(video)).collect();
    let mut frames = rig::frames(&cameras, &path, params.fps);
    let rule =
        rig::hold_out(&mut frames, &cameras, &params.test_cameras, params).map_err(|failure| failure.at(&path))?;
    let rules = std::iter::once(rule).chain(frame_rule(params)).collect();
    let capture = rig::capture(dir, (Format::Panoptic, DATA_SET), frames, rules, params);
    Ok(SourceCapture { cloud: Some(CloudSource::Sweep(None)), warnings, ..capture })
}

/// The frames of a clip that the parameters choose. Clips differ in length, and all whole clips have one protocol.
fn frame_rule(params: &Params) -> Option<String> {
    let first = params.first_frame.map(|first| format!(" from {first} on")).unwrap_or_default();
    match params.frame_count {
        Some(count) => Some(format!("{count} frames{first}")),
        None => params.first_frame.map(|_| format!("frames{first}")),
    }
}

impl Stated {
    /// The folder of its frames, and its video.
    fn places(&self, dir: &Path) -> [PathBuf; 2] {
        [dir.join(FRAMES).join(&self.name), dir.join(VIDEOS).join(format!("hd_{}.mp4", self.name))]
    }

    fn camera(&self, video: Video) -> RigCamera {
        let [[focal_x, _, center_x], [_, focal_y, center_y], _] = self.matrix;
        let [width, height] = self.resolution;
        let [k1, k2, p1, p2, k3] = self.dist_coef;
        let translation = METRES * DVec3::new(self.t[0][0], self.t[1][0], self.t[2][0]);
        RigCamera {
            video,
            lens: Lens {
                intrinsics: Intrinsics { width, height, focal_x, focal_y, center_x, center_y },
                distortion: Distortion::brown([k1, k2, k3, 0.0], [p1, p2]),
            },
            camera_from_world: RigidTransform {
                rotation: DMat3::from_cols_array_2d(&self.rotation).transpose(),
                translation,
            },
            masks: Vec::new(),
        }
    }
}
