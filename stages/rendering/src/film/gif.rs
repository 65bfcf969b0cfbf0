//! Films as one looping animated GIF: the ground truth and several models side by side, at the same times and cameras.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use engine::{Failure, FailureKind};
use image::codecs::gif::{GifEncoder, Repeat};
use image::imageops::{self, FilterType};
use image::{Delay, DynamicImage, Frame, RgbImage};
use scene::{Camera, Capture, View};
use shaders::tape::Device;

use super::shots::{Film, Shot, shots};
use super::subject::Subject;

/// Speed of the colour quantiser, from 1 (best colours) to 30 (fastest).
const QUANTIZER_SPEED: i32 = 1;
/// A camera is that of a view if no element of its pose differs by more: the rounding of a path that passes the view.
const SAME_POSE: f64 = 1e-6;

/// How a film becomes a GIF.
#[derive(Clone, Copy, Debug)]
pub struct Gif {
    /// Whether the first panel shows the capture's own images.
    pub truth: bool,
    /// Enlarges every panel by this factor.
    pub scale: u32,
    /// Frames per second, from 1 to 50. GIF stores hundredths of a second per frame, so the rate is rounded.
    pub fps: u32,
}

/// Writes a GIF that loops forever, with one panel per model from left to right, and returns a summary.
///
/// With [`Gif::truth`], every frame must show a view of the capture: its camera, at most half a frame from its time.
pub fn film_to_gif(
    model_dirs: &[PathBuf],
    capture_dir: &Path,
    film: &Film,
    gif: Gif,
    device: Device,
    file: &Path,
) -> anyhow::Result<String> {
    let capture = Capture::open(capture_dir)?;
    let shots = shots(film, &capture)?;
    let truths = if gif.truth { truths(&shots, &capture)? } else { Vec::new() };
    let subjects: Vec<Subject> = model_dirs
        .iter()
        .map(|dir| Subject::open(dir, film.selection.as_ref(), device))
        .collect::<anyhow::Result<_>>()?;
    let panels = subjects.len() + usize::from(gif.truth);
    let (width, height) = size(&shots[0].camera, panels, gif.scale)?;
    check_place(file)?;

    let mut bytes = Vec::new();
    let mut encoder = GifEncoder::new_with_speed(&mut bytes, QUANTIZER_SPEED);
    encoder.set_repeat(Repeat::Infinite)?;
    for (index, shot) in shots.iter().enumerate() {
        let truth = truths.get(index).map(|view| Ok(capture.load_image(view)?));
        let images = truth.into_iter().chain(subjects.iter().map(|subject| subject.image(shot)));
        let picture = side_by_side(images, width, height, panels)?;
        encoder.encode_frame(Frame::from_parts(DynamicImage::from(picture).into_rgba8(), 0, 0, delay(gif.fps)))?;
    }
    drop(encoder);
    std::fs::write(file, &bytes).with_context(|| format!("cannot write {}", file.display()))?;
    let (count, kib) = (shots.len(), bytes.len().div_ceil(1024));
    Ok(format!("{count} frames of {width} × {height} px, {panels} panels, {kib} KiB: {}", file.display()))
}

/// The view that each frame shows.
fn truths<'c>(shots: &[Shot], capture: &'c Capture) -> anyhow::Result<Vec<&'c View>> {
    let off_secs = |view: &View, shot: &Shot| (view.time_secs - shot.time_secs).abs();
    let truth = |(index, shot): (usize, &Shot)| {
        let of_camera = capture.views.iter().filter(|view| is_same(&view.camera, &shot.camera));
        let nearest = of_camera.min_by(|a, b| off_secs(a, shot).total_cmp(&off_secs(b, shot)));
        nearest.filter(|view| off_secs(view, shot) <= 0.5 * capture.time_map.frame_secs).ok_or_else(|| {
            let message =
                format!("no view of the capture shows frame {index}: its camera took none at {} s", shot.time_secs);
            let hint = "let the film follow views of the capture (--views test without --times), or omit --truth";
            Failure::new(FailureKind::BadInput, message).hint(hint).at(&capture.dir).into()
        })
    };
    shots.iter().enumerate().map(truth).collect()
}

/// Whether two cameras take the same image, up to rounding.
fn is_same(a: &Camera, b: &Camera) -> bool {
    let (pose_a, pose_b) = (a.camera_from_world, b.camera_from_world);
    a.intrinsics == b.intrinsics
        && pose_a.rotation.abs_diff_eq(pose_b.rotation, SAME_POSE)
        && pose_a.translation.abs_diff_eq(pose_b.translation, SAME_POSE * (1.0 + pose_a.translation.length()))
}

/// Width and height of the whole picture.
fn size(camera: &Camera, panels: usize, scale: u32) -> anyhow::Result<(u32, u32)> {
    let width = u64::from(camera.intrinsics.width) * u64::from(scale) * panels as u64;
    let height = u64::from(camera.intrinsics.height) * u64::from(scale);
    match (u16::try_from(width), u16::try_from(height)) {
        (Ok(width), Ok(height)) => Ok((width.into(), height.into())),
        _ => {
            let message = format!("{width} × {height} px are too many for a GIF, which holds {0} × {0}", u16::MAX);
            Err(Failure::new(FailureKind::BadInput, message).hint("lower --scale, or name fewer jobs").into())
        }
    }
}

/// Refuses a file that cannot be written before time is spent on rendering.
fn check_place(file: &Path) -> anyhow::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (problem, path) = match () {
        () if file.is_dir() => ("the GIF would replace a folder", file),
        () if !folder.is_dir() => ("the folder of the GIF does not exist", folder),
        () => return Ok(()),
    };
    Err(Failure::new(FailureKind::BadInput, problem).hint("name a file in an existing folder").at(path).into())
}

/// Enlarges images to their share of the width and places them from left to right.
fn side_by_side(
    images: impl Iterator<Item = anyhow::Result<RgbImage>>,
    width: u32,
    height: u32,
    panels: usize,
) -> anyhow::Result<RgbImage> {
    let panel_width = width / panels as u32;
    let mut picture = RgbImage::new(width, height);
    for (index, image) in images.enumerate() {
        let panel = imageops::resize(&image?, panel_width, height, FilterType::Nearest);
        imageops::replace(&mut picture, &panel, i64::from(panel_width) * index as i64, 0);
    }
    Ok(picture)
}

/// The time of one frame, in whole hundredths of a second.
fn delay(fps: u32) -> Delay {
    Delay::from_numer_denom_ms(10 * (100.0 / f64::from(fps)).round() as u32, 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_are_whole_hundredths_of_a_second() {
        let expected = [(1, 1000), (8, 130), (12, 80), (30, 30), (50, 20)];
        for (fps, ms) in expected {
            assert_eq!(delay(fps).numer_denom_ms(), (ms, 1), "{fps} frames per second");
        }
    }
}
