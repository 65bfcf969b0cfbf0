//! The cameras of a rig and the frames of their videos.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::colmap::layout::{image_names, images_dir};
use crate::recognise::children;
use crate::source::{Result, bad};

/// The frames of one camera, in order.
pub struct Video {
    /// As `cam00`.
    pub camera: String,
    /// One image per instant.
    pub frames: Vec<PathBuf>,
    /// The number of the first frame.
    first: u64,
}

/// How frames get out of videos, which nothing here decodes: one command, to be run in the capture's folder.
pub const EXTRACT: &str = "for v in cam*.mp4; do mkdir -p \"${v%.mp4}/images\"; \
                       ffmpeg -i \"$v\" -frames:v 300 -start_number 0 \"${v%.mp4}/images/%04d.png\"; done";

/// Names of the cameras in `dir`, sorted: folders `camNN` and videos `camNN.mp4`, whose frames may be missing.
pub fn camera_names(dir: &Path) -> Vec<String> {
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

/// The videos of all cameras: as many frames of each, with the same numbers.
pub fn read(dir: &Path) -> Result<Vec<Video>> {
    let names = camera_names(dir);
    check_extracted(dir, &names)?;
    let videos = names.into_iter().map(|camera| video(dir, camera)).collect::<Result<Vec<_>>>()?;
    let Some(reference) = videos.first() else { return Err(bad("no camera").at(dir)) };
    for video in &videos {
        if (video.first, video.frames.len()) != (reference.first, reference.frames.len()) {
            let message = format!(
                "{} has {} where {} has {}",
                video.camera,
                video.frames_text(),
                reference.camera,
                reference.frames_text()
            );
            let hint = "all cameras must show the same instants: extract the frames of both again";
            return Err(bad(message).hint(hint).at(dir.join(&video.camera)));
        }
    }
    Ok(videos)
}

/// Refuses cameras without frames, all of them at once.
fn check_extracted(dir: &Path, names: &[String]) -> Result<()> {
    let empty = |name: &&String| images(dir, name).is_empty();
    let missing: Vec<&str> = names.iter().filter(empty).map(String::as_str).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let message = format!("no frames of {}: videos are not decoded, their images are read", missing.join(", "));
    let failure = Failure::new(FailureKind::MissingData, message);
    Err(failure.hint(format!("extract them in that folder: {EXTRACT}")).at(dir))
}

/// The images of one camera, in natural order: those in its folder `images`, else those in its own.
fn images(dir: &Path, camera: &str) -> Vec<PathBuf> {
    let folder = images_dir(&dir.join(camera));
    let names = image_names(&folder).into_iter().filter(|name| !name.contains('/'));
    names.map(|name| folder.join(name)).collect()
}

/// One camera's frames, numbered without a gap: a frame that is left out would shift all later ones in time.
fn video(dir: &Path, camera: String) -> Result<Video> {
    let frames = images(dir, &camera);
    let numbers = frames.iter().map(|path| number(path)).collect::<Result<Vec<_>>>()?;
    let is_gap = |pair: &[u64]| pair[1].checked_sub(pair[0]) != Some(1);
    if let Some(at) = numbers.windows(2).position(is_gap) {
        let message = format!("{camera} has frame {} after frame {}", numbers[at + 1], numbers[at]);
        let hint = "frames must be consecutive, each of them once; frame_step leaves out training views";
        return Err(bad(message).hint(hint).at(&frames[at + 1]));
    }
    Ok(Video { camera, first: numbers.first().copied().unwrap_or_default(), frames })
}

/// 12 for `frame_0012.png`.
fn number(path: &Path) -> Result<u64> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let digits = stem.rsplit(|symbol: char| !symbol.is_ascii_digit()).next().unwrap_or_default();
    digits
        .parse()
        .map_err(|_| bad("the image's name does not end in a frame number").hint("call frames 0000.png …").at(path))
}

impl Video {
    fn frames_text(&self) -> String {
        let last = self.first + self.frames.len().saturating_sub(1) as u64;
        format!("{} frames ({} to {last})", self.frames.len(), self.first)
    }
}
