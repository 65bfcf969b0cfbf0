//! Images and the planes of a tile: a tile is blended and differentiated plane by plane, and images interleave their channels.

use std::ops::Range;

use super::PIXELS;
use super::packed::Tile;
use crate::rasteriser::binning::TILE;
use crate::tape::Real;

/// The pixels of a tile in an image of which the rows from `first_row` are at hand, `width` pixels each.
pub(super) struct PartOfImage<'a> {
    pub tile: &'a Tile<'a>,
    pub first_row: usize,
    pub width: usize,
}

impl PartOfImage<'_> {
    /// Copies planes, one per channel, to the image.
    pub(super) fn write<T: Real>(&self, planes: &[T], image: &mut [T]) {
        let channels = planes.len() / PIXELS;
        for (y, range) in self.rows(channels).enumerate() {
            let row = &mut image[range];
            let plane = |channel: usize| &planes[channel * PIXELS + y * TILE..][..self.tile.extent[0]];
            match channels {
                1 => row.copy_from_slice(plane(0)),
                3 => {
                    let [red, green, blue] = [plane(0), plane(1), plane(2)];
                    let values = red.iter().zip(green).zip(blue);
                    row.as_chunks_mut().0.iter_mut().zip(values).for_each(|(pixel, ((&r, &g), &b))| *pixel = [r, g, b]);
                }
                _ => (0..channels).for_each(|channel| {
                    let pixels = row.chunks_exact_mut(channels).zip(plane(channel));
                    pixels.for_each(|(pixel, &value)| pixel[channel] = value);
                }),
            }
        }
    }

    /// Copies the image to planes, one per channel; pixels outside the image keep their values.
    pub(super) fn read<T: Real>(&self, image: &[T], planes: &mut [T]) {
        let channels = planes.len() / PIXELS;
        for (y, range) in self.rows(channels).enumerate() {
            for (channel, plane) in planes.chunks_exact_mut(PIXELS).enumerate() {
                let pixels = image[range.clone()].chunks_exact(channels);
                plane[y * TILE..].iter_mut().zip(pixels).for_each(|(value, pixel)| *value = pixel[channel]);
            }
        }
    }

    /// The elements of each row of pixels.
    fn rows(&self, channels: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let ([left, top], [columns, rows], width) = (self.tile.origin, self.tile.extent, self.width);
        let first = top - self.first_row;
        (first..first + rows).map(move |y| (y * width + left) * channels..(y * width + left + columns) * channels)
    }
}
