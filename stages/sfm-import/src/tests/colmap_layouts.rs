//! Where COLMAP captures keep models, images and points.

use std::path::Path;

use scene::PointCloud;
use scene::ply::PlyFormat;

use super::colmap_files::{write_binary, write_text};
use super::support::*;
use crate::Params;
use crate::recognise::read;

/// Writes the images of a workspace at another size into a folder, with another extension.
fn write_copies(dir: &Path, workspace: &Workspace, folder: &str, size: (u32, u32), extension: &str) {
    std::fs::create_dir_all(dir.join(folder)).unwrap();
    for (id, image) in &workspace.model.images {
        let copy = image::RgbImage::from_pixel(size.0, size.1, image::Rgb([*id as u8, 50, 90]));
        copy.save(dir.join(folder).join(&image.name).with_extension(extension)).unwrap();
    }
}

#[test]
fn models_beside_images_in_nerfstudios_layout_are_found() {
    let dir = Workspace::video(6).write();
    let (_root, expected) = run(dir.path(), &colmap_params()).unwrap();
    std::fs::create_dir(dir.path().join("colmap")).unwrap();
    std::fs::rename(dir.path().join("sparse"), dir.path().join("colmap/sparse")).unwrap();
    let (_root, found) = run(dir.path(), &colmap_params()).unwrap();
    assert_eq!(found.views, expected.views);
}

/// A video with a model of `count` of its 11 images in a folder below `sparse`.
fn write_part(dir: &Path, model: &str, count: u32, is_binary: bool) {
    let part = Workspace::video(count);
    let write = if is_binary { write_binary } else { write_text };
    write(&dir.join("sparse").join(model), &part.cameras, &part.model);
}

#[test]
fn the_model_with_the_most_images_is_read() {
    let dir = Workspace::video(11).write();
    write_part(dir.path(), "0", 3, true);
    for is_binary in [true, false] {
        let _ = std::fs::remove_dir_all(dir.path().join("sparse/2"));
        write_part(dir.path(), "2", 9, is_binary);
        write_part(dir.path(), "10", 9, is_binary);
        let source = read(dir.path(), &colmap_params()).unwrap();
        assert_eq!((source.frames.len(), &source.frames[0].stated_in), (9, &dir.path().join("sparse/2")));
        let expected = "only sparse/2 is used, which has the most images (3 in 0, 9 in 2, 9 in 10)";
        assert!(source.warnings[0].ends_with(expected), "{:?}", source.warnings);
        std::fs::remove_dir_all(dir.path().join("sparse/10")).unwrap();
    }
    // A file that ends after its count has no images.
    std::fs::write(dir.path().join("sparse/0/images.bin"), 1000_u64.to_le_bytes()).unwrap();
    assert_eq!(read(dir.path(), &colmap_params()).unwrap().frames.len(), 9);
    // A damaged line is named if its model has the most images.
    write_part(dir.path(), "1", 10, false);
    let path = dir.path().join("sparse/1/images.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, format!("{} 1.0 2.0\n", text.strip_suffix('\n').unwrap())).unwrap();
    assert_refused(dir.path(), &colmap_params(), &["images.txt", "the line ends too early"]);
}

#[test]
fn paths_of_other_machines_are_read_by_their_end() {
    let expected = read(Workspace::video(6).write().path(), &colmap_params()).unwrap();
    for prefix in ["images/", "/home/me/scan/images/", r"C:\scan\images\"] {
        let workspace =
            Workspace::new(6, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |index| format!("{prefix}{index:04}.png"));
        let dir = Workspace::video(6).write();
        write_binary(&dir.path().join("sparse/0"), &workspace.cameras, &workspace.model);
        let found = read(dir.path(), &colmap_params()).unwrap();
        let names =
            |source: &crate::source::SourceCapture| source.frames.iter().map(|it| it.name.clone()).collect::<Vec<_>>();
        assert_eq!((names(&found), found.problems().len()), (names(&expected), 0));
        assert!(found.warnings.iter().any(|warning| warning.contains("without their folder")), "{:?}", found.warnings);
    }
}

/// Three images with a model in text files, whose lines of `images.txt` are changed or left out.
fn with_image_lines(change: impl Fn(&str) -> Option<&str>) -> tempfile::TempDir {
    let workspace = Workspace::video(3);
    let dir = workspace.write();
    let sparse = dir.path().join("sparse/0");
    std::fs::remove_dir_all(&sparse).unwrap();
    write_text(&sparse, &workspace.cameras, &workspace.model);
    let path = sparse.join("images.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    let lines: String = text.lines().filter_map(change).flat_map(|line| [line, "\n"]).collect();
    std::fs::write(path, lines).unwrap();
    dir
}

#[test]
fn missing_lines_of_keypoints_are_explained() {
    let dir = with_image_lines(|line| line.ends_with(".png").then_some(line));
    assert_refused(dir.path(), &colmap_params(), &["line 1", "each image has two lines", "images.txt"]);
}

#[test]
fn models_without_points_are_imported() {
    let dir = Workspace::video(6).write();
    std::fs::remove_file(dir.path().join("sparse/0/points3D.bin")).unwrap();
    let source = read(dir.path(), &colmap_params()).unwrap();
    assert!(source.points.is_empty() && source.problems().is_empty());
    assert_eq!(source.warnings, ["the model has no points: initial points will be random"]);
    let cloud = PointCloud { positions: vec![[1.0, 2.0, 3.0]; 2], colors: vec![[9; 3]; 2] };
    cloud.write_ply(&dir.path().join("sparse/0/points3D.ply"), PlyFormat::Ascii).unwrap();
    let source = read(dir.path(), &colmap_params()).unwrap();
    assert_eq!(source.points, [([1.0, 2.0, 3.0], [9; 3]); 2]);
    assert!(source.quality.unwrap().reprojection.is_none());
}

#[test]
fn placeholders_stand_for_keypoints() {
    let is_header = |line: &str| line.starts_with('#') || line.ends_with(".png");
    let dir = with_image_lines(|line| Some(if is_header(line) { line } else { "placeholder" }));
    std::fs::remove_file(dir.path().join("sparse/0/points3D.txt")).unwrap();
    let source = read(dir.path(), &colmap_params()).unwrap();
    assert_eq!((source.frames.len(), source.points.len()), (3, 0));
}

#[test]
fn the_smallest_copy_of_the_wanted_width_is_read() {
    let workspace = Workspace::video(6);
    let dir = workspace.write();
    write_copies(dir.path(), &workspace, "images_2", (12, 8), "png");
    write_copies(dir.path(), &workspace, "images_4", (6, 4), "jpg");
    let import = |width| run(dir.path(), &Params { width, ..colmap_params() }).unwrap();
    for (width, focal, protocol) in [
        (None, 30.0, "24×16 · resize none"),
        (Some(16), 20.0, "16×11 · resize area"),
        (Some(12), 15.0, "images at 1/2 split · 12×8 · resize none"),
        (Some(6), 7.5, "images at 1/4 split · 6×4 · resize none"),
        (Some(3), 3.75, "images at 1/4 split · 3×2 · resize area"),
    ] {
        let (_root, capture) = import(width);
        let line = capture.protocol.line();
        assert!(line.contains(protocol), "{width:?}: {line}");
        assert!((capture.views[0].camera.intrinsics.focal_x - focal).abs() <= 1e-12, "{width:?}");
        let mut frames: Vec<u32> = capture.views.iter().map(|view| view.frame_index).collect();
        frames.sort();
        assert_eq!(frames, [0, 1, 2, 3, 4, 5], "{width:?}");
    }
    std::fs::remove_dir_all(dir.path().join("images")).unwrap();
    let (_root, capture) = import(None);
    assert!(capture.protocol.line().contains("images at 1/2 split · 12×8"), "without originals, the largest copy");
    let smallest = Params { images: Some("images_4".into()), ..colmap_params() };
    let (_root, capture) = run(dir.path(), &smallest).unwrap();
    assert!(capture.protocol.line().contains("images at 1/4"), "{}", capture.protocol.line());
}

#[test]
fn copies_of_another_size_or_name_are_not_used() {
    let workspace = Workspace::video(6);
    let dir = workspace.write();
    write_copies(dir.path(), &workspace, "images_2", (12, 9), "png");
    write_copies(dir.path(), &workspace, "images_4", (6, 4), "png");
    std::fs::remove_file(dir.path().join("images_4/0003.png")).unwrap();
    let params = Params { width: Some(6), ..colmap_params() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    assert!(capture.protocol.line().contains("1 of 4 images split · 6×4 · resize area"), "{}", capture.protocol.line());
    let warnings = read(dir.path(), &params).unwrap().warnings;
    let expected =
        ["images_2 is not used: 0000.png is 12×9, not 1/2 of 24×16", "images_4 is not used: 0003.png is missing"];
    assert_eq!(warnings, expected);
}

#[test]
fn other_versions_of_an_image_are_not_frames() {
    let workspace = Workspace::video(6);
    let dir = workspace.write();
    let expected = frames(dir.path(), &colmap_params()).iter().map(|frame| frame.time_secs).collect::<Vec<_>>();
    for (id, image) in &workspace.model.images {
        let stem = image.name.strip_suffix(".png").unwrap();
        for other in [format!("{stem}.jpg"), format!("{stem}_mask.png"), format!("{stem}_depth.png")] {
            write_image(&dir.path().join("images").join(other), *id);
        }
        std::fs::write(dir.path().join("images").join(format!("._{stem}.png")), "\0").unwrap();
    }
    let source = read(dir.path(), &colmap_params()).unwrap();
    assert_eq!(source.frames.iter().map(|frame| frame.time_secs).collect::<Vec<_>>(), expected);
    assert_eq!(source.warnings, [""; 0]);
}

#[test]
fn one_image_per_fixed_camera_stands_for_its_frames() {
    for (name, sparse) in [("image{}.jpg", "sparse_"), ("cam0{}.png", "sparse/0")] {
        let workspace = Workspace::new(3, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |index| {
            name.replace("{}", &(index + 1).to_string())
        });
        let dir = tempfile::tempdir().unwrap();
        write_binary(&dir.path().join(sparse), &workspace.cameras, &workspace.model);
        for (camera, frame) in (1..=3).flat_map(|camera| (1..=4).map(move |frame| (camera, frame))) {
            write_image(&dir.path().join(format!("cam0{camera}/frame_{frame:05}.jpg")), 10 * camera + frame);
        }
        let source = read(dir.path(), &colmap_params()).unwrap();
        assert_eq!((source.problems().len(), source.frames.len(), source.camera_count()), (0, 12, 3));
        assert!(source.warnings.iter().any(|warning| warning.contains("fixed cameras")), "{:?}", source.warnings);
        for frame in &source.frames {
            let image = &workspace.model.images[&(frame.camera_index + 1)];
            assert_eq!(frame.camera_from_world, image.camera_from_world(), "{}", frame.name);
            let expected = format!("cam0{}_frame_{:05}", frame.camera_index + 1, frame.frame_index + 1);
            assert_eq!(frame.name, expected);
        }
        let error = source.quality.unwrap().reprojection.unwrap();
        assert!(error.recomputed_px <= 1e-9, "keypoints stay with the first frame: {error:?}");
    }
}

#[test]
fn unsuitable_folders_of_images_are_refused() {
    let workspace = Workspace::video(3);
    let dir = workspace.write();
    let mut refusals = Refusals::default();
    write_copies(dir.path(), &workspace, "half", (12, 8), "png");
    let named = |name: &str| Params { images: Some(name.into()), ..colmap_params() };
    refusals.add(dir.path(), &named("photos"));
    refusals.add(dir.path(), &named("half"));
    std::fs::rename(dir.path().join("images"), dir.path().join("input")).unwrap();
    assert_eq!(read(dir.path(), &colmap_params()).unwrap().warnings, ["images are read from input"]);
    std::fs::remove_dir_all(dir.path().join("input")).unwrap();
    refusals.add(dir.path(), &named("sparse"));
    std::fs::rename(dir.path().join("half/0000.png"), dir.path().join("half/a.png")).unwrap();
    std::fs::rename(dir.path().join("half"), dir.path().join("images")).unwrap();
    std::fs::remove_file(dir.path().join("images/0001.png")).unwrap();
    std::fs::remove_file(dir.path().join("images/0002.png")).unwrap();
    refusals.add(dir.path(), &colmap_params());
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn names_that_differ_in_their_extension_or_script_only_are_numbered() {
    let names = ["0.png", "0.tif", "ä.png", "ö.png", "0-2.png"];
    let dir = Workspace::new(5, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |index| names[index as usize].into()).write();
    let source = read(dir.path(), &colmap_params()).unwrap();
    assert!(source.problems().is_empty(), "{:?}", source.problems());
    let name = |image: &str| {
        let frame = source.frames.iter().find(|frame| frame.image.ends_with(image)).unwrap();
        frame.name.clone()
    };
    assert_eq!(names.map(name), ["0", "0-3", "_", "_-2", "0-2"]);
}

#[test]
fn folders_of_masks_and_maps_are_not_images() {
    let workspace = Workspace::video(3);
    let dir = workspace.write();
    for folder in ["depth", "flow_fwd", "masks"] {
        write_copies(dir.path(), &workspace, folder, (WIDTH, HEIGHT), "png");
    }
    std::fs::remove_dir_all(dir.path().join("images")).unwrap();
    assert_refused(
        dir.path(),
        &colmap_params(),
        &["the folder images does not exist", "put the images of the capture there"],
    );
    let warnings = read(dir.path(), &colmap_params()).unwrap().warnings.join("; ");
    assert!(warnings.contains("not read as images") && warnings.contains("depth, flow_fwd, masks"), "{warnings}");
    std::fs::create_dir(dir.path().join("images")).unwrap();
    assert_refused(dir.path(), &colmap_params(), &["the folder images is empty", "DIR/images/0000.png"]);
    std::fs::rename(dir.path().join("depth"), dir.path().join("input")).unwrap();
    let warnings = read(dir.path(), &colmap_params()).unwrap().warnings;
    assert!(warnings.iter().any(|warning| warning == "images are read from input"), "{warnings:?}");
}

#[test]
fn masks_of_the_originals_fit_smaller_copies() {
    let workspace = Workspace::video(4);
    let dir = workspace.write();
    write_copies(dir.path(), &workspace, "images_2", (12, 8), "png");
    for index in 0..4 {
        write_mask(&dir.path().join(format!("masks/{index:04}.png")), (WIDTH, HEIGHT), 255);
    }
    let (_root, capture) = run(dir.path(), &Params { width: Some(12), ..colmap_params() }).unwrap();
    assert!(capture.protocol.line().contains("images at 1/2"), "{}", capture.protocol.line());
    let mask = capture.load_mask(&capture.views[0]).unwrap().unwrap();
    assert_eq!(mask.labels[..12], [0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1]);
}

#[test]
fn webp_and_tiff_images_are_read() {
    let (_root, expected) = run(Workspace::video(6).write().path(), &colmap_params()).unwrap();
    for extension in ["webp", "tif"] {
        let name = |index| format!("{index:04}.{extension}");
        let workspace = Workspace::new(6, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], name);
        let dir = workspace.write();
        let (_root, capture) = run(dir.path(), &colmap_params()).unwrap();
        for (found, png) in capture.views.iter().zip(&expected.views) {
            assert_eq!(capture.load_image(found).unwrap(), expected.load_image(png).unwrap(), "{extension}");
        }
        let path = dir.path().join("images").join(name(3));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert_refused(dir.path(), &colmap_params(), &["image cannot be read"]);
    }
}
