#![doc = include_str!("../README.md")]

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
mod inner_box;
pub mod maps;
mod mask;
pub mod mask_file;
pub mod npy_file;
pub mod pixels;
pub mod ply;
pub mod point_tree;
pub mod protocol;
pub mod statistics;
pub mod time;
mod videos;
mod view_folder;

pub use camera::{Camera, Intrinsics, RigidTransform};
pub use capture::{Capture, CaptureInfo, CaptureWriter, Frame, SceneScale, Split, View};
pub use cloud::PointCloud;
pub use error::{Error, Result};
pub use float_image::{FloatImage, ResizeFilter};
pub use gaussians::Gaussians;
pub use inner_box::inner_box;
pub use maps::{DepthMap, FlowMap, LabelMap, NormalMap, VelocityMap};
pub use mask::Mask;
pub use protocol::Protocol;
pub use time::TimeMap;
pub use videos::Videos;
pub use view_folder::{MatchedFiles, Naming, ViewFolder, canonical, matched_names};

#[cfg(test)]
mod damaged_files_tests;
