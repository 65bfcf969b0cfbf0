//! Blender layouts beyond those of D-NeRF: missing split files, equal times, clouds, masks and depth maps.

use scene::ply::PlyFormat;
use scene::{PointCloud, Split};
use serde_json::json;

use super::support::*;
use crate::Params;
use crate::recognise::read;

#[test]
fn frames_at_one_time_become_cameras() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| {
        for (index, time) in [0.5, 0.0, 0.5, 0.0].into_iter().enumerate() {
            json["frames"][index]["time"] = json!(time);
        }
    });
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let places =
        |split| capture.views_of(split).map(|(_, view)| (view.camera_index, view.frame_index)).collect::<Vec<_>>();
    assert_eq!(places(Split::Train), [(0, 0), (1, 0), (0, 1), (1, 1), (0, 2)]);
    assert_eq!(places(Split::Test), [(0, 0), (0, 1), (0, 2)]);
    assert!(read(dir.path(), &Params::default()).unwrap().warnings[0].contains("have the same time"));
}

#[test]
fn repeated_frames_are_read_once() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| {
        let repeated = json["frames"][2].clone();
        json["frames"].as_array_mut().unwrap().push(repeated);
    });
    let (found, expected) = (read(dir.path(), &Params::default()).unwrap(), blender_scene());
    let expected = read(expected.path(), &Params::default()).unwrap();
    assert_eq!((found.frames.len(), found.camera_count()), (expected.frames.len(), 1));
    assert!(found.warnings.iter().any(|warning| warning.starts_with("1 frames repeat")), "{:?}", found.warnings);
}

#[test]
fn numbers_of_frames_are_times_and_time_stamps_a_warning() {
    let dir = blender_scene();
    let rename = |key: &str, other: &str| {
        for label in ["train", "val", "test"] {
            edit_transforms(dir.path(), label, |json| {
                for frame in json["frames"].as_array_mut().unwrap() {
                    frame[other] = frame[key].take();
                    frame.as_object_mut().unwrap().remove(key);
                }
            });
        }
    };
    let times = || read(dir.path(), &Params::default()).unwrap().frames.into_iter().map(|frame| frame.time_secs);
    let expected: Vec<f64> = times().collect();
    rename("time", "timestep_index");
    assert_eq!(times().collect::<Vec<_>>(), expected);
    rename("timestep_index", "timestamp");
    let warnings = read(dir.path(), &Params::default()).unwrap().warnings;
    assert!(warnings[0].contains("rename the key timestamp"), "{warnings:?}");
}

#[test]
fn missing_split_files_have_a_stated_rule() {
    let dir = blender_scene();
    std::fs::remove_file(transforms_path(dir.path(), "test")).unwrap();
    let counts =
        |capture: &scene::Capture| [Split::Train, Split::Val, Split::Test].map(|s| capture.views_of(s).count());
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!((counts(&capture), capture.protocol.split.as_str()), ([5, 0, 2], "official, tested on val"));
    std::fs::remove_file(transforms_path(dir.path(), "val")).unwrap();
    let (_root, capture) = run(dir.path(), &Params { every_nth: 2, ..Params::default() }).unwrap();
    assert_eq!((counts(&capture), capture.protocol.split.as_str()), ([2, 0, 3], "1 of 2 images"));
    let names: Vec<&str> = capture.views_of(Split::Test).map(|(_, view)| view.name.as_str()).collect();
    assert_eq!(names, ["train_000", "train_002", "train_004"]);
    let untested = Params { every_nth: 0, ..Params::default() };
    assert_eq!(counts(&run(dir.path(), &untested).unwrap().1), [5, 0, 0]);
    assert!(describe(dir.path()).unwrap().contains("of every_nth training images, one is held out"));
}

#[test]
fn clouds_masks_and_depths_beside_the_images_are_used() {
    let dir = blender_scene();
    let positions: Vec<[f32; 3]> = (0..500).map(|i| [0.01 * i as f32 - 2.5, 1.0, -1.0]).collect();
    let cloud = scene::PointCloud { colors: vec![[9; 3]; positions.len()], positions };
    let write =
        |name: &str| cloud.write_ply(&dir.path().join(name), scene::ply::PlyFormat::BinaryLittleEndian).unwrap();
    ["points3d.ply", "fused.ply"].iter().for_each(|name| write(name));
    for index in 0..5 {
        let extension = if index == 4 { "PNG" } else { "png" };
        write_mask(&dir.path().join(format!("masks/train/r_{index:03}.{extension}")), (WIDTH, HEIGHT), 255);
        let millimetres = |_, row| image::Luma([2000 + row as u16]);
        let depth = image::ImageBuffer::<image::Luma<u16>, _>::from_fn(WIDTH, HEIGHT, millimetres);
        std::fs::create_dir_all(dir.path().join("train/depth")).unwrap();
        depth.save(dir.path().join(format!("train/depth/r_{index:03}_depth.png"))).unwrap();
    }
    write_mask(&dir.path().join("masks/test/r_000.png"), (WIDTH + 1, HEIGHT), 255);
    let params = Params { width: Some(WIDTH / 2), ..Params::default() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    assert_eq!(capture.load_points().unwrap(), Some(cloud));
    let [low, high] = capture.bounds_world.unwrap();
    assert!((low[0] - -2.98).abs() <= 0.05 && (high[0] - 2.97).abs() <= 0.05, "{low:?} {high:?}");
    for (_, view) in capture.views_of(Split::Train) {
        let (mask, depth) = (capture.load_mask(view).unwrap().unwrap(), capture.load_depth(view).unwrap().unwrap());
        assert_eq!((mask.labels[0], mask.labels[11]), (0, 1));
        assert!((depth.depth_view[0] - 2.001).abs() <= 1.1e-3, "{}", depth.depth_view[0]);
    }
    assert!(capture.views_of(Split::Test).all(|(_, view)| view.mask.is_none() && view.depth.is_none()));
    let source = read(dir.path(), &params).unwrap();
    assert_eq!(source.warnings.iter().filter(|warning| warning.contains("size differs")).count(), 1);
    assert!(source.warnings.contains(&"several clouds: fused.ply is used, not points3d.ply".into()));
    let used = source.used_files();
    for name in
        ["fused.ply", "masks/train/r_003.png", "train/depth/r_001_depth.png", "train/r_000.png", "transforms_val.json"]
    {
        assert!(used.contains(&dir.path().join(name)), "{name} is not among the used files");
    }
    assert!(!used.contains(&dir.path().join("points3d.ply")));
}

#[test]
fn points_that_are_not_finite_are_skipped() {
    let dir = blender_scene();
    let cloud = PointCloud { positions: vec![[0.5, 0.25, 0.0]; 2], colors: vec![[9; 3]; 2] };
    let path = dir.path().join("points3D.ply");
    cloud.write_ply(&path, PlyFormat::Ascii).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen("0.25", "nan", 1)).unwrap();
    let source = read(dir.path(), &Params::default()).unwrap();
    assert_eq!(source.points, [([0.5, 0.25, 0.0], [9; 3])]);
    assert!(source.warnings.iter().any(|it| it == "1 points of points3D.ply are skipped: they are not finite"));
}

/// 3DGS leaves its random points in the folder.
#[test]
fn random_points_of_trainers_are_not_a_cloud() {
    let dir = blender_scene();
    let path = dir.path().join("points3d.ply");
    let cloud = |half_side: f64, level: u8| {
        let cloud = PointCloud::random_in([[-half_side; 3], [half_side; 3]], 2000, 7);
        let cloud = PointCloud { colors: vec![[level; 3]; 2000], ..cloud };
        cloud.write_ply(&path, PlyFormat::BinaryLittleEndian).unwrap();
        let source = read(dir.path(), &Params::default()).unwrap();
        (source.points.len(), source.has_cloud(), source.warnings.join(""))
    };
    let (points, has_cloud, warnings) = cloud(1.3, 127);
    assert_eq!((points, has_cloud), (0, Some(false)));
    assert!(warnings.contains("points3d.ply is ignored"), "{warnings}");
    assert_eq!((cloud(1.3, 90).0, cloud(1.4, 127).0, cloud(0.8, 128).0), (2000, 2000, 2000));
}

#[test]
fn masks_of_instant_ngp_and_depth_of_nerfcapture_are_read() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| {
        json["integer_depth_scale"] = 0.01.into();
        json["offset"] = 0.5.into();
        json["frames"][1]["depth_path"] = "train/r_001.depth.png".into();
    });
    let depth = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(WIDTH, HEIGHT, image::Luma([250_u16]));
    depth.save(dir.path().join("train/r_001.depth.png")).unwrap();
    write_mask(&dir.path().join("train/dynamic_mask_r_001.png"), (WIDTH, HEIGHT), 255);
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let view = capture.views.iter().find(|view| view.name == "train_001").unwrap();
    assert_eq!(capture.load_depth(view).unwrap().unwrap().depth_view[0], 2.5);
    assert_eq!(capture.load_mask(view).unwrap().unwrap().labels[23], 1);
}

#[test]
fn depth_in_another_unit_than_the_cameras_is_a_warning() {
    let metres = 4.0_f32;
    let dir = blender_scene();
    std::fs::create_dir(dir.path().join("depth")).unwrap();
    let shape = [HEIGHT as usize, WIDTH as usize];
    let values: Vec<u8> = (0..WIDTH * HEIGHT).flat_map(|_| metres.to_le_bytes()).collect();
    for index in 0..5 {
        let path = dir.path().join(format!("depth/r_{index:03}.npy"));
        std::fs::write(path, super::estimators::npy("<f4", &shape, &values)).unwrap();
    }
    // A file belongs to one image.
    ["val", "test"].iter().for_each(|label| std::fs::remove_file(transforms_path(dir.path(), label)).unwrap());
    let warnings = |unit: Option<f64>| {
        let params = Params { depth_unit: unit, ..Params::default() };
        read(dir.path(), &params)
            .unwrap()
            .warnings
            .into_iter()
            .find(|it| it.contains("depth maps are"))
            .unwrap_or_default()
    };
    let is_wrong = |found: &str| found.contains("set depth_unit = 1.0 if it fits");
    assert!(is_wrong(&warnings(None)) && warnings(Some(1.0)).is_empty() && warnings(Some(0.1)).is_empty());
    let cloud = PointCloud::random_in([[-1.0; 3], [1.0; 3]], 200, 7);
    cloud.write_ply(&dir.path().join("points3D.ply"), PlyFormat::Ascii).unwrap();
    assert!(is_wrong(&warnings(None)) && warnings(Some(1.0)).is_empty() && is_wrong(&warnings(Some(0.1))));
    let text = describe(dir.path()).unwrap();
    assert!(text.contains("depth       5 maps; 0.001 scene units per stored unit, median 0.00400"), "{text}");
}

#[test]
fn a_mask_of_several_images_belongs_to_none() {
    let dir = blender_scene();
    write_mask(&dir.path().join("masks/r_001.png"), (WIDTH, HEIGHT), 255);
    let source = read(dir.path(), &Params::default()).unwrap();
    assert!(source.frames.iter().all(|frame| frame.mask.is_none()));
    assert!(source.warnings[0].contains("3 images would share"), "{:?}", source.warnings);
}
