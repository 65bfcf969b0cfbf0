//! Masks of a whole video as SAM 2's data set SA-V stores them: JSON with a COCO run-length encoding per frame and object.

use std::path::Path;

use serde::Deserialize;

use super::{checked_size, damaged};
use crate::image_file::read_file;
use crate::{FloatImage, Result};

/// The part of the file that is read.
#[derive(Deserialize)]
struct Masklets {
    masklet: Vec<Vec<Encoded>>,
}

/// The mask of an object in a frame.
#[derive(Deserialize)]
struct Encoded {
    /// Height and width.
    size: [u64; 2],
    /// Lengths of alternating runs of pixels outside and inside the object, column by column.
    counts: String,
}

/// Decodes the masks of every frame: the rank of the object that a pixel belongs to, from 1, and 0 outside all of them.
pub(super) fn read_video(path: &Path) -> Result<Vec<FloatImage>> {
    let bad = |reason: String| damaged("file of SA-V masks", reason, path);
    let file: Masklets = serde_json::from_slice(&read_file(path)?).map_err(|error| bad(error.to_string()))?;
    let frame = |(at, objects): (usize, &Vec<Encoded>)| {
        let [height, width] = objects.first().ok_or_else(|| bad(format!("frame {at} has no object")))?.size;
        let (width, height) = checked_size(width, height, path)?;
        let mut values = vec![0.0; width as usize * height as usize];
        for (rank, object) in objects.iter().enumerate() {
            let fits = object.size == [u64::from(height), u64::from(width)];
            let set = fits.then(|| inside(&object.counts, values.len())).flatten();
            for place in set.ok_or_else(|| bad(format!("frame {at}, object {rank}")))?.into_iter().flatten() {
                let (column, row) = (place / height as usize, place % height as usize);
                values[row * width as usize + column] = (rank + 1) as f32;
            }
        }
        Ok(FloatImage { width, height, channels: 1, values })
    };
    file.masklet.iter().enumerate().map(frame).collect()
}

/// The ranges of set pixels, column by column; none unless the runs cover exactly `pixels`.
///
/// Counts are numbers to the base 32, lowest digit first, in characters from `0` (48) on: bit 5 of a character means
/// that more follow, bit 4 of the last one is the sign. From the fourth on, they are differences from the count before
/// the last.
fn inside(counts: &str, pixels: usize) -> Option<Vec<std::ops::Range<usize>>> {
    let (mut runs, mut start) = (Vec::<i64>::new(), 0_usize);
    let (mut value, mut shift) = (0_i64, 0_u32);
    let mut ranges = Vec::new();
    for byte in counts.bytes() {
        let digit = i64::from(byte.checked_sub(48).filter(|digit| *digit < 64)?);
        if shift > 50 {
            return None;
        }
        value |= (digit & 0x1f) << shift;
        shift += 5;
        if digit & 0x20 != 0 {
            continue;
        }
        if digit & 0x10 != 0 {
            value |= -1 << shift;
        }
        let before = if runs.len() > 2 { runs[runs.len() - 2] } else { 0 };
        let run = value + before;
        let end = start.checked_add(usize::try_from(run).ok()?).filter(|end| *end <= pixels)?;
        if runs.len() % 2 == 1 {
            ranges.push(start..end);
        }
        runs.push(run);
        (start, value, shift) = (end, 0, 0);
    }
    (start == pixels && shift == 0).then_some(ranges)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_go_down_the_columns() {
        // Runs of 1, 2, 3, 1 and 2 pixels; the last two are differences from 2 and 3.
        let text = r#"{"masklet": [[{"size": [3, 3], "counts": "123ON"}]], "masklet_num": 1}"#;
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.json");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_video(&path)
        };
        let frames = read(&text.replace("123ON", "123OO")).unwrap();
        assert_eq!(frames[0].values, [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        for counts in ["123", "123OON", "123OP", "1 3OO", "o", ""] {
            let message = read(&text.replace("123ON", counts)).unwrap_err().to_string();
            assert!(message.contains("frame 0, object 0") && message.ends_with("a.json"), "{counts}: {message}");
        }
        assert!(read("{}").unwrap_err().to_string().contains("masklet"));
    }

    /// The file states the mean area of every object over the frames that show it.
    #[test]
    fn real_masks_have_the_stated_areas() {
        let Some(dir) = support::data("formats/outputs/masks/sam2_sav_rle") else { return };
        #[derive(Deserialize)]
        struct Stated {
            masklet: Vec<Vec<Encoded>>,
            masklet_size_abs: Vec<f64>,
        }
        for name in ["sav_000001_manual.json", "sav_000001_auto.json"] {
            let path = dir.join(name);
            let stated: Stated = serde_json::from_slice(&read_file(&path).unwrap()).unwrap();
            for (object, expected) in stated.masklet_size_abs.iter().enumerate() {
                let area = |frame: &Vec<Encoded>| -> usize {
                    inside(&frame[object].counts, 848 * 480).unwrap().into_iter().map(|range| range.len()).sum()
                };
                let areas: Vec<usize> = stated.masklet.iter().map(area).filter(|area| *area > 0).collect();
                let mean = areas.iter().sum::<usize>() as f64 / areas.len() as f64;
                eprintln!("{name}, object {object}: {mean:.1} of {expected:.1} pixels in {} frames", areas.len());
                assert!((mean / expected - 1.0).abs() < 0.02, "{name} {object}: {mean} {expected}");
            }
            let frames = read_video(&path).unwrap();
            assert_eq!((frames.len(), frames[0].width, frames[0].height), (121, 480, 848));
        }
    }
}
