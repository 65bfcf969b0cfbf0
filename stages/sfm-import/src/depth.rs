//! Depth maps that are part of a capture, e.g. from a depth sensor.

use std::path::{Path, PathBuf};

use image::{ColorType, ImageDecoder, ImageReader};
use scene::maps::formats::{self, Content};
use scene::maps::{NO_HIT_DEPTH, fit_to_view};
use scene::{DepthMap, FloatImage, Intrinsics};

use crate::error::{Result, bad, invalid};
use crate::lens::{Lens, plane_point};
use crate::video_maps::StoredDepth;

/// Scene units per unit of an integer or NumPy file: millimetres for scenes in metres (nerfstudio's default).
const MILLIMETRE: f64 = 1e-3;

/// A file of view-space z.
#[derive(Clone, Debug)]
pub(crate) struct DepthFile {
    /// Where it lies.
    pub(crate) path: PathBuf,
    /// Scene units per stored unit.
    pub(crate) units_per_value: f64,
    /// The map, if the file holds those of a whole video.
    stored: Option<StoredDepth>,
    /// The pinhole of the map, if it is not the lens of the image.
    pinhole: Option<Intrinsics>,
}

impl DepthFile {
    /// A file with the stated unit, or else that of its format: scene units for EXR and PFM, millimetres otherwise.
    pub(crate) fn new(path: PathBuf, unit: Option<f64>) -> Self {
        let is_float = path
            .extension()
            .is_some_and(|extension| ["exr", "pfm"].iter().any(|float| extension.eq_ignore_ascii_case(float)));
        Self {
            path,
            units_per_value: unit.unwrap_or(if is_float { 1.0 } else { MILLIMETRE }),
            stored: None,
            pinhole: None,
        }
    }

    /// Sets the pinhole of the map, which shares the pose of the image; `None`: the map has the lens of the image.
    pub(crate) fn with_pinhole(self, pinhole: Option<Intrinsics>) -> Self {
        Self { pinhole, ..self }
    }

    /// A map in scene units among those of a whole video.
    pub(crate) fn stored(path: PathBuf, stored: StoredDepth) -> Self {
        Self { path, units_per_value: 1.0, stored: Some(stored), pinhole: None }
    }

    /// Samples the map at the nearest pixel for the pinhole `target` of the undistorted image, at `size`: a mean across an
    /// edge would lie on neither surface. Depths that are 0, not finite or beyond any scene are unknown (0), and so is what the map
    /// does not show.
    pub(crate) fn read(&self, lens: &Lens, target: &Intrinsics, size: (u32, u32)) -> Result<DepthMap> {
        let blame = |error: scene::Error| invalid(error).at(&self.path);
        let values = match &self.stored {
            Some(stored) => stored.read().map_err(|failure| failure.at(&self.path))?,
            None => formats::read(&self.path, Content::Depth).map_err(blame)?,
        };
        let (values, lens) = match self.pinhole {
            None => (fit_to_view(values, &lens.intrinsics, &self.path).map_err(blame)?.0, *lens),
            Some(pinhole) => (self.of_size(values, &pinhole)?, Lens::pinhole(pinhole)),
        };
        let (width, height) = size;
        let scaled = target.resized(width, height);
        let mut depth_view = Vec::with_capacity(width as usize * height as usize);
        for row in 0..height {
            for column in 0..width {
                let pixel = lens.pixel(plane_point(&scaled, column, row));
                let shown = |at: f64, length: u32| (at >= 0.0 && at < f64::from(length)).then_some(at as usize);
                let place = shown(pixel.x, values.width).zip(shown(pixel.y, values.height));
                let value = place.map_or(0.0, |(x, y)| values.values[y * values.width as usize + x]);
                depth_view.push(self.scene_units(value)?);
            }
        }
        Ok(DepthMap { width, height, depth_view })
    }

    /// A map that must have the size of its pinhole.
    fn of_size(&self, values: FloatImage, pinhole: &Intrinsics) -> Result<FloatImage> {
        if (values.width, values.height) == (pinhole.width, pinhole.height) {
            return Ok(values);
        }
        let found = format!("{}×{}", values.width, values.height);
        let message = format!("the depth map is {found}, but {}×{} is expected", pinhole.width, pinhole.height);
        Err(bad(message).hint("all depth maps of a capture need the size of the first one").at(&self.path))
    }

    fn scene_units(&self, value: f32) -> Result<f32> {
        let depth = f64::from(value) * self.units_per_value;
        match depth {
            depth if depth < 0.0 => Err(bad(format!("depth {value} is not a distance")).at(&self.path)),
            depth if depth <= NO_HIT_DEPTH => Ok(depth as f32),
            _ => Ok(0.0),
        }
    }
}

/// Whether a file is an 8-bit PNG, e.g. a preview written by Blender: its values have no scale.
pub(crate) fn is_preview(path: &Path) -> bool {
    let is_png = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    let reader = || ImageReader::open(path).ok()?.with_guessed_format().ok()?.into_decoder().ok();
    is_png && reader().is_some_and(|decoder| decoder.color_type() != ColorType::L16)
}
