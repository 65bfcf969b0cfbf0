//! Damaged files: errors, never panics.

use std::path::Path;

use super::colmap_files::{write_binary, write_text};
use super::nerfstudio_files::{Rewriting, rewrite};
use super::support::*;
use crate::colmap::read_model;
use crate::recognise::read;
use crate::{Format, Params};

/// The next of a fixed sequence of pseudo-random numbers (upper bits of Knuth's MMIX generator).
fn random(state: &mut u64) -> usize {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 33) as usize
}

/// Replaces a file. Truncating an existing file makes some file systems wait for the disk.
fn overwrite(path: &Path, bytes: impl AsRef<[u8]>) {
    std::fs::remove_file(path).unwrap();
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn every_truncation_of_binary_models_is_an_error() {
    let workspace = Workspace::video(2);
    let dir = tempfile::tempdir().unwrap();
    write_binary(dir.path(), &workspace.cameras, &workspace.model);
    assert!(read_model(dir.path()).is_ok());
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = dir.path().join(file);
        let bytes = std::fs::read(&path).unwrap();
        for length in 0..bytes.len() {
            overwrite(&path, &bytes[..length]);
            let message = read_model(dir.path()).unwrap_err().to_string();
            assert!(message.contains("the file ends inside") && message.contains(file), "{message}");
        }
        overwrite(&path, [&bytes[..], &[0]].concat());
        let message = read_model(dir.path()).unwrap_err().to_string();
        assert!(message.contains("1 unexpected bytes after the last of"), "{message}");
        overwrite(&path, &bytes);
    }
}

#[test]
fn mangled_models_never_panic() {
    let workspace = Workspace::video(2);
    let mut state = 7;
    for (write, extension) in [(write_binary as fn(&_, &_, &_), "bin"), (write_text, "txt")] {
        let dir = workspace.write();
        let sparse = dir.path().join("sparse/0");
        std::fs::remove_dir_all(&sparse).unwrap();
        write(&sparse, &workspace.cameras, &workspace.model);
        let mut refused = 0;
        for round in 0..600 {
            let path = sparse.join(format!("{}.{extension}", ["cameras", "images", "points3D"][round % 3]));
            let good = std::fs::read(&path).unwrap();
            let mut bytes = good.clone();
            for _ in 0..=random(&mut state) % 3 {
                let at = random(&mut state) % bytes.len();
                bytes[at] = random(&mut state) as u8;
            }
            overwrite(&path, bytes);
            let result = read(dir.path(), &colmap_params());
            refused += usize::from(result.is_err() || result.is_ok_and(|capture| !capture.problems().is_empty()));
            overwrite(&path, good);
        }
        assert!(refused > 100, "only {refused} of 600 mangled models were refused: is the file read at all?");
    }
}

#[test]
fn mangled_transforms_never_panic() {
    let dir = blender_scene();
    let path = transforms_path(dir.path(), "train");
    let good = std::fs::read(&path).unwrap();
    let mut state = 11;
    let mut refused = 0;
    for round in 0..600 {
        let mut bytes = good.clone();
        if round % 3 == 0 {
            bytes.truncate(random(&mut state) % good.len());
        } else {
            let at = random(&mut state) % bytes.len();
            bytes[at] = random(&mut state) as u8;
        }
        overwrite(&path, bytes);
        let result = read(dir.path(), &Params::default());
        refused += usize::from(result.is_err() || result.is_ok_and(|capture| !capture.problems().is_empty()));
    }
    assert!(refused > 300, "only {refused} of 600 mangled files were refused");
}

#[test]
fn mangled_single_transforms_never_panic() {
    let dir = blender_scene();
    let original = read(dir.path(), &Params::default()).unwrap();
    let applied = Some((glam::DMat4::from_rotation_z(0.5), 2.0));
    let distortion = serde_json::json!({ "camera_model": "OPENCV", "k1": 0.01, "aabb_scale": 4 });
    let rewriting = Rewriting { applied, distortion, is_timed: true, ..Rewriting::default() };
    rewrite(dir.path(), &original, &rewriting);
    let path = dir.path().join("transforms.json");
    let params = Params { format: Format::Nerfstudio, ..Params::default() };
    let refused = support::mangle::refused(&path, 800, |_| {
        let capture = read(dir.path(), &params)?;
        assert!(capture.bounds_world().into_iter().flatten().flatten().all(f64::is_finite));
        capture.problems().into_iter().next().map_or(Ok(()), Err)
    });
    assert!(refused > 300, "only {refused} of 800 mangled files were refused");
}

#[test]
fn mangled_clouds_never_panic() {
    let dir = blender_scene();
    let positions = (0..200).map(|i| [i as f32 * 0.01, 0.5, -0.5]).collect();
    let cloud = scene::PointCloud { positions, colors: vec![[7; 3]; 200] };
    let path = dir.path().join("fused.ply");
    cloud.write_ply(&path, scene::ply::PlyFormat::Ascii).unwrap();
    assert_eq!(read(dir.path(), &Params::default()).unwrap().points.len(), 200);
    let refused = support::mangle::refused(&path, 400, |_| {
        read(dir.path(), &Params::default()).map(|found| assert!(found.bounds_world().is_some()))
    });
    assert!(refused > 100, "only {refused} of 400 mangled files were refused");
}

#[test]
fn mangled_poses_never_panic() {
    let dir = super::n3v::rig(&["cam00", "cam01", "cam02"], 2);
    let path = dir.path().join("poses_bounds.npy");
    let good = std::fs::read(&path).unwrap();
    for length in 0..good.len() {
        overwrite(&path, &good[..length]);
        assert_refused(dir.path(), &Params::default(), &["poses_bounds.npy"]);
    }
    let mut state = 13;
    let mut refused = 0;
    for _ in 0..600 {
        let mut bytes = good.clone();
        let at = random(&mut state) % bytes.len();
        bytes[at] = random(&mut state) as u8;
        overwrite(&path, bytes);
        let result = read(dir.path(), &Params::default());
        refused += usize::from(result.is_err() || result.is_ok_and(|capture| !capture.problems().is_empty()));
    }
    assert!(refused > 100, "only {refused} of 600 mangled files were refused: is the file read at all?");
}

#[test]
fn every_truncation_of_an_image_is_refused() {
    for extension in ["png", "jpg", "webp", "tif"] {
        let dir = blender_scene();
        let path = dir.path().join(format!("test/r_002.{extension}"));
        if extension != "png" {
            write_image(&path, 5);
            edit_transforms(dir.path(), "test", |json| {
                json["frames"][2]["file_path"] = format!("test/r_002.{extension}").into();
            });
        }
        assert!(run(dir.path(), &Params::default()).is_ok());
        let good = std::fs::read(&path).unwrap();
        // The chunk IEND of a PNG is optional, and so is the offset of a second image at the end of a TIFF.
        let optional = match extension {
            "png" => 12,
            "tif" => 4,
            _ => 0,
        };
        let essential = good.len() - optional;
        for length in (0..essential).step_by(7).chain([essential - 1]) {
            overwrite(&path, &good[..length]);
            let file = path.file_name().unwrap().to_str().unwrap();
            assert_refused(dir.path(), &Params::default(), &["image cannot be read", file]);
        }
        overwrite(&path, good);
    }
}
