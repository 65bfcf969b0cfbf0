//! Imports captures whose poses somebody else has computed: D-NeRF/Blender `transforms_*.json`, COLMAP sparse
//! models, the folders of Nerfies, HyperNeRF and DyCheck, and the rigs of Neural 3D Video become the one
//! [`scene::Capture`].
//!
//! A reader ([`blender`], [`colmap`], [`nerfies`], [`n3v`]) turns files into a [`source::SourceCapture`]: posed, timed, split
//! frames, without touching a pixel. [`source::SourceCapture::problems`] lists everything that is wrong with it; [`run`] refuses it or
//! converts the pixels, and [`inspect`] tells a person.

pub mod blender;
pub mod colmap;
mod facts;
pub mod inspect;
pub mod lens;
pub mod n3v;
pub mod nerfies;
pub mod params;
mod pixels;
mod recognise;
mod run;
pub mod source;
mod split;
#[cfg(test)]
mod tests;

pub use params::Params;
pub use run::{SfmImport, import};
