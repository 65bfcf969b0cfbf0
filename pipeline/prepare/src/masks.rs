//! Masks for COLMAP: black where something moves, because it takes no features from black pixels.

use std::path::Path;

use image::{GrayImage, Luma};
use scene::Mask;
use scene::mask_file::{MaskFile, MaskValues};

use crate::error::{Result, bad};

/// Margin of masks as a share of the width: features near an outline see moving pixels.
const MARGIN: f64 = 0.01;

/// The least level of pixels that are set in these masks.
pub(crate) fn least_level<'p>(paths: impl Iterator<Item = &'p Path>) -> Result<u8> {
    let mut values = MaskValues::default();
    for path in paths {
        values.add(&decode(path)?);
    }
    Ok(values.least_level())
}

/// Reads a mask; pixels from a level on are set.
pub(crate) fn read(path: &Path, least_level: u8) -> Result<Mask> {
    let levels = decode(path)?.levels;
    let inside = levels.iter().map(|level| *level >= least_level).collect();
    Ok(Mask { width: levels.width(), height: levels.height(), inside })
}

fn decode(path: &Path) -> Result<MaskFile> {
    MaskFile::read(path).map_err(|error| bad(format!("not an image: {error}")).at(path))
}

/// Share of the pixels that are set.
pub(crate) fn share(mask: &Mask) -> f64 {
    mask.count() as f64 / mask.inside.len().max(1) as f64
}

/// Writes the mask that COLMAP reads.
pub(crate) fn write_for_colmap(mask: &Mask, path: &Path) -> Result<()> {
    let wide = mask.dilated((MARGIN * f64::from(mask.width)).ceil() as u32);
    let pixel = |x: u32, y: u32| Luma([if wide.inside[(y * wide.width + x) as usize] { 0 } else { 255 }]);
    let image = GrayImage::from_fn(wide.width, wide.height, pixel);
    image.save(path).map_err(|error| bad(error.to_string()).at(path))
}
