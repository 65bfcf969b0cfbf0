//! The videos of a rig's cameras, or the folders of their frames.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::error::Result;
use crate::files::children;
use crate::image_names::images_dir;
use crate::n3v::HELD_OUT;
use crate::rig::Video;
use crate::rig::videos::images;

/// Extensions of videos whose headers can be read, in lower case.
const EXTENSIONS: [&str; 3] = ["mp4", "mov", "m4v"];

/// The sorted names of the cameras in `dir`: folders `camNN` and videos `camNN.mp4`. Without `cam00`, names of other rigs
/// in this layout count too, e.g. `cam0`, `cam_00` or `camera_0001`.
pub(crate) fn camera_names(dir: &Path) -> Vec<String> {
    let camera = |entry: String| {
        let name = without_extension(&entry);
        let after = name.strip_prefix("camera").or(name.strip_prefix("cam"))?;
        let digits = after.strip_prefix('_').unwrap_or(after);
        let is_camera = !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_digit());
        (is_camera && (name != entry || dir.join(name).is_dir())).then(|| name.to_owned())
    };
    let mut names: Vec<String> = children(dir).into_iter().filter_map(camera).collect();
    names.sort(); // `cam00.mp4` and `cam00` need not be neighbours
    names.dedup();
    if names.first().is_some_and(|name| name == HELD_OUT) {
        names.retain(|name| name.len() == HELD_OUT.len() && !name.contains('_'));
    }
    names
}

/// The name of an entry without the extension of a video.
fn without_extension(entry: &str) -> &str {
    let is_video = |extension: &str| EXTENSIONS.contains(&extension.to_lowercase().as_str());
    entry.rsplit_once('.').filter(|(_, extension)| is_video(extension)).map_or(entry, |(name, _)| name)
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

/// The video of a camera; a missing one has the name that the data set gives it.
fn file(dir: &Path, camera: &str) -> PathBuf {
    let entry = children(dir).into_iter().find(|entry| entry != camera && without_extension(entry) == camera);
    dir.join(entry.unwrap_or(format!("{camera}.mp4")))
}
