//! Films as one still image: a contact sheet with a row per frame.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind, count};
use image::RgbImage;
use image::imageops::{self, FilterType};
use scene::image_file;
use shaders::tape::Device;

use super::board::{Board, Panels, check_place};
use super::shots::Film;

/// Most pixels of a sheet; viewers open larger images slowly or not at all.
const MAX_PIXELS: u64 = 100_000_000;

/// Writes a PNG with one row per frame and, from left to right, one column per model, and returns a summary.
///
/// With [`Panels::truth`], every frame must show a view of the capture: its camera, at most half a frame from its time.
pub fn film_to_sheet(
    model_dirs: &[PathBuf],
    capture_dir: &Path,
    film: &Film,
    panels: Panels,
    device: Device,
    file: &Path,
) -> anyhow::Result<String> {
    let board = Board::open(model_dirs, capture_dir, film, panels, device)?;
    let ([width, row], rows) = (board.size(), board.frames() as u64);
    if width * row * rows > MAX_PIXELS {
        let message = format!("{width} × {} px are too many for a sheet", row * rows);
        return Err(Failure::new(FailureKind::BadInput, message).hint("lower --scale, or name fewer views").into());
    }
    check_place(file)?;
    let mut sheet = RgbImage::new(width as u32, (row * rows) as u32);
    for frame in 0..board.frames() {
        let picture = imageops::resize(&board.picture(frame)?, width as u32, row as u32, FilterType::Nearest);
        imageops::replace(&mut sheet, &picture, 0, (frame as u64 * row) as i64);
    }
    image_file::write_rgb(file, &sheet)?;
    let (rows, panels) = (count(board.frames(), "row"), count(board.panels(), "panel"));
    let size = format!("{} × {} px", sheet.width(), sheet.height());
    Ok(format!("{}{rows} of {panels}, {size}: {}", board.selects(), file.display()))
}
