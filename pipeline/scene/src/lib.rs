//! The vocabulary of dynamic scenes: cameras, time, frames, images, depth, flow, masks, clouds and Gaussians, with
//! their standard file formats. Knows no engine, no stage and no GPU.
//!
//! Conventions, everywhere: world and camera axes are right-handed; a camera looks along +z with x right and y down
//! (OpenCV); the centre of pixel (column i, row j) lies at (i + 0.5, j + 0.5); colours are sRGB-encoded in [0, 1];
//! depth is view-space z in scene units; time is in seconds and [`TimeMap`] is the only place that normalises it.

pub mod camera;
pub mod capture;
pub mod cloud;
mod error;
pub mod exr_file;
pub mod facts;
pub mod float_image;
pub mod gaussians;
pub mod image_file;
pub mod index_file;
pub mod mangle;
pub mod maps;
pub mod npy_file;
pub mod ply;
pub mod protocol;
pub mod time;

pub use camera::{Camera, Intrinsics, RigidTransform};
pub use capture::{Capture, CaptureInfo, CaptureWriter, Frame, Split, View};
pub use cloud::PointCloud;
pub use error::{Error, Result};
pub use float_image::{FloatImage, ResizeFilter};
pub use gaussians::Gaussians;
pub use maps::{DepthMap, FlowMap, LabelMap, NormalMap, VelocityMap};
pub use protocol::Protocol;
pub use time::TimeMap;

#[cfg(test)]
mod mangled_files;
