//! Masks for COLMAP: black where something moves, because it takes no features from black pixels.

use std::path::Path;

use image::{GrayImage, Luma};

use crate::error::{Result, bad};

/// More different values than this mean blurred edges, which are thresholded at one half, as in `sfm-import`.
const MAX_LABELS: usize = 16;
/// Margin of masks as a share of the width: features near an outline see moving pixels.
const MARGIN: f64 = 0.01;

/// A mask of moving pixels.
pub(crate) struct Mask {
    width: u32,
    height: u32,
    moves: Vec<bool>,
}

impl Mask {
    /// Reads a mask; a pixel is set if any channel is (an index of a palette other than black, or any label).
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let image = image::ImageReader::open(path).map_err(|error| bad(error.to_string()).at(path))?;
        let image = image.decode().map_err(|error| bad(format!("not an image: {error}")).at(path))?;
        let (width, height) = (image.width(), image.height());
        let values: Vec<u8> = image.to_rgb8().pixels().map(|pixel| pixel.0.into_iter().max().unwrap_or(0)).collect();
        let mut seen = [false; 256];
        values.iter().for_each(|value| seen[usize::from(*value)] = true);
        let is_soft = seen.iter().filter(|seen| **seen).count() > MAX_LABELS;
        let moves = values.iter().map(|value| if is_soft { *value >= 128 } else { *value > 0 }).collect();
        Ok(Self { width, height, moves })
    }

    /// Share of the pixels that are set.
    pub(crate) fn share(&self) -> f64 {
        self.moves.iter().filter(|moves| **moves).count() as f64 / self.moves.len().max(1) as f64
    }

    /// Whether another mask has the same size.
    pub(crate) fn fits(&self, other: &Self) -> bool {
        (self.width, self.height) == (other.width, other.height)
    }

    /// Sets the pixels that the other mask has set.
    pub(crate) fn unite(&mut self, other: &Self) {
        self.moves.iter_mut().zip(&other.moves).for_each(|(moves, more)| *moves |= more);
    }

    /// Writes the mask that COLMAP reads.
    pub(crate) fn write_for_colmap(&self, path: &Path) -> Result<()> {
        let (width, radius) = (self.width as usize, (MARGIN * f64::from(self.width)).ceil() as usize);
        let rows = widened(&self.moves, width, radius);
        let both = transposed(&widened(&transposed(&rows, width), self.height as usize, radius), self.height as usize);
        let pixel = |x: u32, y: u32| Luma([if both[y as usize * width + x as usize] { 0 } else { 255 }]);
        let image = GrayImage::from_fn(self.width, self.height, pixel);
        image.save(path).map_err(|error| bad(error.to_string()).at(path))
    }
}

/// Every row of `width` values with the runs of set ones longer by `radius` at both ends.
fn widened(values: &[bool], width: usize, radius: usize) -> Vec<bool> {
    let mut wide = vec![false; values.len()];
    for (row, out) in values.chunks(width).zip(wide.chunks_mut(width)) {
        for at in row.iter().enumerate().filter(|(_, set)| **set).map(|(at, _)| at) {
            out[at.saturating_sub(radius)..(at + radius + 1).min(width)].fill(true);
        }
    }
    wide
}

/// Columns as rows.
fn transposed(values: &[bool], width: usize) -> Vec<bool> {
    let height = values.len() / width.max(1);
    (0..values.len()).map(|at| values[at % height * width + at / height]).collect()
}
