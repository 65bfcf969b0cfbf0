//! Middlebury flow (Baker et al. 2011): `PIEH`, width, height, then rows of (u, v), little endian.

use std::path::Path;

use super::{checked_size, damaged, floats};
use crate::image_file::read_file;
use crate::{FloatImage, Result};

/// The f32 value 202021.25 in little-endian byte order.
const TAG: &[u8; 4] = b"PIEH";
/// Components of at least this magnitude mark unknown flow.
const UNKNOWN: f32 = 1e9;

/// Decodes a file to [H, W, 2] flow; unknown flow becomes NaN.
pub(super) fn read(path: &Path) -> Result<FloatImage> {
    let bytes = read_file(path)?;
    let bad = |reason: &str| damaged("Middlebury flow file", reason, path);
    let Some((header, body)) = bytes.split_at_checked(12) else { return Err(bad("truncated header")) };
    if &header[..4] != TAG {
        return Err(bad("no PIEH tag at the start"));
    }
    let side = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let (width, height) = checked_size(side(4).into(), side(8).into(), path)?;
    let expected = 8 * width as usize * height as usize;
    if body.len() != expected {
        return Err(bad(&format!("{} bytes of values where {width}×{height} pixels need {expected}", body.len())));
    }
    let unknown = |value: f32| !(value.abs() < UNKNOWN);
    let mut values: Vec<f32> = floats(body).collect();
    for flow in values.chunks_exact_mut(2).filter(|flow| flow.iter().any(|value| unknown(*value))) {
        flow.fill(f32::NAN);
    }
    Ok(FloatImage { width, height, channels: 2, values })
}
