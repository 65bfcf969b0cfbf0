//! Portable float maps: `Pf` (one channel) or `PF` (three), width, height, scale (negative: little endian), then the
//! rows from bottom to top.

use std::path::Path;

use super::{Content, checked_size, damaged};
use crate::image_file::read_file;
use crate::{FloatImage, Result};

/// Decodes a file; flow is the first two of three channels.
pub(super) fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let bytes = read_file(path)?;
    let bad = |reason: String| damaged("PFM file", reason, path);
    let (words, body) = header(&bytes).ok_or_else(|| bad("truncated header".into()))?;
    let stored = match words[0] {
        "Pf" => 1,
        "PF" => 3,
        other => return Err(bad(format!("unknown type {other:?}"))),
    };
    let number = |word: &str| word.parse::<u64>().map_err(|_| bad(format!("{word:?} is not a number of pixels")));
    let (width, height) = checked_size(number(words[1])?, number(words[2])?, path)?;
    let scale: f32 = words[3].parse().map_err(|_| bad(format!("{:?} is not a scale", words[3])))?;
    let kept = content.channels();
    if kept > stored {
        return Err(bad(format!("{stored} channels where {kept} are needed")));
    }
    let row_bytes = 4 * stored * width as usize;
    let expected = row_bytes * height as usize;
    if body.len() != expected {
        return Err(bad(format!("{} bytes of values where {width}×{height} pixels need {expected}", body.len())));
    }
    let decode: fn([u8; 4]) -> f32 = if scale < 0.0 { f32::from_le_bytes } else { f32::from_be_bytes };
    let value = |bytes: &[u8]| decode([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let pixels = body.chunks_exact(row_bytes).rev().flat_map(|row| row.chunks_exact(4 * stored));
    let values = pixels.flat_map(|pixel| pixel.chunks_exact(4).take(kept).map(value)).collect();
    Ok(FloatImage { width, height, channels: kept, values })
}

/// Splits a file into the four words of its header and the body, which starts after one whitespace byte.
fn header(bytes: &[u8]) -> Option<([&str; 4], &[u8])> {
    let mut words = [""; 4];
    let mut rest = bytes;
    for word in &mut words {
        let start = rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
        let end = start + rest[start..].iter().position(u8::is_ascii_whitespace)?;
        *word = std::str::from_utf8(&rest[start..end]).ok()?;
        rest = &rest[end..];
    }
    Some((words, &rest[1..]))
}
