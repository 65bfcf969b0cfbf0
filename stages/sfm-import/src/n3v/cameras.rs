//! The videos of a rig's cameras, or the folders of their frames.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::error::Result;
use crate::files::children;
use crate::image_names::images_dir;
use crate::rig::Video;
use crate::rig::videos::images;

/// The sorted names of the cameras in `dir`: folders `camNN` and videos `camNN.mp4`.
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

/// Lists the frames of all cameras: images, or else those of a video.
pub(super) fn read(dir: &Path) -> Result<Vec<Video>> {
    let names = camera_names(dir);
    check_complete(dir, &names)?;
    let video = |camera: String| {
        let (folder, file) = (images_dir(&dir.join(&camera)), file(dir, &camera));
        Video::in_folder_or_file(camera, &folder, &file)
    };
    names.into_iter().map(video).collect()
}

/// Refuses cameras without frames; the error lists all of them.
fn check_complete(dir: &Path, names: &[String]) -> Result<()> {
    let is_empty = |name: &&String| frames(dir, name).is_empty() && !file(dir, name).is_file();
    let missing: Vec<&str> = names.iter().filter(is_empty).map(String::as_str).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let failure = Failure::new(FailureKind::MissingData, format!("no frames of {}", missing.join(", ")));
    Err(failure.hint("download the videos camNN.mp4, or extract their frames into camNN/images").at(dir))
}

/// The images of one camera: those in its folder `images`, or directly in the camera's folder.
fn frames(dir: &Path, camera: &str) -> Vec<PathBuf> {
    images(&images_dir(&dir.join(camera)))
}

fn file(dir: &Path, camera: &str) -> PathBuf {
    dir.join(format!("{camera}.mp4"))
}
