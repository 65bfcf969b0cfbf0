//! What the views of a capture see of the world at rest.

use anyhow::Context as _;
use depth_flow_import::Priors;
use glam::{DVec2, DVec3};
use layer_split::{Layers, Mask};
use scene::image_file::{GrayImage, RgbImage};
use scene::{Camera, Capture, DepthMap};

/// Relative difference of depths that belong to one surface.
pub const SAME_DEPTH: f64 = 0.02;

/// One view, and which of its pixels show the world at rest.
pub struct StillView {
    /// Its camera.
    pub camera: Camera,
    /// Its image.
    pub image: RgbImage,
    /// What moves, with the margin.
    pub moving: Mask,
    /// Its depth, where known.
    pub depth: Option<DepthMap>,
    /// Coverage, where known: 0 is nothing at all, as far as one can see.
    alpha: Option<GrayImage>,
}

impl StillView {
    /// Loads a view; an error where the layers know nothing of it.
    pub fn load(
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

    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.camera.intrinsics.width as usize
    }

    /// The index of the pixel that a position lies in.
    pub fn pixel(&self, position: DVec2) -> Option<usize> {
        let (width, height) = (self.width() as f64, f64::from(self.camera.intrinsics.height));
        let inside = position.x >= 0.0 && position.y >= 0.0 && position.x < width && position.y < height;
        inside.then(|| position.y as usize * self.width() + position.x as usize)
    }

    /// The centre of a pixel.
    pub fn center(&self, pixel: usize) -> DVec2 {
        DVec2::new((pixel % self.width()) as f64 + 0.5, (pixel / self.width()) as f64 + 0.5)
    }

    /// The colour of a pixel.
    pub fn color(&self, pixel: usize) -> [u8; 3] {
        self.image[((pixel % self.width()) as u32, (pixel / self.width()) as u32)].0
    }

    /// The depth of a pixel, where something at rest is seen at a known depth.
    pub fn still_depth(&self, pixel: usize) -> Option<f64> {
        let depth = self.depth.as_ref().map_or(0.0, |depth| depth.depth_view[pixel]);
        (!self.moving.inside[pixel] && depth > 0.0).then_some(f64::from(depth))
    }

    /// Whether this view sees past a point of the world: what it sees there is farther, or nothing at all.
    pub fn sees_past(&self, point_world: DVec3) -> bool {
        let Some((position, z)) = self.camera.project(point_world) else { return false };
        let Some(pixel) = self.pixel(position) else { return false };
        let is_empty = self.alpha.as_ref().is_some_and(|alpha| alpha.as_raw()[pixel] == 0);
        let is_behind = self.still_depth(pixel).is_some_and(|depth| depth > z * (1.0 + SAME_DEPTH));
        (is_empty && !self.moving.inside[pixel]) || is_behind
    }

    /// Whether coverage tells where nothing is.
    pub fn knows_emptiness(&self) -> bool {
        self.alpha.is_some()
    }

    /// The colour at which this view sees a point of a surface at rest, between four pixels; `None` where one of them
    /// moves, or where this view sees something else.
    pub fn color_of(&self, point_world: DVec3) -> Option<[f64; 3]> {
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
            inverse_depth += weight / self.still_depth(pixel)?;
            let here = self.color(pixel);
            color.iter_mut().zip(here).for_each(|(sum, value)| *sum += weight * f64::from(value));
        }
        ((inverse_depth * z - 1.0).abs() <= SAME_DEPTH).then_some(color)
    }

    /// The colour of the pixel in which this view sees a point of a surface at rest; `None` where it sees something else.
    pub fn pixel_color_of(&self, point_world: DVec3) -> Option<[f64; 3]> {
        let (position, z) = self.camera.project(point_world)?;
        let pixel = self.pixel(position)?;
        let is_there = (self.still_depth(pixel)? / z - 1.0).abs() <= SAME_DEPTH;
        is_there.then(|| self.color(pixel).map(f64::from))
    }
}

/// The middle of each channel; of two middle values the lower.
pub fn median_color(mut colors: Vec<[f64; 3]>) -> Option<[u8; 3]> {
    let middle = colors.len().checked_sub(1)? / 2;
    let mut channel = |at: usize| {
        colors.sort_by(|a, b| a[at].total_cmp(&b[at]));
        (colors[middle][at] + 0.5) as u8
    };
    Some([channel(0), channel(1), channel(2)])
}
