//! Films as one looping animated GIF.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use engine::{Failure, FailureKind};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, DynamicImage, Frame, RgbImage};
use shaders::tape::Device;

use super::board::{Board, Panels, check_place};
use super::shots::Film;

/// Speed of the colour quantiser, from 1 (best colours) to 30 (fastest).
const QUANTIZER_SPEED: i32 = 1;

/// How a film becomes a GIF.
#[derive(Clone, Copy, Debug)]
pub struct Gif {
    /// What every frame shows.
    pub panels: Panels,
    /// Frames per second, from 1 to 50. GIF stores hundredths of a second per frame, so the rate is rounded.
    pub fps: u32,
}

/// Writes a GIF that loops forever, with one panel per model from left to right, and returns a summary.
///
/// With [`Panels::truth`], every frame must show a view of the capture: its camera, at most half a frame from its time.
pub fn film_to_gif(
    model_dirs: &[PathBuf],
    capture_dir: &Path,
    film: &Film,
    gif: Gif,
    device: Device,
    file: &Path,
) -> anyhow::Result<String> {
    let board = Board::open(model_dirs, capture_dir, film, gif.panels, device)?;
    let (width, height) = size(&board)?;
    check_place(file)?;

    let mut bytes = Vec::new();
    let mut encoder = GifEncoder::new_with_speed(&mut bytes, QUANTIZER_SPEED);
    encoder.set_repeat(Repeat::Infinite)?;
    for frame in 0..board.frames() {
        let mut picture = RgbImage::new(width, height);
        board.draw(frame, &mut picture, 0)?;
        encoder.encode_frame(Frame::from_parts(DynamicImage::from(picture).into_rgba8(), 0, 0, delay(gif.fps)))?;
    }
    drop(encoder);
    std::fs::write(file, &bytes).with_context(|| format!("cannot write {}", file.display()))?;
    let (frames, panels, kib) = (board.frames(), board.panels(), bytes.len().div_ceil(1024));
    Ok(format!("{frames} frames of {width} × {height} px, {panels} panels, {kib} KiB: {}", file.display()))
}

/// Width and height of a frame.
fn size(board: &Board) -> anyhow::Result<(u32, u32)> {
    let [width, height] = board.size();
    match (u16::try_from(width), u16::try_from(height)) {
        (Ok(width), Ok(height)) => Ok((width.into(), height.into())),
        _ => {
            let message = format!("{width} × {height} px are too many for a GIF, which holds {0} × {0}", u16::MAX);
            Err(Failure::new(FailureKind::BadInput, message).hint("lower --scale, or name fewer jobs").into())
        }
    }
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
