//! Whether maps change from frame to frame where the images change.

use image::RgbImage;
use scene::{Capture, FloatImage, Split, Videos, pixels};

use crate::{Memo, better_shift};

/// The shift by one frame with which the changes of maps fit those of the images clearly better; `None` without one. `map`
/// returns the map in the file of a view, by the view's index; every value covers one cell of the image. Only training views
/// are compared.
///
/// Where something moves, a map and the image change between the same two frames in the same cells. The misfit of a file
/// with a view is 1 − r, where r is Pearson's correlation of both changes over the cells.
pub fn shift_by_changes(
    capture: &Capture,
    map: impl Fn(usize) -> anyhow::Result<Option<FloatImage>>,
) -> anyhow::Result<Option<i64>> {
    let videos = Videos::of(capture);
    let is_training = |view: &usize| capture.views[*view].split == Split::Train;
    let next = |view: usize| videos.after(&capture.views[view], 1).filter(is_training).filter(|_| is_training(&view));
    let of_maps = Memo::new(|file: usize| {
        let Some(next) = next(file) else { return Ok(None) };
        Ok(map(file)?.zip(map(next)?).and_then(|(from, to)| changes_of_map(&from, &to)))
    });
    let of_images = Memo::new(|view: usize| {
        let (Some(next), Some(map)) = (next(view), map(view)?) else { return Ok(None) };
        let [from, to] = [view, next].map(|view| capture.load_image(&capture.views[view]));
        Ok(Some(changes_of_image(&from?, &to?, [map.width as usize, map.height as usize])))
    });
    better_shift(capture, |view, file| {
        let (Some(image), Some(map)) = (of_images.get(view)?, of_maps.get(file)?) else { return Ok(None) };
        Ok(correlation(&image, &map).map(|r| 1.0 - r))
    })
}

/// The distance between the values of every cell, 0 where a value is unknown; `None` for maps of different sizes.
fn changes_of_map(from: &FloatImage, to: &FloatImage) -> Option<Vec<f64>> {
    let is_alike = (from.width, from.height, from.channels) == (to.width, to.height, to.channels);
    let distance = |(a, b): (&[f32], &[f32])| {
        let squared = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        if squared.is_finite() { squared.sqrt() } else { 0.0 }
    };
    let cells = from.values.chunks_exact(from.channels).zip(to.values.chunks_exact(to.channels));
    is_alike.then(|| cells.map(distance).collect())
}

/// The mean difference of the pixels of every cell, in grey levels.
fn changes_of_image(from: &RgbImage, to: &RgbImage, [columns, rows]: [usize; 2]) -> Vec<f64> {
    let (width, height) = (from.width() as usize, from.height() as usize);
    let (mut sums, mut counts) = (vec![0.0; columns * rows], vec![0_usize; columns * rows]);
    for (at, (a, b)) in from.pixels().zip(to.pixels()).enumerate() {
        let cell = (at / width * rows / height) * columns + at % width * columns / width;
        sums[cell] += pixels::difference(a.0, b.0);
        counts[cell] += 1;
    }
    sums.iter().zip(counts).map(|(sum, count)| sum / count.max(1) as f64).collect()
}

/// Pearson's correlation; `None` if either does not vary, or for different lengths.
fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let [mut both, mut of_a, mut of_b] = [0.0; 3];
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        both += a * b;
        of_a += a * a;
        of_b += b * b;
    }
    let scale = (of_a * of_b).sqrt();
    (a.len() == b.len() && scale > 0.0 && scale.is_finite()).then(|| both / scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_that_change_where_the_image_changes_correlate() {
        let image = |at: u32| RgbImage::from_fn(8, 4, |x, _| image::Rgb([if x / 2 == at { 200 } else { 50 }; 3]));
        let map = |at: usize| {
            let values = (0..8).flat_map(|cell| [if cell % 4 == at { 1.0 } else { 0.0 }, 0.5]).collect();
            FloatImage { width: 4, height: 2, channels: 2, values }
        };
        let of_image = changes_of_image(&image(0), &image(1), [4, 2]);
        assert_eq!(of_image, [150.0, 150.0, 0.0, 0.0, 150.0, 150.0, 0.0, 0.0]);
        let r = |from: usize, to: usize| {
            correlation(&of_image, &changes_of_map(&map(from), &map(to)).expect("equal sizes"))
        };
        assert_eq!((r(0, 1), r(2, 3)), (Some(1.0), Some(-1.0)));
        assert_eq!(r(1, 1), None, "a map that does not change fits no frame better than others");
        assert_eq!(changes_of_map(&map(0), &FloatImage { width: 2, height: 4, ..map(0) }), None);
    }
}
