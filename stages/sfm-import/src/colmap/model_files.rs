//! The files of a sparse model.

use std::path::Path;

use crate::colmap::model::Model;
use crate::colmap::{binary, text};
use crate::error::Result;

/// Reads `cameras`, `images` and `points3D`: `.bin` files if `cameras.bin` exists, otherwise `.txt` files. A model
/// without registered images or with dangling ids is refused.
pub(crate) fn read_model(sparse_dir: &Path) -> Result<Model> {
    let is_binary = sparse_dir.join("cameras.bin").is_file();
    let path = |name: &str| sparse_dir.join(format!("{name}.{}", if is_binary { "bin" } else { "txt" }));
    let (cameras, images, points) = (path("cameras"), path("images"), path("points3D"));
    let model = if is_binary {
        Model {
            cameras: binary::cameras(&cameras)?,
            images: binary::images(&images)?,
            points: binary::points(&points)?,
        }
    } else {
        Model { cameras: text::cameras(&cameras)?, images: text::images(&images)?, points: text::points(&points)? }
    };
    model.check_images().map_err(|failure| failure.at(images))?;
    model.check_points().map_err(|failure| failure.at(points))?;
    Ok(model)
}
