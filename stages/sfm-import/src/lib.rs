#![doc = include_str!("../README.md")]

mod applied;
mod blender;
mod bounds;
mod cloud_file;
mod colmap;
mod depth;
mod depth_cloud;
mod depth_video;
mod easy_volcap;
mod error;
mod estimators;
mod facts;
mod files;
mod foreign;
mod frame_image;
mod image_names;
mod immersive;
pub mod inspect;
mod lens;
mod llff;
mod matrices;
mod n3v;
mod nerfies;
mod nerfstudio;
mod number_lines;
mod nvidia;
mod panoptic;
mod params;
mod pixels;
mod poses_bounds;
mod recognise;
mod rig;
mod run;
mod scannet;
mod source;
mod split;
mod stored_image;
mod technicolor;
#[cfg(test)]
mod tests;
mod transforms;
mod triangulate;
mod tum;
mod video_maps;

pub use params::{Background, Format, Params, Resize, TestSplit};
pub use run::{SfmImport, import};
