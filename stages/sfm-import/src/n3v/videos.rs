//! The cameras of a rig and the extracted frames of their videos.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::error::{Result, bad};
use crate::files::children;
use crate::image_names::{image_names, images_dir};

/// The frames of one camera, in order.
pub(super) struct Video {
    /// Name of the camera, e.g. `cam00`.
    pub(super) camera: String,
    /// One image per instant.
    pub(super) frames: Vec<PathBuf>,
    /// The number of the first frame.
    first: u64,
}

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

/// Lists the frames of all cameras, which must have equal numbers.
pub(super) fn read(dir: &Path) -> Result<Vec<Video>> {
    let names = camera_names(dir);
    check_extracted(dir, &names)?;
    let videos = names.into_iter().map(|camera| video(dir, camera)).collect::<Result<Vec<_>>>()?;
    let Some(reference) = videos.first() else { return Err(bad("the rig has no camera").at(dir)) };
    for video in &videos {
        if (video.first, video.frames.len()) != (reference.first, reference.frames.len()) {
            let message = format!(
                "{} has {}, but {} has {}",
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

/// Refuses cameras without frames; the error lists all of them.
fn check_extracted(dir: &Path, names: &[String]) -> Result<()> {
    let empty = |name: &&String| images(dir, name).is_empty();
    let missing: Vec<&str> = names.iter().filter(empty).map(String::as_str).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let message = format!("no frames of {}: videos are not decoded, only their extracted images", missing.join(", "));
    let failure = Failure::new(FailureKind::MissingData, message);
    Err(failure.hint(format!("extract them; run in that folder: {EXTRACT}")).at(dir))
}

/// The images of one camera in natural order: those in its folder `images`, or directly in the camera's folder.
fn images(dir: &Path, camera: &str) -> Vec<PathBuf> {
    let folder = images_dir(&dir.join(camera));
    let names = image_names(&folder).into_iter().filter(|name| !name.contains('/'));
    names.map(|name| folder.join(name)).collect()
}

/// The frames of one camera. Their numbers must be consecutive, because a gap would shift all later frames in time.
fn video(dir: &Path, camera: String) -> Result<Video> {
    let frames = images(dir, &camera);
    let numbers = frames.iter().map(|path| number(path)).collect::<Result<Vec<_>>>()?;
    let is_gap = |pair: &[u64]| pair[1].checked_sub(pair[0]) != Some(1);
    if let Some(at) = numbers.windows(2).position(is_gap) {
        let message = format!("{camera} has frame {} after frame {}", numbers[at + 1], numbers[at]);
        let hint = "frames must be consecutive and unique; to skip training views, set frame_step";
        return Err(bad(message).hint(hint).at(&frames[at + 1]));
    }
    Ok(Video { camera, first: numbers.first().copied().unwrap_or_default(), frames })
}

/// The frame number in a file name, e.g. 12 for `frame_0012.png`.
fn number(path: &Path) -> Result<u64> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let digits = stem.rsplit(|symbol: char| !symbol.is_ascii_digit()).next().unwrap_or_default();
    digits.parse().map_err(|_| {
        bad("the file name does not end in a frame number").hint("name the frames 0000.png, 0001.png, …").at(path)
    })
}

impl Video {
    fn frames_text(&self) -> String {
        let last = self.first + self.frames.len().saturating_sub(1) as u64;
        format!("{} frames ({} to {last})", self.frames.len(), self.first)
    }
}
