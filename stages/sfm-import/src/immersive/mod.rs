//! Google's Immersive Light Field Video (Broxton et al. 2020): a rig of 46 fisheye cameras on a hemisphere that looks
//! outwards. `models.json` has a calibration per camera, and `camera_NNNN.mp4` its video, or the folder `camera_NNNN` its
//! extracted frames.
//!
//! `orientation` is the rotation vector from world to camera with OpenCV's axes, `position` the place of the camera in
//! metres. The angle θ of a ray to the optical axis becomes the radius focal_length · θ (1 + k1 θ² + k2 θ⁴).

use std::collections::BTreeSet;
use std::path::Path;

use engine::{Failure, FailureKind};
use glam::{DMat3, DQuat, DVec3};
use scene::{Intrinsics, RigidTransform};
use serde::Deserialize;

use crate::cloud_file::CloudSource;
use crate::error::{Result, bad};
use crate::files::{children, is_entry, read_text};
use crate::image_names::images_dir;
use crate::lens::{Distortion, Lens};
use crate::params::{Format, Params};
use crate::rig::{self, RigCamera, Video, videos};
use crate::source::SourceCapture;

/// The file of calibrations.
pub(crate) const FILE: &str = "models.json";
/// The camera in the middle of the rig, which HyperReel and SpacetimeGaussians hold out.
const HELD_OUT: &str = "camera_0001";
/// Depths between which points are searched, in metres: the cameras look outwards, so the location of the scene does
/// not follow from their poses. The ranges of HyperReel's loader for single scenes lie within 0.25 m and 50 m.
const DEPTH_RANGE: [f64; 2] = [0.5, 50.0];

/// The calibration of a camera.
#[derive(Deserialize)]
struct Stated {
    name: String,
    position: [f64; 3],
    orientation: [f64; 3],
    focal_length: f64,
    #[serde(default = "square")]
    pixel_aspect_ratio: f64,
    principal_point: [f64; 2],
    width: f64,
    height: f64,
    radial_distortion: [f64; 3],
    projection_type: String,
}

/// The aspect ratio of pixels where none is stated.
fn square() -> f64 {
    1.0
}

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(FILE).is_file()
}

/// Reads the calibrations and the names of the frames; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let path = dir.join(FILE);
    let mut warnings = Vec::new();
    let stated = calibrations(&path)?;
    let (present, mut videos) = videos_of(dir, &stated, &mut warnings)?;
    videos::check_rates(&videos, params.fps, &mut warnings);
    videos::select(&mut videos, params, None, &mut warnings).map_err(|failure| match failure.path {
        None => failure.at(dir),
        Some(_) => failure,
    })?;
    let cameras = present.iter().zip(videos).map(|(stated, video)| stated.camera(video)).collect::<Result<Vec<_>>>();
    let cameras = cameras.map_err(|failure| failure.at(&path))?;
    let mut frames = rig::frames(&cameras, &path, params.fps);
    let has_usual = cameras.iter().any(|camera| camera.video.camera == HELD_OUT);
    let usual = if has_usual { vec![HELD_OUT.to_owned()] } else { Vec::new() };
    let held_out = if params.test_cameras.is_empty() { &usual } else { &params.test_cameras };
    let rule = rig::hold_out(&mut frames, &cameras, held_out, params).map_err(|failure| failure.at(dir))?;
    let rules = vec![rule, format!("{} frames", cameras[0].video.frames.len())];
    let capture = rig::capture(dir, (Format::Immersive, "immersive"), frames, rules, params);
    let cloud = Some(CloudSource::Sweep(Some(DEPTH_RANGE)));
    Ok(SourceCapture { wants_test: capture.wants_test || has_usual, cloud, warnings, ..capture })
}

/// The calibrations in their order; their names are distinct.
fn calibrations(path: &Path) -> Result<Vec<Stated>> {
    let not_valid = |error| bad(format!("not a calibration of Immersive Light Field Video ({error})")).at(path);
    let stated: Vec<Stated> = serde_json::from_str(&read_text(path)?).map_err(not_valid)?;
    let mut names = BTreeSet::new();
    match stated.iter().find(|camera| !names.insert(&camera.name)) {
        Some(twice) => Err(bad(format!("{} has two calibrations", twice.name)).at(path)),
        None => Ok(stated),
    }
}

/// The calibrated cameras with frames, and these. Videos belong to calibrations by name, because most scenes have a video
/// without a calibration.
fn videos_of<'a>(
    dir: &Path,
    stated: &'a [Stated],
    warnings: &mut Vec<String>,
) -> Result<(Vec<&'a Stated>, Vec<Video>)> {
    let has_frames = |camera: &&Stated| {
        is_entry(&camera.name)
            && (dir.join(&camera.name).is_dir() || dir.join(format!("{}.mp4", camera.name)).is_file())
    };
    let (present, missing): (Vec<&Stated>, Vec<&Stated>) = stated.iter().partition(has_frames);
    if present.is_empty() {
        let message = format!("none of the {} cameras of {FILE} has frames", stated.len());
        let hint = "download the videos camera_NNNN.mp4, or extract their frames into camera_NNNN/0000.png, …";
        return Err(Failure::new(FailureKind::MissingData, message).hint(hint).at(dir));
    }
    if let Some(first) = missing.first() {
        warnings.push(format!("{} of {} cameras have no frames, e.g. {}", missing.len(), stated.len(), first.name));
    }
    let is_uncalibrated = |entry: &String| {
        let name = entry.strip_suffix(".mp4").unwrap_or(entry);
        name.starts_with("camera_") && stated.iter().all(|camera| camera.name != name)
    };
    let uncalibrated: Vec<String> = children(dir).into_iter().filter(is_uncalibrated).collect();
    if !uncalibrated.is_empty() {
        warnings.push(format!("{FILE} has no calibration for {}", uncalibrated.join(", ")));
    }
    let video = |camera: &&Stated| {
        let (folder, file) = (dir.join(&camera.name), dir.join(format!("{}.mp4", camera.name)));
        Video::in_folder_or_file(camera.name.clone(), &images_dir(&folder), &file)
    };
    let videos = present.iter().map(video).collect::<Result<Vec<_>>>()?;
    match videos.iter().find(|video| video.frames.is_empty()) {
        Some(empty) => {
            let failure = Failure::new(FailureKind::MissingData, format!("{} has no frames", empty.camera));
            Err(failure.hint("extract its frames again, or remove the folder").at(dir.join(&empty.camera)))
        }
        None => Ok((present, videos)),
    }
}

impl Stated {
    /// The camera with the frames of its video.
    fn camera(&self, video: Video) -> Result<RigCamera> {
        if self.projection_type != "fisheye" || self.pixel_aspect_ratio != 1.0 {
            let message = format!(
                "{} has the projection {:?} with the pixel aspect ratio {}; only fisheyes with square pixels are supported",
                self.name, self.projection_type, self.pixel_aspect_ratio
            );
            return Err(bad(message));
        }
        let side = |stated: f64| {
            (stated >= 1.0 && stated <= f64::from(u16::MAX) && stated.fract() == 0.0).then_some(stated as u32)
        };
        let (Some(width), Some(height)) = (side(self.width), side(self.height)) else {
            return Err(bad(format!("{} has images of {}×{} pixels", self.name, self.width, self.height)));
        };
        let ([center_x, center_y], [k1, k2, k3]) = (self.principal_point, self.radial_distortion);
        let focal = self.focal_length;
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from(self.orientation)));
        Ok(RigCamera {
            video,
            lens: Lens {
                intrinsics: Intrinsics { width, height, focal_x: focal, focal_y: focal, center_x, center_y },
                distortion: Distortion::fisheye([k1, k2, k3, 0.0]),
            },
            camera_from_world: RigidTransform { rotation, translation: -(rotation * DVec3::from(self.position)) },
            masks: Vec::new(),
        })
    }
}
