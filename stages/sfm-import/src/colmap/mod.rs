//! COLMAP sparse models: cameras, registered images and points, binary or text.
//!
//! `rigs.bin` and `frames.bin` (COLMAP ≥ 3.12) are not needed, because `images.*` contains every pose. Pixel centres are
//! at (i + 0.5, j + 0.5) and poses map world to camera coordinates with OpenCV's axes, as everywhere in this project.

mod binary;
pub(crate) mod camera_model;
mod capture;
mod fixed_cameras;
mod image_folder;
pub(crate) mod layout;
pub(crate) mod model;
mod model_files;
mod name_gaps;
pub(crate) mod one_instant;
mod places;
mod text;

#[cfg(test)]
pub(crate) use self::text::cameras as text_cameras;
pub(crate) use capture::read;
pub(crate) use model_files::read_model;
