//! Writers of COLMAP models, field by field, to check the readers against.

use std::fmt::Write as _;
use std::path::Path;

use crate::colmap::camera_model::CAMERA_MODELS;
use crate::colmap::model::Model;

/// A camera in a COLMAP model.
pub(crate) struct StatedCamera {
    pub(crate) id: u32,
    pub(crate) model: &'static str,
    pub(crate) size: (u64, u64),
    pub(crate) params: Vec<f64>,
}

/// Writes `cameras.bin`, `images.bin` and `points3D.bin`.
pub(crate) fn write_binary(dir: &Path, cameras: &[StatedCamera], model: &Model) {
    std::fs::create_dir_all(dir).unwrap();
    let mut bytes = (cameras.len() as u64).to_le_bytes().to_vec();
    for camera in cameras {
        let number = CAMERA_MODELS.iter().position(|(name, _)| *name == camera.model).unwrap_or(99) as u32;
        bytes.extend(camera.id.to_le_bytes());
        bytes.extend(number.to_le_bytes());
        bytes.extend([camera.size.0, camera.size.1].iter().flat_map(|value| value.to_le_bytes()));
        bytes.extend(camera.params.iter().flat_map(|value| value.to_le_bytes()));
    }
    std::fs::write(dir.join("cameras.bin"), bytes).unwrap();
    let mut bytes = (model.images.len() as u64).to_le_bytes().to_vec();
    for (id, image) in &model.images {
        bytes.extend(id.to_le_bytes());
        bytes.extend(image.quaternion.iter().chain(&image.translation).flat_map(|value| value.to_le_bytes()));
        bytes.extend(image.camera_id.to_le_bytes());
        bytes.extend(image.name.bytes().chain([0]));
        bytes.extend((image.observations.len() as u64).to_le_bytes());
        for (pixel, point) in &image.observations {
            bytes.extend([pixel.x, pixel.y].iter().flat_map(|value| value.to_le_bytes()));
            bytes.extend(point.map_or(-1, |id| id as i64).to_le_bytes());
        }
    }
    std::fs::write(dir.join("images.bin"), bytes).unwrap();
    let mut bytes = (model.points.len() as u64).to_le_bytes().to_vec();
    for (id, point) in &model.points {
        bytes.extend(id.to_le_bytes());
        bytes.extend(point.position.to_array().iter().flat_map(|value| value.to_le_bytes()));
        bytes.extend(point.rgb);
        bytes.extend(point.error_px.to_le_bytes());
        bytes.extend((point.track.len() as u64).to_le_bytes());
        bytes.extend(point.track.iter().flat_map(|(image, at)| [*image, *at]).flat_map(|value| value.to_le_bytes()));
    }
    std::fs::write(dir.join("points3D.bin"), bytes).unwrap();
}

/// Writes `cameras.txt`, `images.txt` and `points3D.txt`.
pub(crate) fn write_text(dir: &Path, cameras: &[StatedCamera], model: &Model) {
    std::fs::create_dir_all(dir).unwrap();
    let join = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let mut out = String::from("# Camera list with one line of data per camera:\n");
    for camera in cameras {
        let (width, height) = camera.size;
        writeln!(out, "{} {} {width} {height} {}", camera.id, camera.model, join(&camera.params)).unwrap();
    }
    std::fs::write(dir.join("cameras.txt"), out).unwrap();
    let mut out = String::from("# Image list with two lines of data per image:\n");
    for (id, image) in &model.images {
        let pose = [&image.quaternion[..], &image.translation].concat();
        writeln!(out, "{id} {} {} {}", join(&pose), image.camera_id, image.name).unwrap();
        let keypoint = |(pixel, point): &(glam::DVec2, Option<u64>)| {
            format!("{} {} {}", pixel.x, pixel.y, point.map_or(-1, |id| id as i64))
        };
        writeln!(out, "{}", image.observations.iter().map(keypoint).collect::<Vec<_>>().join(" ")).unwrap();
    }
    std::fs::write(dir.join("images.txt"), out).unwrap();
    let mut out = String::from("# 3D point list with one line of data per point:\n");
    for (id, point) in &model.points {
        let [r, g, b] = point.rgb;
        write!(out, "{id} {} {r} {g} {b} {}", join(&point.position.to_array()), point.error_px).unwrap();
        point.track.iter().for_each(|(image, at)| write!(out, " {image} {at}").unwrap());
        out.push('\n');
    }
    std::fs::write(dir.join("points3D.txt"), out).unwrap();
}
