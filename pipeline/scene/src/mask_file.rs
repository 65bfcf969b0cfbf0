//! Files of masks: the rule by which imports, `layer-split` and `prepare` read them.

use std::collections::BTreeSet;
use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, GrayImage, ImageBuffer, ImageResult, Luma, Rgba};

use crate::image_file;

/// Maximum number of distinct colours of instances in the masks of a capture; more are taken for blurred edges.
const MAX_INSTANCES: usize = 16;
/// Alpha from which a pixel of a cut-out is inside.
const HALF_ALPHA: u8 = 128;
/// Share of set pixels above which masks with names of COLMAP's, e.g. `a.jpg.png`, mark what is static, and others are
/// refused by `prepare`.
pub const MOSTLY_SET: f64 = 0.5;

/// A decoded mask.
pub struct MaskFile {
    /// \[H, W\]: 0 outside. The index of a PNG with a palette of colours, which tools for segmentation write; the alpha of an
    /// image with transparent pixels, 0 below one half; otherwise the brightest channel, because masks may have any colour.
    pub levels: GrayImage,
    /// \[H, W\]: 0 outside; the index, or the brightness of the colour, which differs between instances.
    pub labels: GrayImage,
    /// Different colours inside, at most one more than [`MAX_INSTANCES`]; none for indices, which have no edges to blur.
    colors: BTreeSet<[u8; 3]>,
}

impl MaskFile {
    /// Decodes a file. A palette of greys stands for its grey levels.
    pub fn read(path: &Path) -> ImageResult<Self> {
        match palette_indices(&std::fs::read(path)?) {
            Some(indices) => Ok(Self { levels: indices.clone(), labels: indices, colors: BTreeSet::new() }),
            None => Ok(Self::of_image(&image_file::decode(path)?)),
        }
    }

    fn of_image(image: &DynamicImage) -> Self {
        if let DynamicImage::ImageLuma16(wide) = image {
            return Self::of_image(&narrow(wide).into());
        }
        let (pixels, mut labels) = (image.to_rgba8(), image.to_luma8());
        let is_cut_out = pixels.pixels().any(|pixel| pixel[3] != 255);
        let level = |pixel: &Rgba<u8>| match is_cut_out {
            // The edge of a cut-out is soft whether its subject has few colours or many.
            true if pixel[3] < HALF_ALPHA => 0,
            true => pixel[3],
            false => pixel[0].max(pixel[1]).max(pixel[2]),
        };
        let (mut colors, mut previous) = (BTreeSet::new(), None);
        for (pixel, label) in pixels.pixels().zip(labels.iter_mut()) {
            let is_inside = level(pixel) > 0;
            // The brightness of a dark colour may be rounded to 0.
            *label = if is_inside { (*label).max(1) } else { 0 };
            let color = [pixel[0], pixel[1], pixel[2]];
            // Neighbours are mostly equal.
            if is_inside && previous != Some(color) && colors.len() <= MAX_INSTANCES {
                colors.insert(color);
                previous = Some(color);
            }
        }
        let at = |x: u32, y: u32| Luma([level(pixels.get_pixel(x, y))]);
        Self { levels: GrayImage::from_fn(pixels.width(), pixels.height(), at), labels, colors }
    }
}

/// A mask of 16 bits in 8 bits. Few different values are numbers of instances, e.g. 1001 and 1002, and stay different; so do
/// values up to 255. Others are levels.
fn narrow(wide: &ImageBuffer<Luma<u16>, Vec<u16>>) -> GrayImage {
    let values: BTreeSet<u16> = wide.iter().copied().collect();
    let max = values.last().copied().unwrap_or(0);
    let is_index = max <= 255 || values.len() <= MAX_INSTANCES;
    let byte = |value: u16| match value {
        0 => 0,
        value if is_index => ((value - 1) % 255 + 1) as u8,
        // 65535 / 255 = 257. A faint level is not 0.
        value => (value.div_ceil(257)) as u8,
    };
    GrayImage::from_fn(wide.width(), wide.height(), |x, y| Luma([byte(wide.get_pixel(x, y)[0])]))
}

/// The values in all masks of a capture, which decide together how each mask is read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MaskValues {
    /// The different levels.
    pub levels: BTreeSet<u8>,
    /// The different labels.
    pub labels: BTreeSet<u8>,
    colors: BTreeSet<[u8; 3]>,
}

impl MaskValues {
    /// Adds the values of a mask.
    pub fn add(&mut self, file: &MaskFile) {
        self.levels.extend(different(&file.levels));
        self.labels.extend(different(&file.labels));
        self.colors.extend(&file.colors);
    }

    /// The values in this or in other masks.
    pub fn and(mut self, other: Self) -> Self {
        self.levels.extend(other.levels);
        self.labels.extend(other.labels);
        self.colors.extend(other.colors);
        self
    }

    /// Whether the masks have blurred edges, and thus only one instance.
    pub fn is_blurred(&self) -> bool {
        self.colors.len() > MAX_INSTANCES
    }

    /// The least level of pixels that are set: half of the largest one if edges are blurred, otherwise 1.
    pub fn least_level(&self) -> u8 {
        match self.levels.last() {
            Some(largest) if self.is_blurred() => largest.div_ceil(2),
            _ => 1,
        }
    }
}

/// The values in an image, sorted.
fn different(image: &GrayImage) -> impl Iterator<Item = u8> {
    let mut is_present = [false; 256];
    image.iter().for_each(|value| is_present[usize::from(*value)] = true);
    (0..=255).filter(move |value| is_present[usize::from(*value)])
}

/// The indices of a PNG with a palette of colours; none for any other or a damaged file.
fn palette_indices(bytes: &[u8]) -> Option<GrayImage> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().ok()?;
    let palette = reader.info().palette.as_ref().filter(|_| reader.info().color_type == png::ColorType::Indexed)?;
    if palette.chunks_exact(3).all(|color| color[0] == color[1] && color[1] == color[2]) {
        return None;
    }
    let mut rows = vec![0; reader.output_buffer_size()?];
    let frame = reader.next_frame(&mut rows).ok()?;
    let bits = frame.bit_depth as usize;
    let index = |row: &[u8], x: usize| {
        let first = x * bits;
        row[first / 8] >> (8 - bits - first % 8) & (0xff >> (8 - bits)) as u8
    };
    let indices =
        rows.chunks_exact(frame.line_size).flat_map(|row| (0..frame.width as usize).map(move |x| index(row, x)));
    GrayImage::from_raw(frame.width, frame.height, indices.collect())
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage, RgbaImage};

    use super::*;

    /// A ramp of a colour, from nothing to all of it, over 201 columns.
    fn ramp([red, green, blue]: [u8; 3]) -> DynamicImage {
        let part = |channel: u8, x: u32| (u32::from(channel) * x / 200) as u8;
        RgbImage::from_fn(201, 2, |x, _| Rgb([part(red, x), part(green, x), part(blue, x)])).into()
    }

    fn read(image: &DynamicImage) -> MaskFile {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mask.png");
        image.save(&path).unwrap();
        MaskFile::read(&path).unwrap()
    }

    fn values_of(file: &MaskFile) -> MaskValues {
        let mut values = MaskValues::default();
        values.add(file);
        values
    }

    #[test]
    fn blurred_masks_of_any_colour_are_halved_at_half_their_maximum() {
        for color in [[255; 3], [128, 0, 0], [0, 128, 0], [0, 0, 40], [255, 0, 0]] {
            let file = read(&ramp(color));
            let values = values_of(&file);
            assert!(values.is_blurred(), "{color:?}");
            let set = file.levels.iter().filter(|level| **level >= values.least_level()).count() / 2;
            assert!((97..=101).contains(&set), "{color:?}: {set} of 201 columns");
        }
    }

    #[test]
    fn instances_of_different_colours_have_different_labels() {
        let colors = [[0, 0, 0], [128, 0, 0], [0, 128, 0], [0, 0, 1]];
        let file = read(&RgbImage::from_fn(4, 1, |x, _| Rgb(colors[x as usize])).into());
        assert_eq!((file.labels.as_raw()[0], values_of(&file).labels.len()), (0, colors.len()));
        assert_eq!(file.levels.as_raw(), &[0, 128, 128, 1]);
        let values = values_of(&file);
        assert_eq!((values.is_blurred(), values.least_level()), (false, 1));
    }

    #[test]
    fn masks_of_16_bits_keep_their_instances() {
        let labels = |values: &[u16]| {
            let wide = ImageBuffer::from_fn(values.len() as u32, 1, |x, _| Luma([values[x as usize]]));
            let file = read(&DynamicImage::ImageLuma16(wide));
            assert!(!values_of(&file).is_blurred());
            file.labels.into_raw()
        };
        assert_eq!(labels(&[0, 1, 2, 3]), [0, 1, 2, 3]);
        assert_eq!(labels(&[0, 65535]), [0, 255], "white");
        let ids = labels(&[0, 1001, 1002, 2001]);
        assert_eq!((ids[0], ids.iter().collect::<BTreeSet<_>>().len()), (0, 4), "{ids:?}");
        assert_eq!(labels(&[0, 1002])[1], ids[2], "the same in each mask");
        // A soft matte has levels.
        let wide = ImageBuffer::from_fn(201, 2, |x, _| Luma([(x * 65535 / 200) as u16]));
        let matte = read(&DynamicImage::ImageLuma16(wide));
        let values = values_of(&matte);
        let set = matte.levels.iter().filter(|level| **level >= values.least_level()).count() / 2;
        assert!(values.is_blurred() && (97..=102).contains(&set), "{set}");
    }

    #[test]
    fn the_alpha_of_a_cut_out_is_its_mask() {
        let photo = |x: u32, y: u32, alpha: u8| Rgba([(10 * x) as u8, (20 * y) as u8, 200, alpha]);
        let cut_out = RgbaImage::from_fn(9, 9, |x, y| photo(x, y, if x < 5 { 255 } else { 0 }));
        let file = read(&cut_out.into());
        assert!(file.levels.enumerate_pixels().all(|(x, _, level)| level[0] == if x < 5 { 255 } else { 0 }));
        assert!(values_of(&file).is_blurred(), "a photograph has no instances");
        // A black silhouette is inside, too.
        let silhouette = RgbaImage::from_fn(4, 1, |x, _| Rgba([0, 0, 0, if x == 1 { 255 } else { 0 }]));
        assert_eq!(read(&silhouette.into()).labels.as_raw(), &[0, 1, 0, 0]);
        // The soft edge of a silhouette is halved, and haze is outside.
        let soft = RgbaImage::from_fn(4, 1, |x, _| Rgba([0, 0, 0, [3, 60, 200, 255][x as usize]]));
        let soft = read(&soft.into());
        assert_eq!(
            (soft.levels.as_raw().as_slice(), soft.labels.as_raw().as_slice()),
            (&[0, 0, 200, 255][..], &[0, 0, 1, 1][..])
        );
        assert_eq!(values_of(&soft).least_level(), 1);
        // Without transparent pixels, alpha says nothing.
        let opaque = RgbaImage::from_fn(4, 1, |x, _| Rgba([0, if x == 1 { 9 } else { 0 }, 0, 255]));
        assert_eq!(read(&opaque.into()).levels.as_raw(), &[0, 9, 0, 0]);
    }
}
