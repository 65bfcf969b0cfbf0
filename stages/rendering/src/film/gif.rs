//! Films as one looping animated GIF.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use engine::{Failure, FailureKind, count};
use gif::{DisposalMethod, Encoder, Frame, Repeat};
use image::RgbImage;
use rayon::prelude::*;
use shaders::tape::Device;

use super::board::{Board, Panels, check_place};
use super::shots::Film;

/// Speed of the colour quantiser, from 1 (best colours) to 30 (fastest).
const QUANTIZER_SPEED: i32 = 1;
/// Minimum number of pixels that the quantiser learns from; smaller pictures are repeated, because few pixels give poor
/// colours.
const LEARNT_PIXELS: usize = 1 << 14;

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

    let mut encoder = Encoder::new(Vec::new(), width, height, &[])?;
    encoder.set_repeat(Repeat::Infinite)?;
    let frames: Vec<usize> = (0..board.frames()).collect();
    for some in frames.chunks(rayon::current_num_threads()) {
        let pictures = some.iter().map(|frame| board.picture(*frame)).collect::<anyhow::Result<Vec<_>>>()?;
        let ready: Vec<_> = pictures.par_iter().map(|picture| encoded(picture, gif)).collect();
        ready.iter().try_for_each(|frame| encoder.write_lzw_pre_encoded_frame(frame))?;
    }
    let bytes = encoder.into_inner()?;
    std::fs::write(file, &bytes).with_context(|| format!("cannot write {}", file.display()))?;
    let (frames, panels) = (count(board.frames(), "frame"), count(board.panels(), "panel"));
    let size = format!("{width} × {height} px, {panels}, {} KiB", bytes.len().div_ceil(1024));
    Ok(format!("{}{frames} of {size}: {}", board.selects(), file.display()))
}

/// The frame of a picture, enlarged and compressed. Its colours are chosen before it is enlarged, which adds none: the time of
/// the quantiser grows with the number of pixels.
fn encoded(picture: &RgbImage, gif: Gif) -> Frame<'static> {
    let (width, height, scale) = (picture.width(), picture.height(), gif.panels.scale);
    let pixels = (width * height) as usize;
    let copies = LEARNT_PIXELS.div_ceil(pixels);
    let learnt = picture.as_raw().repeat(copies);
    let plain = Frame::from_rgb_speed(width as u16, height as u16 * copies as u16, &learnt, QUANTIZER_SPEED);
    let mut frame = Frame {
        width: (width * scale) as u16,
        height: (height * scale) as u16,
        buffer: enlarged(&plain.buffer[..pixels], width as usize, scale as usize).into(),
        delay: delay(gif.fps),
        dispose: DisposalMethod::Background,
        ..plain
    };
    frame.make_lzw_pre_encoded();
    frame
}

/// Repeats the values of an image `scale` times in both directions.
fn enlarged(values: &[u8], width: usize, scale: usize) -> Vec<u8> {
    let wide = |row: &[u8]| row.iter().flat_map(|value| std::iter::repeat_n(*value, scale)).collect::<Vec<_>>();
    values.chunks_exact(width).flat_map(|row| wide(row).repeat(scale)).collect()
}

/// Width and height of a frame.
fn size(board: &Board) -> anyhow::Result<(u16, u16)> {
    let [width, height] = board.size();
    match (u16::try_from(width), u16::try_from(height)) {
        (Ok(width), Ok(height)) => Ok((width, height)),
        _ => {
            let message = format!("{width} × {height} px are too many for a GIF, which holds {0} × {0}", u16::MAX);
            Err(Failure::new(FailureKind::BadInput, message).hint("lower --scale, or name fewer jobs").into())
        }
    }
}

/// The time of one frame, in hundredths of a second.
fn delay(fps: u32) -> u16 {
    (100.0 / f64::from(fps)).round() as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_are_whole_hundredths_of_a_second() {
        for (fps, hundredths) in [(1, 100), (8, 13), (12, 8), (30, 3), (50, 2)] {
            assert_eq!(delay(fps), hundredths, "{fps} frames per second");
        }
    }
}
