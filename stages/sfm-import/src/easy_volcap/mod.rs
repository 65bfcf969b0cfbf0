//! The layout of EasyMocap and EasyVolcap (Xu et al. 2023), which ENeRF-Outdoor (Lin et al. 2022) and MobileStage (Xu et
//! al. 2024) have: `intri.yml` and `extri.yml` with the cameras of a rig, frames in `images/CAMERA/FRAME.jpg` or
//! `videos/CAMERA.mp4`.
//!
//! Poses are world-to-camera with OpenCV's axes, in metres; distortion is OpenCV's.

mod calibration;
mod file_storage;

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use self::calibration::Calibrated;
use crate::error::{Result, bad};
use crate::files::{children, is_entry};
use crate::params::{Format, Params};
use crate::rig::{self, RigCamera, Video, videos};
use crate::source::SourceCapture;

/// Folders of foreground masks, by the matting method that EasyVolcap names them after; the first one is read.
const MASKS: [&str; 4] = ["masks", "mask", "bgmtv2", "rvm"];
/// Point clouds of the first frame, in world coordinates.
const CLOUDS: [&str; 3] = ["points3D.ply", "vhull/000000.ply", "background.ply"];

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    let has_frames = ["images", "videos"].iter().any(|name| dir.join(name).is_dir());
    has_frames && ["intri.yml", "extri.yml"].iter().all(|name| dir.join(name).is_file())
}

/// Reads the calibration and the names of the frames; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let folder = params.calibration.as_ref().map_or(dir.to_owned(), |folder| dir.join(folder));
    let (calibrated, mut warnings) = calibration::read(&folder)?;
    if params.calibration.is_none() && dir.join("optimized/extri.yml").is_file() {
        warnings.push(
            "optimized/ has refined cameras, which 4K4D uses: to read them, set calibration = \"optimized\"".into(),
        );
    }
    let mut videos = calibrated.iter().map(|camera| video(dir, &camera.name)).collect::<Result<Vec<_>>>()?;
    videos::check_rates(&videos, params.fps, &mut warnings);
    videos::select(&mut videos, params, None, &mut warnings).map_err(|failure| match failure.path {
        None => failure.at(dir),
        Some(_) => failure,
    })?;
    let masks = MASKS.iter().map(|name| dir.join(name)).find(|folder| folder.is_dir());
    let with = |(camera, video): (&Calibrated, Video)| rig_camera(camera, video, masks.as_deref());
    let cameras = calibrated.iter().zip(videos).map(with).collect::<Result<Vec<_>>>()?;
    let mut frames = rig::frames(&cameras, &folder.join("extri.yml"), params.fps);
    let rule = rig::hold_out(&mut frames, &cameras, &params.test_cameras, params).map_err(|failure| failure.at(dir))?;
    let rules = vec![rule, format!("{} frames", cameras[0].video.frames.len())];
    let capture = rig::capture(dir, (Format::EasyVolcap, data_set(dir)), frames, rules, params);
    let cloud = rig::cloud(CLOUDS.map(|name| dir.join(name)));
    Ok(SourceCapture { cloud: Some(cloud), warnings, ..capture })
}

/// The benchmark, by the names of its scenes.
fn data_set(dir: &Path) -> &'static str {
    match crate::files::name(dir) {
        name if name.starts_with("actor") => "enerf-outdoor",
        name if name.starts_with("dance") => "mobilestage",
        _ => "easyvolcap",
    }
}

fn video(dir: &Path, camera: &str) -> Result<Video> {
    let images = dir.join("images");
    let folder = images.join(camera);
    let file = dir.join(format!("videos/{camera}.mp4"));
    if !is_entry(camera) || !(folder.is_dir() || file.is_file()) {
        let found = [children(&images), children(&dir.join("videos"))].concat();
        let message = format!("camera {camera} of intri.yml has no frames (found {})", found.join(", "));
        let hint = "frames belong in images/CAMERA/000000.jpg or videos/CAMERA.mp4, with the names of intri.yml";
        return Err(Failure::new(FailureKind::MissingData, message).hint(hint).at(dir));
    }
    let video = Video::in_folder_or_file(camera.into(), &folder, &file)?;
    if video.frames.is_empty() {
        return Err(Failure::new(FailureKind::MissingData, format!("camera {camera} has no frames")).at(folder));
    }
    Ok(video)
}

fn rig_camera(camera: &Calibrated, video: Video, masks: Option<&Path>) -> Result<RigCamera> {
    let size = match camera.size {
        Some(size) => size,
        None => video.size()?,
    };
    let mask = |image: &PathBuf| {
        let file = masks?.join(&camera.name).join(image.file_name()?);
        ["png", "jpg"].iter().map(|extension| file.with_extension(extension)).find(|path| path.is_file())
    };
    let masks = video.frames.iter().map(mask).collect();
    let lens = camera.lens(size);
    if !(lens.intrinsics.focal_x > 0.0 && lens.intrinsics.focal_y > 0.0) {
        return Err(bad(format!("K_{} has no positive focal length", camera.name)));
    }
    rig::check_size(&format!("camera {}", camera.name), &lens.intrinsics)?;
    Ok(RigCamera { video, lens, camera_from_world: camera.camera_from_world, masks })
}
