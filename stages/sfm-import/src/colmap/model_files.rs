//! The files of a sparse model.

use std::collections::BTreeMap;
use std::path::Path;

use engine::{Failure, FailureKind};
use glam::DVec3;
use scene::PointCloud;

use crate::colmap::model::{Model, Point};
use crate::colmap::{binary, text};
use crate::error::{Result, invalid};

/// Names of clouds that exporters of DUSt3R, MASt3R and VGGT write next to or in place of `points3D`.
const CLOUDS: [&str; 2] = ["points3D.ply", "points.ply"];

/// Reads `cameras`, `images` and `points3D`: `.bin` files if `cameras.bin` exists, otherwise `.txt` files. In place of
/// `points3D`, points are read from a PLY file, or there are none. A model without registered images or with dangling ids
/// is refused.
pub(crate) fn read_model(sparse_dir: &Path) -> Result<Model> {
    let is_binary = is_binary(sparse_dir);
    let path = |name: &str| sparse_dir.join(format!("{name}.{}", if is_binary { "bin" } else { "txt" }));
    let (cameras, images, points) = (path("cameras"), path("images"), path("points3D"));
    let (cameras, mut registered) = if is_binary {
        (binary::cameras(&cameras).map_err(complete)?, binary::images(&images).map_err(complete)?)
    } else {
        (text::cameras(&cameras).map_err(complete)?, text::images(&images).map_err(complete)?)
    };
    let has_tracks = points.is_file();
    let cloud = match (has_tracks, is_binary) {
        (true, true) => binary::points(&points)?,
        (true, false) => text::points(&points)?,
        (false, _) => {
            let observations = registered.values_mut().flat_map(|image| &mut image.observations);
            observations.for_each(|(_, point)| *point = None);
            ply_points(sparse_dir)?
        }
    };
    let model = Model { cameras, images: registered, points: cloud };
    model.check_images().map_err(|failure| failure.at(images))?;
    model.check_points().map_err(|failure| failure.at(points))?;
    Ok(model)
}

/// Whether the files of a model that count are the binary ones.
fn is_binary(sparse_dir: &Path) -> bool {
    sparse_dir.join("cameras.bin").is_file()
}

/// The number of registered images that a model states; 0 if its file of images cannot be read.
pub(crate) fn registered_count(sparse_dir: &Path) -> usize {
    if is_binary(sparse_dir) {
        binary::image_count(&sparse_dir.join("images.bin"))
    } else {
        text::image_count(&sparse_dir.join("images.txt"))
    }
}

/// Adds a hint to a missing file.
fn complete(failure: Failure) -> Failure {
    match failure.kind {
        FailureKind::MissingData => {
            failure.hint("a COLMAP model has cameras and images, as .bin or .txt; only points3D may be missing")
        }
        _ => failure,
    }
}

/// The points of a PLY file next to the model, without tracks; none if there is no such file.
fn ply_points(sparse_dir: &Path) -> Result<BTreeMap<u64, Point>> {
    let Some(path) = CLOUDS.iter().map(|name| sparse_dir.join(name)).find(|path| path.is_file()) else {
        return Ok(BTreeMap::new());
    };
    let cloud = PointCloud::read_ply(&path).map_err(|error| invalid(error).at(&path))?;
    let point = |(position, rgb): (&[f32; 3], &[u8; 3])| {
        let position = DVec3::from(position.map(f64::from));
        Point { position, rgb: *rgb, error_px: -1.0, track: Vec::new() }
    };
    Ok((1..).zip(cloud.positions.iter().zip(&cloud.colors).map(point)).collect())
}
