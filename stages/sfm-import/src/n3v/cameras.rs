//! The folders of a rig's cameras.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::error::Result;
use crate::files::children;
use crate::image_names::images_dir;
use crate::rig::Video;
use crate::rig::videos::images;

/// The command that extracts frames from videos, to be run in the capture's folder; this stage does not decode videos.
pub(crate) const EXTRACT: &str = "for v in cam*.mp4; do mkdir -p \"${v%.mp4}/images\"; \
                       ffmpeg -i \"$v\" -frames:v 300 -start_number 0 \"${v%.mp4}/images/%04d.png\"; done";

/// The sorted names of the cameras in `dir`: folders `camNN` and videos `camNN.mp4`, whose frames may be missing.
pub(crate) fn camera_names(dir: &Path) -> Vec<String> {
    let camera = |entry: String| {
        let name = entry.strip_suffix(".mp4").unwrap_or(&entry);
        let digits = name.strip_prefix("cam")?;
        let is_camera = digits.len() == 2 && digits.bytes().all(|digit| digit.is_ascii_digit());
        (is_camera && (name != entry || dir.join(name).is_dir())).then(|| name.to_owned())
    };
    let mut names: Vec<String> = children(dir).into_iter().filter_map(camera).collect();
    names.sort(); // `cam00.mp4` and `cam00` need not be neighbours
    names.dedup();
    names
}

/// Lists the frames of all cameras.
pub(super) fn read(dir: &Path) -> Result<Vec<Video>> {
    let names = camera_names(dir);
    check_extracted(dir, &names)?;
    names.into_iter().map(|camera| Video::new(camera.clone(), frames(dir, &camera))).collect()
}

/// Refuses cameras without frames; the error lists all of them.
fn check_extracted(dir: &Path, names: &[String]) -> Result<()> {
    let empty = |name: &&String| frames(dir, name).is_empty();
    let missing: Vec<&str> = names.iter().filter(empty).map(String::as_str).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let message = format!("no frames of {}: videos are not decoded, only their extracted images", missing.join(", "));
    let failure = Failure::new(FailureKind::MissingData, message);
    Err(failure.hint(format!("extract them; run in that folder: {EXTRACT}")).at(dir))
}

/// The images of one camera: those in its folder `images`, or directly in the camera's folder.
fn frames(dir: &Path, camera: &str) -> Vec<PathBuf> {
    images(&images_dir(&dir.join(camera)))
}
