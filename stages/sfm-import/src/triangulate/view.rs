//! A training view, prepared for matching.

use glam::{DVec2, DVec3};
use scene::Camera;
use scene::float_image::{FloatImage, to_byte};

/// Half the side of a patch: seven pixels see enough texture, and little of another depth.
pub(super) const HALF: i32 = 3;
/// Pixels of a patch.
const PATCH: usize = ((2 * HALF + 1) * (2 * HALF + 1)) as usize;
/// Standard deviation of a patch, of 255 grey levels, below which it is noise.
const LEAST_TEXTURE: f32 = 3.0;

/// Grey values of a patch, with mean 0 and length 1.
pub(super) type Patch = [f32; PATCH];

/// A view at the size that is matched.
pub(super) struct View {
    pub(super) camera: Camera,
    color: FloatImage,
    grey: Vec<f32>,
    /// Depth of the nearest and of the farthest point.
    pub(super) depth_view: [f64; 2],
}

impl View {
    pub(super) fn new(camera: Camera, color: FloatImage, depth_view: [f64; 2]) -> Self {
        let luma = |pixel: &[f32]| 255.0 * (0.299 * pixel[0] + 0.587 * pixel[1] + 0.114 * pixel[2]);
        let grey = color.values.chunks_exact(3).map(luma).collect();
        Self { camera, color, grey, depth_view }
    }

    pub(super) fn width(&self) -> u32 {
        self.color.width
    }

    pub(super) fn height(&self) -> u32 {
        self.color.height
    }

    /// The direction in which the camera looks.
    pub(super) fn axis_world(&self) -> DVec3 {
        self.camera.camera_from_world.rotation.transpose().z_axis
    }

    /// The colour of the pixel at a position inside.
    pub(super) fn color_at(&self, pixel: DVec2) -> [u8; 3] {
        let at = 3 * (pixel.y as usize * self.color.width as usize + pixel.x as usize);
        [0, 1, 2].map(|channel| to_byte(self.color.values[at + channel]))
    }

    /// The patch around a pixel position whose columns and rows step by `right` and `down`; `None` if it is not inside
    /// the image or has no texture.
    pub(super) fn patch(&self, center: DVec2, right: DVec2, down: DVec2) -> Option<Patch> {
        let corner = f64::from(HALF) * (right.abs() + down.abs());
        let last = DVec2::new(f64::from(self.color.width), f64::from(self.color.height)) - 1.0;
        let center = center - 0.5; // from the centre of the first pixel
        if !((center - corner).min_element() >= 0.0 && (center + corner).cmplt(last).all()) {
            return None;
        }
        let mut patch = [0.0; PATCH];
        for (index, value) in (0_i32..).zip(&mut patch) {
            let (column, row) = (index % (2 * HALF + 1) - HALF, index / (2 * HALF + 1) - HALF);
            *value = self.grey_at(center + f64::from(column) * right + f64::from(row) * down);
        }
        let mean = patch.iter().sum::<f32>() / PATCH as f32;
        patch.iter_mut().for_each(|value| *value -= mean);
        let length = patch.iter().map(|value| value * value).sum::<f32>().sqrt();
        if !(length >= LEAST_TEXTURE * (PATCH as f32).sqrt()) {
            return None;
        }
        patch.iter_mut().for_each(|value| *value /= length);
        Some(patch)
    }

    /// The interpolated grey value at a position inside, measured from the centre of the first pixel.
    fn grey_at(&self, at: DVec2) -> f32 {
        let width = self.color.width as usize;
        let (column, row) = (at.x as usize, at.y as usize);
        let (tx, ty) = ((at.x - column as f64) as f32, (at.y - row as f64) as f32);
        let first = row * width + column;
        let [a, b, c, d] = [0, 1, width, width + 1].map(|offset| self.grey[first + offset]);
        let (top, bottom) = (a + tx * (b - a), c + tx * (d - c));
        top + ty * (bottom - top)
    }

    /// The world position at a depth behind a pixel position.
    pub(super) fn point(&self, pixel: DVec2, depth_view: f64) -> DVec3 {
        self.camera.unproject(pixel, depth_view)
    }

    /// The appearance in this view of a patch of `from` that is parallel to its image at this depth: its centre, and
    /// the steps of its columns and rows.
    pub(super) fn appearance(&self, from: &Self, pixel: DVec2, depth_view: f64) -> Option<[DVec2; 3]> {
        let seen = |offset: DVec2| Some(self.camera.project(from.point(pixel + offset, depth_view))?.0);
        let center = seen(DVec2::ZERO)?;
        Some([center, seen(DVec2::X)? - center, seen(DVec2::Y)? - center])
    }
}

/// Normalised cross-correlation, from -1 to 1.
pub(super) fn correlation(a: &Patch, b: &Patch) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
