//! Videos of inpainters, decoded by `ffmpeg`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use engine::{Failure, FailureKind};
use scene::image_file::RgbImage;

/// The program that decodes videos.
const FFMPEG: &str = "ffmpeg";
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

/// Decodes every frame of a video.
pub(crate) fn decode(path: &Path) -> anyhow::Result<Vec<RgbImage>> {
    decode_with(FFMPEG, path)
}

fn decode_with(program: &str, path: &Path) -> anyhow::Result<Vec<RgbImage>> {
    let mut command = Command::new(program);
    command.args(["-nostdin", "-v", "error", "-i"]).arg(path);
    // Every stored frame once: without it, frames are repeated or dropped to keep a constant rate.
    command.args(["-fps_mode", "passthrough", "-f", "image2pipe", "-c:v", "ppm", "-"]).stdin(Stdio::null());
    let output = command.output().map_err(|error| {
        let hint =
            "install it, e.g. `apt install ffmpeg`, or write the frames as PNG files: ProPainter with --save_frames";
        Failure::new(FailureKind::World, format!("{program}, which decodes videos, cannot be started ({error})"))
            .hint(hint)
            .at(path)
    })?;
    let failed = |reason: &str| {
        Failure::new(FailureKind::BadInput, format!("ffmpeg cannot decode this video: {reason}")).at(path)
    };
    if !output.status.success() {
        let reason = String::from_utf8_lossy(&output.stderr);
        return Err(failed(reason.lines().last().unwrap_or("no reason given")).into());
    }
    Ok(images(&output.stdout).ok_or_else(|| failed("its output is not a sequence of images"))?)
}

/// The images of concatenated PPM files of 8 bits.
fn images(mut bytes: &[u8]) -> Option<Vec<RgbImage>> {
    let mut images = Vec::new();
    while !bytes.is_empty() {
        let mut word = || {
            let end = bytes.iter().position(u8::is_ascii_whitespace)?;
            let word = std::str::from_utf8(&bytes[..end]).ok()?;
            bytes = &bytes[end + 1..];
            Some(word)
        };
        let (magic, width, height, white) = (word()?, word()?, word()?, word()?);
        let (width, height): (u32, u32) = (width.parse().ok()?, height.parse().ok()?);
        let size = (width as usize).checked_mul(height as usize)?.checked_mul(3)?;
        let (pixels, rest) = bytes.split_at_checked(size).filter(|_| magic == "P6" && white == "255")?;
        images.push(RgbImage::from_raw(width, height, pixels.to_vec())?);
        bytes = rest;
    }
    Some(images)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn concatenated_images_are_split() {
        let two = [b"P6\n2 1\n255\n".as_slice(), &[1, 2, 3, 4, 5, 6], b"P6\n1 1\n255\n", &[10, 32, 9]].concat();
        let found = images(&two).unwrap();
        assert_eq!(
            (found.len(), found[0].dimensions(), found[1].as_raw().as_slice()),
            (2, (2, 1), [10, 32, 9].as_slice())
        );
        assert!((1..two.len()).filter(|end| *end != 17).all(|end| images(&two[..end]).is_none()));
    }

    #[test]
    fn a_missing_decoder_is_named_with_what_to_install() {
        let message = format!("{:#}", decode_with("no-such-ffmpeg", Path::new("inpaint_out.mp4")).unwrap_err());
        assert!(message.contains("apt install ffmpeg") && message.contains("inpaint_out.mp4"), "{message}");
    }
}
