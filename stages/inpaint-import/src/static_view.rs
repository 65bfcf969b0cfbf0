//! The static scene as the views of a capture show it.

use anyhow::Context as _;
use depth_flow_import::Priors;
use glam::{DVec2, DVec3};
use layer_split::Layers;
use scene::image_file::{GrayImage, RgbImage};
use scene::{Camera, Capture, DepthMap, Mask, pixels};

/// Largest relative difference of depths on one surface.
pub(crate) const SAME_DEPTH: f64 = 0.02;

/// One view, with a mask of the pixels that do not show the static scene.
pub(crate) struct StaticView {
    /// The camera of the view.
    pub(crate) camera: Camera,
    /// The image of the view.
    pub(crate) image: RgbImage,
    /// Moving pixels, dilated by the margin.
    pub(crate) moving: Mask,
    /// View-space depth, if known.
    pub(crate) depth: Option<DepthMap>,
    /// Coverage, if known: 0 where the ray of a pixel hits nothing.
    alpha: Option<GrayImage>,
}

impl StaticView {
    /// Loads a view, which must have a mask.
    pub(crate) fn load(
        capture: &Capture,
        layers: &Layers,
        priors: Option<&Priors>,
        index: usize,
        margin_px: u32,
    ) -> anyhow::Result<Self> {
        let view = &capture.views[index];
        let moving = layers.load_moving(index)?.with_context(|| format!("view {} has no mask", view.name))?;
        let depth = match priors {
            Some(priors) => priors.load_depth(index)?,
            None => capture.load_depth(view)?,
        };
        Ok(Self {
            camera: view.camera,
            image: capture.load_image(view)?,
            moving: Mask::from(&moving).dilated(margin_px),
            depth,
            alpha: capture.load_alpha(view)?,
        })
    }

    /// Row-major index of the pixel that contains a position, if it lies inside the image.
    pub(crate) fn pixel(&self, position: DVec2) -> Option<usize> {
        pixels::index_at(position, self.camera.intrinsics.width, self.camera.intrinsics.height)
    }

    /// Centre of a pixel.
    pub(crate) fn center(&self, pixel: usize) -> DVec2 {
        pixels::center(pixel, self.camera.intrinsics.width)
    }

    /// Colour of a pixel.
    pub(crate) fn color(&self, pixel: usize) -> [u8; 3] {
        let width = self.camera.intrinsics.width as usize;
        self.image[((pixel % width) as u32, (pixel / width) as u32)].0
    }

    /// Depth of a pixel, if it is static and its depth is known.
    pub(crate) fn static_depth(&self, pixel: usize) -> Option<f64> {
        let depth = self.depth.as_ref().map_or(0.0, |depth| depth.depth_view[pixel]);
        (!self.moving.inside[pixel] && depth > 0.0).then_some(f64::from(depth))
    }

    /// Whether this view sees past a world point, i.e. it shows something static behind it or nothing at all.
    pub(crate) fn sees_past(&self, point_world: DVec3) -> bool {
        let Some((position, z)) = self.camera.project(point_world) else { return false };
        let Some(pixel) = self.pixel(position) else { return false };
        let is_empty = self.alpha.as_ref().is_some_and(|alpha| alpha.as_raw()[pixel] == 0);
        let is_behind = self.static_depth(pixel).is_some_and(|depth| depth > z * (1.0 + SAME_DEPTH));
        (is_empty && !self.moving.inside[pixel]) || is_behind
    }

    /// Whether the view has coverage, which marks empty rays.
    pub(crate) fn knows_emptiness(&self) -> bool {
        self.alpha.is_some()
    }

    /// The colour of a point on a static surface, interpolated between four pixels; `None` if one of them moves or the
    /// view shows another surface there.
    pub(crate) fn color_of(&self, point_world: DVec3) -> Option<[f64; 3]> {
        let (position, z) = self.camera.project(point_world)?;
        let low = (position - 0.5).floor();
        let share = position - 0.5 - low;
        let corner = |right: f64, down: f64| self.pixel(low + DVec2::new(right + 0.5, down + 0.5));
        let pixels = [corner(0.0, 0.0)?, corner(1.0, 0.0)?, corner(0.0, 1.0)?, corner(1.0, 1.0)?];
        let weights = [
            (1.0 - share.x) * (1.0 - share.y),
            share.x * (1.0 - share.y),
            (1.0 - share.x) * share.y,
            share.x * share.y,
        ];
        let mut inverse_depth = 0.0;
        let mut color = [0.0; 3];
        for (pixel, weight) in pixels.into_iter().zip(weights) {
            inverse_depth += weight / self.static_depth(pixel)?;
            let here = self.color(pixel);
            color.iter_mut().zip(here).for_each(|(sum, value)| *sum += weight * f64::from(value));
        }
        ((inverse_depth * z - 1.0).abs() <= SAME_DEPTH).then_some(color)
    }

    /// The colour of the pixel that shows a point on a static surface; `None` if the view shows something else there.
    pub(crate) fn pixel_color_of(&self, point_world: DVec3) -> Option<[f64; 3]> {
        let (position, z) = self.camera.project(point_world)?;
        let pixel = self.pixel(position)?;
        let is_same = (self.static_depth(pixel)? / z - 1.0).abs() <= SAME_DEPTH;
        is_same.then(|| self.color(pixel).map(f64::from))
    }
}

/// The lower median of each channel; `None` for no colours.
pub(crate) fn median_color(mut colors: Vec<[f64; 3]>) -> Option<[u8; 3]> {
    let middle = colors.len().checked_sub(1)? / 2;
    let mut channel = |at: usize| {
        colors.sort_by(|a, b| a[at].total_cmp(&b[at]));
        (colors[middle][at] + 0.5) as u8
    };
    Some([channel(0), channel(1), channel(2)])
}
