//! Small captures in temporary folders.

use std::path::Path;

use engine::JobContext;
use glam::{DMat3, DMat4, DVec2, DVec3};
use image::{GrayImage, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use scene::{Camera, Capture, Intrinsics};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::colmap_files::{self, StatedCamera};
use crate::colmap::camera_model::lens;
use crate::colmap::model::{Model, Point, RegisteredImage};
use crate::inspect::inspect;
use crate::recognise::read;
use crate::source::Frame;
use crate::{Params, SfmImport};

/// Width of generated images.
pub(crate) const WIDTH: u32 = 24;
/// Height of generated images.
pub(crate) const HEIGHT: u32 = 16;

/// Runs the stage on `dir` through a job context.
pub(crate) fn run(dir: &Path, params: &Params) -> anyhow::Result<(TempDir, Capture)> {
    let root = tempfile::tempdir()?;
    let mut context = JobContext::detached(root.path())?;
    context.sources.insert("source".into(), dir.into());
    let artifact = <SfmImport as engine::Stage>::run(&context, params)?;
    artifact.0.check()?;
    Ok((root, artifact.0))
}

/// The error for `dir`, with the temporary folder shortened to `DIR`.
pub(crate) fn refusal(dir: &Path, params: &Params) -> String {
    match run(dir, params) {
        Ok(_) => panic!("{} was accepted", dir.display()),
        Err(error) => shortened(&format!("{error:#}"), dir),
    }
}

/// Replaces the path, the parent and the name of a temporary folder.
pub(crate) fn shortened(text: &str, dir: &Path) -> String {
    let data_root = format!("--data-root {}\n", dir.parent().unwrap().display());
    let text = text.replace(&data_root, "--data-root PARENT\n").replace(&*dir.to_string_lossy(), "DIR");
    let name = dir.file_name().unwrap().to_string_lossy();
    // Recipes omit the dot at the start of a name.
    text.replace(&*name, "DIR").replace(name.trim_start_matches('.'), "DIR")
}

/// The errors of one test, for a snapshot.
#[derive(Default)]
pub(crate) struct Refusals(String);

impl Refusals {
    /// Appends the error for `dir`.
    pub(crate) fn add(&mut self, dir: &Path, params: &Params) {
        self.0 += &refusal(dir, params);
        self.0.push('\n');
    }

    /// One line per error.
    pub(crate) fn text(&self) -> &str {
        &self.0
    }
}

/// Asserts that `dir` is refused with an error that contains all `parts`.
pub(crate) fn assert_refused(dir: &Path, params: &Params, parts: &[&str]) {
    let message = refusal(dir, params);
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
}

/// The report of `inspect`, with the temporary folder shortened to `DIR`.
pub(crate) fn describe(dir: &Path) -> anyhow::Result<String> {
    Ok(shortened(&inspect(dir)?.text(), &dir.canonicalize()?))
}

/// The frames of a capture, without decoding images.
pub(crate) fn frames(dir: &Path, params: &Params) -> Vec<Frame> {
    read(dir, params).unwrap().frames
}

/// The camera-to-world matrix (Blender axes) of the `index`-th test camera, rows first.
pub(crate) fn blender_matrix(index: usize) -> [[f64; 4]; 4] {
    let angle = 0.4 * index as f64;
    let camera =
        Camera::look_at(intrinsics(), DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0), DVec3::ZERO, DVec3::Z);
    let world_from_camera = camera.camera_from_world.inverse();
    let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let rotation = world_from_camera.rotation * flip;
    let matrix = DMat4::from_mat3(rotation);
    let mut rows = matrix.transpose().to_cols_array_2d();
    (0..3).for_each(|axis| rows[axis][3] = world_from_camera.translation[axis]);
    rows
}

/// A pinhole for generated images.
pub(crate) fn intrinsics() -> Intrinsics {
    Intrinsics { width: WIDTH, height: HEIGHT, focal_x: 30.0, focal_y: 30.0, center_x: 12.0, center_y: 8.0 }
}

/// A D-NeRF folder with 5 training, 2 validation and 3 test frames.
pub(crate) fn blender_scene() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (split, (label, count)) in [("train", 5), ("val", 2), ("test", 3)].into_iter().enumerate() {
        std::fs::create_dir_all(dir.path().join(label)).unwrap();
        let frame = |index: usize| {
            json!({
                "file_path": format!("./{label}/r_{index:03}"),
                "rotation": 0.1,
                "time": index as f64 / (count - 1) as f64,
                "transform_matrix": blender_matrix(index),
            })
        };
        let transforms = json!({ "camera_angle_x": 0.7, "frames": (0..count).map(frame).collect::<Vec<_>>() });
        std::fs::write(transforms_path(dir.path(), label), transforms.to_string()).unwrap();
        for index in 0..count {
            rgba_image(index, split).save(dir.path().join(label).join(format!("r_{index:03}.png"))).unwrap();
        }
    }
    dir
}

/// Left third: transparent red; middle: half-transparent green; right: opaque blue. No two files are equal.
fn rgba_image(index: usize, split: usize) -> RgbaImage {
    RgbaImage::from_fn(WIDTH, HEIGHT, |column, _| match column / 8 {
        0 => Rgba([255, 0, split as u8, 0]),
        1 => Rgba([0, 200, 0, 100]),
        _ => Rgba([0, index as u8, 255, 255]),
    })
}

/// The path of the transforms file of one split.
pub(crate) fn transforms_path(dir: &Path, label: &str) -> std::path::PathBuf {
    dir.join(format!("transforms_{label}.json"))
}

/// Edits the transforms file of one split.
pub(crate) fn edit_transforms(dir: &Path, label: &str, edit: impl FnOnce(&mut Value)) {
    let path = transforms_path(dir, label);
    let mut json: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    edit(&mut json);
    std::fs::write(path, json.to_string()).unwrap();
}

/// A COLMAP workspace in memory: cameras, and a model without reprojection error.
pub(crate) struct Workspace {
    pub(crate) cameras: Vec<StatedCamera>,
    pub(crate) model: Model,
}

impl Workspace {
    /// `count` images named by `name`, all with camera 1 of the given model and parameters.
    pub(crate) fn new(count: u32, camera_model: &'static str, params: &[f64], name: impl Fn(u32) -> String) -> Self {
        let size = (u64::from(WIDTH), u64::from(HEIGHT));
        let camera = StatedCamera { id: 1, model: camera_model, size, params: params.to_vec() };
        let lens = lens(camera_model, size.0, size.1, params);
        let mut model = Model::default();
        for id in 1..=6_u64 {
            let t = id as f64;
            let position = DVec3::new(0.1 * t - 0.3, 0.2 * (t * 1.7).sin(), 0.15 * (t * 0.9).cos());
            model.points.insert(id, Point { position, rgb: [id as u8; 3], error_px: 0.0, track: vec![] });
        }
        for id in 1..=count {
            let angle = 0.1 * f64::from(id);
            let position = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0);
            let pose = Camera::look_at(intrinsics(), position, DVec3::ZERO, DVec3::Z).camera_from_world;
            let q = glam::DQuat::from_mat3(&pose.rotation);
            let mut image = RegisteredImage {
                name: name(id - 1),
                camera_id: 1,
                quaternion: [q.w, q.x, q.y, q.z],
                translation: pose.translation.to_array(),
                observations: vec![(DVec2::new(1.5, 2.5), None)],
            };
            for (point_id, point) in &mut model.points {
                let view = pose.apply(point.position);
                let plane = view.truncate() / view.z;
                let pixel = lens.as_ref().map_or(plane, |lens| lens.pixel(plane));
                point.track.push((id, image.observations.len() as u32));
                image.observations.push((pixel, Some(*point_id)));
            }
            model.images.insert(id, image);
        }
        if let Ok(lens) = lens {
            model.cameras.insert(1, lens);
        }
        Self { cameras: vec![camera], model }
    }

    /// A pinhole video of `count` frames.
    pub(crate) fn video(count: u32) -> Self {
        Self::new(count, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |index| format!("{index:04}.png"))
    }

    /// Writes a binary model and the registered images into a folder.
    pub(crate) fn write(&self) -> TempDir {
        let dir = tempfile::tempdir().unwrap();
        colmap_files::write_binary(&dir.path().join("sparse/0"), &self.cameras, &self.model);
        for (id, image) in &self.model.images {
            write_image(&dir.path().join("images").join(&image.name), *id);
        }
        dir
    }
}

/// Writes an opaque image of colour ramps.
pub(crate) fn write_image(path: &Path, seed: u32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let pixel = |column: u32, row: u32| Rgb([(10 * column) as u8, (15 * row) as u8, seed as u8]);
    RgbImage::from_fn(WIDTH, HEIGHT, pixel).save(path).unwrap();
}

/// A JPEG file with an EXIF orientation.
pub(crate) fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let tag = [0x12, 0x01, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0];
    let exif = [b"Exif\0\0II*\0\x08\0\0\0\x01\0", tag.as_slice(), &[0; 4]].concat();
    let length = (exif.len() as u16 + 2).to_be_bytes();
    [&jpeg[..2], &[0xff, 0xe1], &length, &exif, &jpeg[2..]].concat()
}

/// Writes a `.npy` file of f64 values.
pub(crate) fn write_npy(path: &Path, shape: &str, values: &[f64]) {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = [&b"\x93NUMPY\x01\x00\x76\x00"[..], format!("{header:<117}\n").as_bytes()].concat();
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    std::fs::write(path, bytes).unwrap();
}

/// Writes a mask with 0 in the left half and `value` in the right half.
pub(crate) fn write_mask(path: &Path, size: (u32, u32), value: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    GrayImage::from_fn(size.0, size.1, |column, _| Luma([if column < size.0 / 2 { 0 } else { value }]))
        .save(path)
        .unwrap();
}

/// Parameters of a COLMAP import that holds out every fourth image, starting with the first.
pub(crate) fn colmap_params() -> Params {
    Params { every_nth: 4, fps: 10.0, ..Params::default() }
}
