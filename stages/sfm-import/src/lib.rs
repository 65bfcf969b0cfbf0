#![doc = include_str!("../README.md")]

mod applied;
mod blender;
mod bounds;
mod cloud_file;
mod colmap;
mod depth;
mod error;
mod facts;
mod files;
mod foreign;
mod image_names;
pub mod inspect;
mod lens;
mod n3v;
mod nerfies;
mod nerfstudio;
mod params;
mod pixels;
mod recognise;
mod run;
mod source;
mod split;
#[cfg(test)]
mod tests;
mod transforms;

pub use params::{Background, Format, Params, Resize, TestSplit};
pub use run::{SfmImport, import};
