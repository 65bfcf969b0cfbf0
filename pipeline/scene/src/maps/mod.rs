//! Per-pixel maps other than colour: depth, optical flow, velocity, normals and instance labels.
//!
//! The map types read and write the formats of artifacts (EXR and PNG). [`formats`] decodes the files of estimators,
//! [`fit_to_view`] resamples them, [`DepthKind`] and [`alignment`] bring depth to the scale of the scene.

pub mod alignment;
mod depth_kind;
pub mod formats;
mod resampling;
mod rigid_flow;

pub use depth_kind::DepthKind;
pub use resampling::fit_to_view;

use std::path::Path;

use crate::image_file::{self, GrayImage};
use crate::{Error, Result, exr_file};

/// A depth in files beyond this many scene units means that the ray hit nothing: Blender writes 1e10, and half floats end at
/// 65504.
pub const NO_HIT_DEPTH: f64 = 6.5e4;

/// View-space depth per pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthMap {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// [H, W] view-space z in scene units; 0 where unknown.
    pub depth_view: Vec<f32>,
}

/// Optical flow: the displacement of every pixel to another frame.
#[derive(Clone, Debug, Default)]
pub struct FlowMap {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// [H, W] displacements (right, down) in pixels; NaN where unknown or without a counterpart.
    pub flow_px: Vec<[f32; 2]>,
}

/// 3D velocity of the surface point that each pixel shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VelocityMap {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// [H, W] velocities (x, y, z), world, in scene units per second; 0 where the pixel shows no surface.
    pub velocity_world: Vec<[f32; 3]>,
}

/// Normal of the surface point that each pixel shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NormalMap {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// [H, W] unit vectors (right, down, forward) in the camera's frame, facing the camera; 0 where unknown.
    pub normals_view: Vec<[f32; 3]>,
}

/// Instance label per pixel; 0 is the static background.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LabelMap {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// [H, W] labels.
    pub labels: Vec<u8>,
}

/// Channel names of vector maps.
const VECTOR_CHANNELS: [&str; 3] = ["X", "Y", "Z"];

impl DepthMap {
    /// Accepted names of the depth channel, most specific first.
    pub const CHANNELS: [&str; 4] = ["Z", "depth.Z", "Y", "R"];

    /// The depth of a pixel; `None` where it is unknown.
    pub fn known(&self, pixel: usize) -> Option<f64> {
        let depth = self.depth_view[pixel];
        (depth > 0.0 && depth.is_finite()).then_some(depth.into())
    }

    /// Reads an EXR file. Values that are negative or not finite are an error.
    pub fn read(path: &Path) -> Result<Self> {
        let image = exr_file::read(path)?;
        let depth_view = image.channel(&Self::CHANNELS).ok_or_else(|| no_channel(&Self::CHANNELS, path))?.to_vec();
        if let Some(value) = depth_view.iter().find(|value| !(**value >= 0.0 && value.is_finite())) {
            let error =
                Error::new(format!("depth {value} is not a distance")).hint("store 0 where the depth is unknown");
            return Err(error.at(path));
        }
        Ok(Self { width: image.width, height: image.height, depth_view })
    }

    /// Writes an EXR file with the channel Z.
    pub fn write(&self, path: &Path) -> Result<()> {
        exr_file::write(path, self.width, self.height, &[("Z", self.depth_view.clone())])
    }
}

impl FlowMap {
    /// Accepted names of the x and y channels.
    pub const CHANNELS: [[&str; 4]; 2] = [["X", "u", "R", "forward.u"], ["Y", "v", "G", "forward.v"]];

    /// Reads an EXR file. NaN marks unknown flow; infinite values are an error.
    pub fn read(path: &Path) -> Result<Self> {
        let image = exr_file::read(path)?;
        let [x, y] = Self::CHANNELS.map(|names| image.channel(&names).ok_or_else(|| no_channel(&names, path)));
        let flow_px: Vec<_> = x?.iter().zip(y?).map(|(x, y)| [*x, *y]).collect();
        if flow_px.iter().flatten().any(|value| value.is_infinite()) {
            return Err(Error::new("the flow is infinite").hint("store NaN where the flow is unknown").at(path));
        }
        Ok(Self { width: image.width, height: image.height, flow_px })
    }

    /// Writes an EXR file with the channels X and Y.
    pub fn write(&self, path: &Path) -> Result<()> {
        let channel = |axis: usize| self.flow_px.iter().map(|flow| flow[axis]).collect();
        exr_file::write(path, self.width, self.height, &[("X", channel(0)), ("Y", channel(1))])
    }
}

impl VelocityMap {
    /// Channel names.
    pub const CHANNELS: [&str; 3] = VECTOR_CHANNELS;

    /// Reads an EXR file with the channels X, Y and Z. Values that are not finite are an error.
    pub fn read(path: &Path) -> Result<Self> {
        let (width, height, velocity_world) = read_vectors(path, "velocity")?;
        Ok(Self { width, height, velocity_world })
    }

    /// Writes an EXR file with the channels X, Y and Z.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_vectors(path, self.width, self.height, &self.velocity_world)
    }
}

impl NormalMap {
    /// Channel names.
    pub const CHANNELS: [&str; 3] = VECTOR_CHANNELS;

    /// Reads an EXR file with the channels X, Y and Z. Values that are not finite are an error.
    pub fn read(path: &Path) -> Result<Self> {
        let (width, height, normals_view) = read_vectors(path, "normal")?;
        Ok(Self { width, height, normals_view })
    }

    /// Writes an EXR file with the channels X, Y and Z.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_vectors(path, self.width, self.height, &self.normals_view)
    }
}

/// Reads width, height and finite vectors of an EXR file with the channels X, Y and Z.
fn read_vectors(path: &Path, what: &str) -> Result<(u32, u32, Vec<[f32; 3]>)> {
    let image = exr_file::read(path)?;
    let [x, y, z] = VECTOR_CHANNELS.map(|name| image.channel(&[name]).ok_or_else(|| no_channel(&[name], path)));
    let vectors: Vec<_> = x?.iter().zip(y?).zip(z?).map(|((x, y), z)| [*x, *y, *z]).collect();
    if !vectors.iter().flatten().all(|value| value.is_finite()) {
        return Err(Error::new(format!("the {what} is not finite")).at(path));
    }
    Ok((image.width, image.height, vectors))
}

/// Writes an EXR file with the channels X, Y and Z.
fn write_vectors(path: &Path, width: u32, height: u32, vectors: &[[f32; 3]]) -> Result<()> {
    let channel = |axis: usize| vectors.iter().map(|vector| vector[axis]).collect();
    let channels = [0, 1, 2].map(|axis| (VECTOR_CHANNELS[axis], channel(axis)));
    exr_file::write(path, width, height, &channels)
}

impl LabelMap {
    /// Reads an 8-bit grey PNG.
    pub fn read(path: &Path) -> Result<Self> {
        let image = image_file::read_grey(path)?;
        Ok(Self { width: image.width(), height: image.height(), labels: image.into_raw() })
    }

    /// Writes an 8-bit grey PNG.
    pub fn write(&self, path: &Path) -> Result<()> {
        let image = GrayImage::from_raw(self.width, self.height, self.labels.clone());
        let sizes = || format!("{} labels for {}×{} pixels", self.labels.len(), self.width, self.height);
        image_file::write_grey(path, &image.ok_or_else(|| Error::new(sizes()).at(path))?)
    }
}

/// The error for an EXR file without any of the accepted channel names.
fn no_channel(names: &[&str], path: &Path) -> Error {
    Error::new(format!("the EXR image has no channel {}", names.join(" or "))).at(path)
}
