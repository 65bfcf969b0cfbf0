//! The light-field videos of Technicolor (Sabater et al. 2017): sixteen cameras, `cameras_parameters.txt` with a line per
//! camera, and all frames in one folder, `SCENE_undist_FFFFF_CC.png`.
//!
//! After a line of titles, each line has f cu cv ar sk qw qx qy qz tx ty tz. The file of the original, distorted release has
//! d1 d2 after sk. The pose is world-to-camera with OpenCV's axes, as in the loaders of HyperReel and SpacetimeGaussians, which
//! use `f` for both axes and neither `sk` nor `d1`, `d2`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use glam::{DQuat, DVec3};
use scene::{Intrinsics, RigidTransform};

use crate::cloud_file::CloudSource;
use crate::error::{Result, bad};
use crate::files::{self, image_size, read_text};
use crate::lens::Lens;
use crate::matrices::rotation;
use crate::number_lines::lines;
use crate::params::{Format, Params};
use crate::rig::{self, RigCamera, Video, videos};
use crate::source::SourceCapture;

const FILE: &str = "cameras_parameters.txt";
/// Numbers per line of the undistorted release.
const LINE_LENGTH: usize = 12;
/// Numbers per line with the two of the distortion.
const LONG_LINE_LENGTH: usize = 14;
/// The names of the numbers, from the titles.
const COLUMNS: &str = "f cu cv ar sk [d1 d2] qw qx qy qz tx ty tz";
/// The last numbers of a line: the pose.
const POSE_LENGTH: usize = 7;
/// The camera that HyperReel and SpacetimeGaussians hold out, in the second row and third column of the rig.
const HELD_OUT: &str = "10";
/// Largest relative difference of the aspect ratio from 1 that changes no pixel by more than one of 2048.
const ASPECT_TOLERANCE: f64 = 5e-4;

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(FILE).is_file()
}

/// Reads the cameras and the names of the frames; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let path = dir.join(FILE);
    let mut warnings = Vec::new();
    let mut videos = videos(dir)?;
    let stated = cameras(&path, &mut warnings)?;
    videos::select(&mut videos, params, None, &mut warnings).map_err(|failure| failure.at(dir))?;
    let with_camera = |video: Video| -> Result<RigCamera> {
        let stated = video.camera.parse().ok().and_then(|index: usize| stated.get(index));
        let lacks = || bad(format!("there is no line for camera {} of the images", video.camera)).at(&path);
        let stated = stated.ok_or_else(lacks)?;
        let (width, height) = image_size(&video.frames[0])?;
        let intrinsics = Intrinsics { width, height, ..stated.intrinsics };
        rig::check_size(&format!("camera {}", video.camera), &intrinsics).map_err(|failure| failure.at(&path))?;
        let camera_from_world = stated.camera_from_world;
        Ok(RigCamera { video, lens: Lens::pinhole(intrinsics), camera_from_world, masks: Vec::new() })
    };
    let cameras = videos.into_iter().map(with_camera).collect::<Result<Vec<_>>>()?;
    let mut frames = rig::frames(&cameras, &path, params.fps);
    let has_central = cameras.iter().any(|camera| camera.video.camera == HELD_OUT);
    let usual = if has_central { vec![HELD_OUT.to_owned()] } else { Vec::new() };
    let held_out = if params.test_cameras.is_empty() { &usual } else { &params.test_cameras };
    let rule = rig::hold_out(&mut frames, &cameras, held_out, params).map_err(|failure| failure.at(dir))?;
    let rules = vec![rule, format!("{} frames", cameras[0].video.frames.len())];
    let capture = rig::capture(dir, (Format::Technicolor, "technicolor"), frames, rules, params);
    let cloud = Some(CloudSource::Sweep(None));
    Ok(SourceCapture { wants_test: capture.wants_test || has_central, cloud, warnings, ..capture })
}

/// The frames of each camera, by the numbers at the end of their names.
fn videos(dir: &Path) -> Result<Vec<Video>> {
    let mut by_camera: BTreeMap<String, Vec<(u64, PathBuf)>> = BTreeMap::new();
    for path in videos::images(dir) {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut parts = stem.rsplitn(3, '_');
        let (camera, frame) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
        let (Ok(_), Ok(number)) = (camera.parse::<u8>(), frame.parse()) else { continue };
        if !stem.contains("undist") {
            let hint = "use the undistorted images of the release (SCENE_undist_FFFFF_CC.png): loaders in the literature \
                        do, and the files do not say which model d1 and d2 belong to";
            return Err(bad("an image with the distortion of its lens").hint(hint).at(path));
        }
        by_camera.entry(camera.to_owned()).or_default().push((number, path));
    }
    if by_camera.is_empty() {
        let failure = Failure::new(FailureKind::MissingData, format!("no frames next to {FILE}"));
        return Err(failure.hint("frames are named SCENE_undist_00001_00.png: download and unpack them").at(dir));
    }
    by_camera.into_iter().map(|(camera, frames)| Video::numbered(camera, frames)).collect()
}

/// The pose and, apart from the size, the lens of a line.
struct Stated {
    intrinsics: Intrinsics,
    camera_from_world: RigidTransform,
}

/// The lines in order; a first line without numbers has the titles. All others have the length of the first of them.
fn cameras(path: &Path, warnings: &mut Vec<String>) -> Result<Vec<Stated>> {
    let text = read_text(path)?;
    let mut cameras = Vec::new();
    let mut is_long = None;
    for line in lines(&text) {
        let is_title = line.number == 1 && line.words[0].parse::<f64>().is_err();
        if is_title {
            continue;
        }
        let values = match *is_long.get_or_insert(line.words.len() == LONG_LINE_LENGTH) {
            true => line.finite::<LONG_LINE_LENGTH>(COLUMNS).map(Vec::from),
            false => line.finite::<LINE_LENGTH>(COLUMNS).map(Vec::from),
        };
        let values = values.map_err(|failure| failure.at(path))?;
        cameras.push(camera(&values, line.number, path)?);
        let aspect = values[3];
        if warnings.is_empty() && !((aspect - 1.0).abs() <= ASPECT_TOLERANCE) {
            warnings
                .push(format!("the aspect ratio {aspect} in {} is not used, as in the literature", files::name(path)));
        }
    }
    Ok(cameras)
}

fn camera(values: &[f64], line: usize, path: &Path) -> Result<Stated> {
    let pose = &values[values.len() - POSE_LENGTH..];
    let quaternion = DQuat::from_xyzw(pose[1], pose[2], pose[3], pose[0]);
    let rotation = rotation(quaternion, line).map_err(|failure| failure.at(path))?;
    let (focal, center_x, center_y) = (values[0], values[1], values[2]);
    let intrinsics = Intrinsics { width: 0, height: 0, focal_x: focal, focal_y: focal, center_x, center_y };
    let translation = DVec3::new(pose[4], pose[5], pose[6]);
    Ok(Stated { intrinsics, camera_from_world: RigidTransform { rotation, translation } })
}
