//! Middlebury flow (Baker et al. 2011): `PIEH`, width, height, then rows of (u, v), little endian.

use std::path::Path;

use scene::{FloatImage, Result};

use super::{checked_size, damaged, floats, read_bytes};

/// The f32 202021.25, which checks the byte order.
const TAG: &[u8; 4] = b"PIEH";
/// Components of this size and more mean that the flow is unknown.
const UNKNOWN: f32 = 1e9;

pub(super) fn read(path: &Path) -> Result<FloatImage> {
    let bytes = read_bytes(path)?;
    let bad = |reason: &str| damaged("Middlebury flow file", reason, path);
    let Some((header, body)) = bytes.split_at_checked(12) else { return Err(bad("it ends in the header")) };
    if &header[..4] != TAG {
        return Err(bad("it does not begin with PIEH"));
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
