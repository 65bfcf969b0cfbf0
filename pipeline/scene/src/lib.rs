//! The vocabulary of dynamic scenes: cameras, time, frames, images, depth, flow, masks, clouds and Gaussians, with
//! their standard file formats. Knows no engine, no stage and no GPU.
//!
//! Conventions, everywhere: world and camera axes are right-handed; a camera looks along +z with x right and y down
//! (OpenCV); the centre of pixel (column i, row j) lies at (i + 0.5, j + 0.5); colours are sRGB-encoded in [0, 1];
//! depth is view-space z in scene units; time is in seconds and [`TimeMap`] is the only place that normalises it.

pub mod camera;
pub mod capture;
mod error;
pub mod gaussians;
pub mod protocol;
pub mod time;

pub use camera::{Camera, Intrinsics, RigidTransform};
pub use capture::{Capture, CaptureWriter, Split, View};
pub use error::{Error, Result};
pub use gaussians::Gaussians;
pub use protocol::Protocol;
pub use time::TimeMap;
