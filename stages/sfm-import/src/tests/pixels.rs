//! Undistortion and labels.

use image::GrayImage;
use scene::float_image::FloatImage;

use super::support::*;
use crate::Params;
use crate::lens::{Distortion, Lens, plane_point};
use crate::pixels::{Labels, mask_values, undistorted};

fn ramp(width: u32, height: u32) -> FloatImage {
    let values = (0..height).flat_map(|row| (0..width).map(move |column| (2 * column + 3 * row) as f32));
    FloatImage { width, height, channels: 1, values: values.collect() }
}

#[test]
fn undistortion_interpolates_bilinearly() {
    let intrinsics =
        scene::Intrinsics { width: 64, height: 48, focal_x: 60.0, focal_y: 60.0, center_x: 32.0, center_y: 24.0 };
    let lens = Lens { intrinsics, distortion: Distortion::brown([0.08, -0.01, 0.0, 0.0], [0.002, 0.001]) };
    let target = lens.undistorted().unwrap();
    let image = undistorted(ramp(64, 48), &lens, &target);
    for row in 0..48 {
        for column in 0..64 {
            // A ramp is linear, so bilinear interpolation is exact: 2 (x − ½) + 3 (y − ½) at the distorted position.
            let pixel = lens.pixel(plane_point(&target, column, row));
            let expected = 2.0 * (pixel.x - 0.5) + 3.0 * (pixel.y - 0.5);
            let value = f64::from(image.values[(row * 64 + column) as usize]);
            assert!((value - expected).abs() <= 1e-3, "({column}, {row}) {value} {expected}");
        }
    }
    let pinhole = Lens::pinhole(intrinsics);
    assert_eq!(undistorted(ramp(64, 48), &pinhole, &intrinsics), ramp(64, 48));
}

#[test]
fn mask_values_are_instances_or_one_blurred_object() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mask.png");
    let names = |present: &[u8]| {
        let image = GrayImage::from_raw(present.len() as u32, 1, present.to_vec()).unwrap();
        image.save(&path).unwrap();
        Labels::of_values(&mask_values(&path).unwrap()).class_names
    };
    assert_eq!(names(&[0]), [] as [&str; 0]);
    assert_eq!(names(&[0, 255]), ["object"]);
    assert_eq!(names(&[0, 38, 75]), ["object 1", "object 2"]);
    let blurred: Vec<u8> = (0..=255).step_by(5).collect();
    assert_eq!(names(&blurred), ["object"]);
}

/// A capture with transparent images whose first two are stored in another format. TIFF holds the second in 16 bits.
fn stored_as(extension: &str) -> Vec<image::RgbImage> {
    let dir = blender_scene();
    for (index, name) in ["train/r_000", "train/r_001"].iter().enumerate() {
        let (from, to) = (dir.path().join(format!("{name}.png")), dir.path().join(format!("{name}.{extension}")));
        let image = image::open(&from).unwrap();
        let is_deep = index == 1 && extension.starts_with("tif");
        let image = if is_deep { image.into_rgba16().into() } else { image };
        std::fs::remove_file(from).unwrap();
        image.save(to).unwrap();
        edit_transforms(dir.path(), "train", |json| {
            json["frames"][index]["file_path"] = format!("{name}.{extension}").into();
        });
    }
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    capture.views.iter().map(|view| capture.load_image(view).unwrap()).collect()
}

#[test]
fn lossless_formats_give_equal_pixels() {
    let png = stored_as("png");
    assert!(["webp", "tif", "tiff"].iter().all(|extension| stored_as(extension) == png));
}
