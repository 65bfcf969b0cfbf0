//! Videos of inpainters.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

/// The name of ProPainter's result; its masked input is in the same folder.
const RESULT: &str = "inpaint_out.mp4";
/// File extensions of videos.
const VIDEOS: [&str; 5] = ["mp4", "mov", "mkv", "avi", "webm"];

/// The video in a folder: ProPainter's result, or the only one; none if there is none.
pub(crate) fn find(dir: &Path) -> anyhow::Result<Option<PathBuf>> {
    if dir.join(RESULT).is_file() {
        return Ok(Some(dir.join(RESULT)));
    }
    let entries = fs_err::read_dir(dir)?.collect::<std::io::Result<Vec<_>>>()?;
    let is_video = |path: &PathBuf| {
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        VIDEOS.contains(&extension.to_lowercase().as_str())
    };
    let videos: Vec<PathBuf> = entries.iter().map(|entry| entry.path()).filter(is_video).collect();
    match videos.as_slice() {
        [] => Ok(None),
        [video] => Ok(Some(video.clone())),
        several => {
            let message = format!("{} videos in this folder", several.len());
            Err(Failure::new(FailureKind::BadInput, message).hint("keep the inpainted one").at(dir).into())
        }
    }
}
