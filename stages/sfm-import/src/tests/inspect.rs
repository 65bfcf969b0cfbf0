//! Reports and recipes of `inspect`.

use super::support::*;
use crate::inspect::{inspect, inspect_as};
use crate::{Format, Params};

#[test]
fn a_blender_capture_is_described_with_a_recipe() {
    insta::assert_snapshot!(describe(blender_scene().path()).unwrap());
}

#[test]
fn a_colmap_capture_is_described_with_its_reprojection_error() {
    insta::assert_snapshot!(describe(Workspace::video(10).write().path()).unwrap());
}

#[test]
fn problems_are_listed_without_a_recipe() {
    let dir = blender_scene();
    for index in 0..2 {
        std::fs::remove_file(dir.path().join(format!("val/r_00{index}.png"))).unwrap();
    }
    insta::assert_snapshot!(describe(dir.path()).unwrap());
    let inspection = inspect(dir.path()).unwrap();
    assert!(inspection.recipe().is_none());
    let json = serde_json::to_value(&inspection.captures[0]).unwrap();
    assert_eq!(json["problems"].as_array().unwrap().len(), 2);
    assert_eq!(json["frames"]["counts"]["train"], 5);
    assert_eq!(json["format"], "blender");
}

#[test]
fn a_folder_of_captures_lists_each() {
    let root = tempfile::tempdir().unwrap();
    for name in ["a", "b"] {
        let scene = blender_scene();
        std::fs::rename(scene.keep(), root.path().join(name)).unwrap();
    }
    std::fs::remove_file(root.path().join("b/test/r_000.png")).unwrap();
    std::fs::create_dir(root.path().join("notes")).unwrap();
    insta::assert_snapshot!(describe(root.path()).unwrap());
    insta::assert_snapshot!("import_of_a_folder_of_captures", refusal(root.path(), &Params::default()));
}

#[test]
fn unrecognised_folders_get_a_hint_for_their_files() {
    let cases: [&[&str]; 6] = [
        &[],
        &["notes.txt"],
        &["dataset.json", "camera/0.json"],
        &["poses_bounds.npy"],
        &["cam00.mp4"],
        &["cameras.bin"],
    ];
    let mut refusals = Refusals::default();
    for files in cases {
        let dir = tempfile::tempdir().unwrap();
        for file in files {
            let path = dir.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "x").unwrap();
        }
        refusals.add(dir.path(), &Params::default());
        let text = describe(dir.path()).unwrap();
        assert!(text.contains("not recognised") && text.contains(&refusal(dir.path(), &Params::default())), "{text}");
    }
    insta::assert_snapshot!(refusals.text());
    assert!(describe(std::path::Path::new("/no/such/folder")).is_err());
}

#[test]
fn ambiguous_folders_need_a_format() {
    let mut refusals = Refusals::default();
    refusals.add(blender_scene().path(), &Params { format: Format::Colmap, ..Params::default() });
    let both = blender_scene();
    let model = Workspace::video(3).write();
    std::fs::rename(model.path().join("sparse"), both.path().join("sparse")).unwrap();
    refusals.add(both.path(), &Params::default());
    insta::assert_snapshot!(refusals.text());
    std::fs::rename(blender_scene().keep(), both.path().join("below")).unwrap();
    let text = describe(both.path()).unwrap();
    assert!(text.contains("both a blender and a colmap capture") && !text.contains("below"), "{text}");
    let recipe = inspect_as(both.path(), Format::Blender).unwrap().recipe().unwrap();
    assert!(recipe.contains("format = \"blender\""), "{recipe}");
    assert!(run(both.path(), &Params { format: Format::Blender, ..Params::default() }).is_ok());
}

#[test]
fn the_format_is_shown_for_unusable_files() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| json["camera_angle_x"] = serde_json::json!(0.0));
    insta::assert_snapshot!(describe(dir.path()).unwrap());
}

#[test]
fn impossible_poses_are_problems() {
    for (name, far) in [("a_pose_at_1e30", 1e30), ("a_pose_at_1e300", 1e300)] {
        let mut workspace = Workspace::video(10);
        workspace.model.images.get_mut(&3).unwrap().translation[0] = far;
        insta::assert_snapshot!(name, describe(workspace.write().path()).unwrap());
    }
}

#[test]
fn recipes_state_common_parameters_once() {
    let root = tempfile::tempdir().unwrap();
    for name in ["lego", "my {scene}"] {
        std::fs::rename(blender_scene().keep(), root.path().join(name)).unwrap();
    }
    let recipe = inspect(root.path()).unwrap().recipe().unwrap();
    insta::assert_snapshot!(shortened(&recipe, root.path()));
}

/// A Blender capture whose training images are drawn by `pixel`, which gets the index of the image, column and row.
fn drawn(pixel: impl Fn(usize, u32, u32) -> image::Rgba<u8>) -> tempfile::TempDir {
    let dir = blender_scene();
    for index in 0..5 {
        let path = dir.path().join("train").join(format!("r_{index:03}.png"));
        image::RgbaImage::from_fn(WIDTH, HEIGHT, |column, row| pixel(index, column, row)).save(path).unwrap();
    }
    dir
}

/// The warnings about the content of the images.
fn content_warnings(dir: &std::path::Path) -> Vec<String> {
    let warnings = inspect(dir).unwrap().captures.remove(0).warnings;
    warnings.into_iter().filter(|warning| !warning.contains("training views are few")).collect()
}

#[test]
fn a_white_floor_on_white_suggests_black() {
    let dir = drawn(|index, column, row| match (column, row) {
        (3..8, 4..6) => image::Rgba([90, index as u8, 10, 255]),
        (_, 8..) => image::Rgba([255, 254, 255, 255]),
        _ => image::Rgba([0, 0, 0, 0]),
    });
    let warnings = content_warnings(dir.path());
    let expected = "97 % of the pixels equal the background (white), although 50 % are opaque: a model cannot separate them from \
                    nothing and may lose all Gaussians; set background = \"black\"";
    let tiny = "the subject covers only 2.6 % of the pixels: crop the images around it, or keep their full width";
    assert_eq!(warnings, [expected, tiny]);
    assert!(inspect(dir.path()).unwrap().recipe().unwrap().contains("background = \"black\""));
}

#[test]
fn a_transparent_background_does_not_suggest_black() {
    let dir = drawn(|index, column, _| match column {
        0..4 => image::Rgba([9, 9, index as u8, 255]),
        _ => image::Rgba([255, 255, 255, 0]),
    });
    assert_eq!(content_warnings(dir.path()), [""; 0]);
    assert!(!inspect(dir.path()).unwrap().recipe().unwrap().contains("background"));
}

#[test]
fn equal_and_uniform_images_are_warned_of() {
    let equal = drawn(|_, column, row| image::Rgba([column as u8, row as u8, 77, 255]));
    assert_eq!(content_warnings(equal.path()), ["the 5 decoded images are equal: the capture shows one view"]);
    let uniform =
        drawn(|index, column, _| image::Rgba([if index == 2 { 7 } else { column as u8 }, index as u8, 77, 255]));
    assert_eq!(content_warnings(uniform.path()), ["1 of 5 decoded images have a single colour"]);
}

#[test]
fn damaged_images_are_found_before_the_import() {
    let dir = blender_scene();
    let path = dir.path().join("train/r_001.png");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
    let summary = inspect(dir.path()).unwrap().captures.remove(0);
    assert_eq!(summary.problems.len(), 1);
    assert!(summary.problems[0].message.contains("image cannot be read") && summary.params.is_none());
}

#[test]
fn cameras_at_one_place_are_warned_of() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| {
        for frame in json["frames"].as_array_mut().unwrap() {
            frame["transform_matrix"] = serde_json::json!(blender_matrix(1));
        }
    });
    assert!(content_warnings(dir.path())[0].starts_with("all training cameras are at one place"));
    assert_eq!(content_warnings(blender_scene().path()), [""; 0]);
}

#[test]
fn ignored_files_are_named() {
    let dir = Workspace::video(12).write();
    for file in
        ["notes.txt", "database.db", "images/0003.json", "images/0004.json", "old/a.png", "old/b.png", ".DS_Store"]
    {
        let path = dir.path().join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "x").unwrap();
    }
    write_mask(&dir.path().join("masks/other.png"), (WIDTH, HEIGHT), 255);
    std::fs::create_dir(dir.path().join("sparse/1")).unwrap();
    let summary = inspect(dir.path()).unwrap().captures.remove(0);
    let expected = [
        "database.db (features and matches of COLMAP)",
        "notes.txt",
        "images/: 2 files that no frame names, e.g. 0003.json",
        "masks/: 1 entry (no PNG file in it has the name and size of an image)",
        "old/: 2 entries",
        "sparse/1/: 0 entries",
    ];
    assert_eq!(summary.ignored, expected);
    let in_one_folder = tempfile::tempdir().unwrap();
    let workspace = Workspace::video(12);
    super::colmap_files::write_binary(in_one_folder.path(), &workspace.cameras, &workspace.model);
    for (id, image) in &workspace.model.images {
        write_image(&in_one_folder.path().join(&image.name), *id);
    }
    assert_eq!(inspect(in_one_folder.path()).unwrap().captures[0].ignored, [""; 0]);
}

/// A workspace whose images are named by `name` and surround the scene, 30° apart.
fn ring(name: impl Fn(u32) -> String) -> Workspace {
    let mut workspace = Workspace::new(12, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], name);
    for (id, image) in &mut workspace.model.images {
        let angle = std::f64::consts::TAU * f64::from(*id) / 12.0;
        let position = glam::DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0);
        let pose = scene::Camera::look_at(intrinsics(), position, glam::DVec3::ZERO, glam::DVec3::Z).camera_from_world;
        let q = glam::DQuat::from_mat3(&pose.rotation);
        (image.quaternion, image.translation) = ([q.w, q.x, q.y, q.z], pose.translation.to_array());
    }
    workspace
}

#[test]
fn photos_around_a_scene_are_one_instant() {
    let apart = "successive images are turned by 29°, more than in a video";
    for (workspace, reason) in [
        (ring(|index| format!("IMG_{}.png", 1000 + index)), apart),
        (Workspace::new(12, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |i| format!("cam{i:02}.png")), "named like cameras"),
    ] {
        let dir = workspace.write();
        let inspection = inspect(dir.path()).unwrap();
        let (summary, recipe) = (&inspection.captures[0], inspection.recipe().unwrap());
        assert!(summary.warnings.iter().any(|warning| warning.contains(reason)), "{:?}", summary.warnings);
        assert_eq!(summary.frames.as_ref().unwrap().time_range_secs, None);
        assert!(
            recipe.contains("every_nth = 8, static = true }") && recipe.contains("# static = true: all"),
            "{recipe}"
        );
        let warnings = crate::recognise::read(dir.path(), &colmap_params()).unwrap().warnings.join("; ");
        assert!(warnings.contains(reason) && warnings.contains("set static = true"), "{warnings}");
        let chosen = Params { static_scene: Some(true), ..colmap_params() };
        assert!(!crate::recognise::read(dir.path(), &chosen).unwrap().warnings.join("; ").contains(reason));
    }
    // Small turns with four digits, as in the names of rendered frames, or with many images are those of a video.
    type Name = fn(u32) -> String;
    let names: [(u32, Name); 2] =
        [(12, |index| format!("cam_{index:04}.png")), (101, |index| format!("cam{index}.png"))];
    for (count, name) in names {
        let video = Workspace::new(count, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], name).write();
        let recipe = inspect(video.path()).unwrap().recipe().unwrap();
        assert!(recipe.contains("fps = 30.0 }") && !recipe.contains("static = true:"), "{recipe}");
    }
    // A frame rate that `prepare` recorded means that the images come from a video.
    let prepared = ring(|index| format!("{index:04}.png")).write();
    std::fs::write(prepared.path().join("prepare.json"), r#"{ "fps": 2.0 }"#).unwrap();
    assert!(inspect(prepared.path()).unwrap().recipe().unwrap().contains("fps = 2.0"));
}

#[test]
fn one_image_per_camera_is_one_instant() {
    let mut workspace = Workspace::new(4, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |index| format!("left{index}/a.png"));
    let lens = workspace.model.cameras[&1];
    for id in 2..=4 {
        let (size, params) = (workspace.cameras[0].size, workspace.cameras[0].params.clone());
        workspace.cameras.push(super::colmap_files::StatedCamera { id, model: "PINHOLE", size, params });
        workspace.model.cameras.insert(id, lens);
        workspace.model.images.get_mut(&id).unwrap().camera_id = id;
    }
    let dir = workspace.write();
    let inspection = inspect(dir.path()).unwrap();
    assert!(inspection.recipe().unwrap().contains("static = true }"));
    assert!(!inspection.captures[0].warnings.join("; ").contains("intrinsics"), "the time is known");
}

#[test]
fn poses_with_axes_of_opencv_are_warned_of() {
    let dir = ring(|index| format!("{index:04}.png")).write();
    let source = crate::recognise::read(dir.path(), &Params { every_nth: 0, ..colmap_params() }).unwrap();
    super::nerfstudio_files::rewrite(dir.path(), &source, &super::nerfstudio_files::Rewriting::default());
    std::fs::remove_dir_all(dir.path().join("sparse")).unwrap();
    let is_warned = || {
        let warnings = inspect(dir.path()).unwrap().captures.remove(0).warnings;
        warnings.iter().any(|warning| warning.contains("negate the second and third column"))
    };
    assert!(!is_warned());
    let path = dir.path().join("transforms.json");
    let mut json: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for frame in json["frames"].as_array_mut().unwrap() {
        for (row, column) in [(0, 1), (0, 2), (1, 1), (1, 2), (2, 1), (2, 2)] {
            let value = &mut frame["transform_matrix"][row][column];
            *value = (-value.as_f64().unwrap()).into();
        }
    }
    std::fs::write(path, json.to_string()).unwrap();
    assert!(is_warned());
}

#[test]
fn captures_of_single_instants_can_be_joined_to_a_rig() {
    let root = tempfile::tempdir().unwrap();
    let capture = |at: u32, name: &str| {
        let workspace = Workspace::new(4, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |index| format!("{name}{index}.png"));
        std::fs::rename(workspace.write().keep(), root.path().join(format!("colmap_{at}"))).unwrap();
    };
    capture(0, "cam0");
    capture(1, "cam0");
    let text = describe(root.path()).unwrap();
    assert!(text.contains("join them in one folder") && text.contains("e.g. cam00/colmap_0.png"), "{text}");
    // The joined folder is a rig.
    for at in 0..2 {
        for camera in 0..4 {
            let image = root.path().join(format!("colmap_{at}/images/cam0{camera}.png"));
            let frame = root.path().join(format!("joined/cam0{camera}/colmap_{at}.png"));
            std::fs::create_dir_all(frame.parent().unwrap()).unwrap();
            std::fs::copy(image, frame).unwrap();
        }
    }
    std::fs::rename(root.path().join("colmap_0/sparse"), root.path().join("joined/sparse")).unwrap();
    let places = |frame: &crate::source::Frame| (frame.camera_index, frame.frame_index);
    let found: Vec<_> = frames(&root.path().join("joined"), &colmap_params()).iter().map(places).collect();
    assert_eq!(found, [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1), (3, 0), (3, 1)]);
    std::fs::remove_dir_all(root.path().join("joined")).unwrap();
    std::fs::remove_dir_all(root.path().join("colmap_0")).unwrap();
    capture(0, "camera");
    assert!(!describe(root.path()).unwrap().contains("join them"), "the cameras have other names");
}

#[test]
fn folders_with_equal_names_on_the_axis_are_numbered() {
    let root = tempfile::tempdir().unwrap();
    for name in ["take 1", "take_1", "äö", "üß"] {
        std::fs::rename(blender_scene().keep(), root.path().join(name)).unwrap();
    }
    let recipe: toml::Table = inspect(root.path()).unwrap().recipe().unwrap().parse().unwrap();
    let scenes: Vec<_> = recipe["axes"]["scene"].as_array().unwrap().iter().map(|it| it.as_str().unwrap()).collect();
    assert_eq!(scenes, ["take_1-2", "take_1", "__", "__-2"]);
    let of_rule = |rule: &toml::Value| {
        let texts = [&rule["when"]["scene"], &rule["nodes"]["capture"]["params"]["source"]];
        texts.map(|text| text.as_str().unwrap().to_owned())
    };
    let rules: Vec<_> = recipe["set"].as_array().unwrap().iter().map(of_rule).collect();
    assert_eq!(rules, [["take_1-2", "take 1"], ["__", "äö"], ["__-2", "üß"]]);
}

/// A video of 12 images with a file for each of them in `masks`.
fn with_masks(extension: &str) -> tempfile::TempDir {
    let dir = Workspace::video(12).write();
    for index in 0..12 {
        write_image(&dir.path().join(format!("masks/{index:04}.{extension}")), index);
    }
    dir
}

#[test]
fn the_subject_is_seeded_where_its_depth_is_known() {
    let dir = with_masks("png");
    let text = describe(dir.path()).unwrap();
    assert!(text.contains("builtin:video") && !text.contains("val_count"), "{text}");
    std::fs::remove_file(dir.path().join("sparse/0/points3D.bin")).unwrap();
    let text = describe(dir.path()).unwrap();
    assert!(text.contains("builtin:benchmark") && text.contains("missing     points that the cameras see"), "{text}");
    assert!(text.contains("ready to import") && !text.contains("nodes.layers"), "{text}");
    assert!(text.contains("zero_heads = true") && text.contains("labels = \"nonzero\""), "{text}");
    std::fs::remove_file(dir.path().join("masks/0003.png")).unwrap();
    assert!(!describe(dir.path()).unwrap().contains("labels = "), "not every image has a mask");
    write_image(&dir.path().join("masks/0003.png"), 3);
    // Files of depth in the unit of the capture need no points.
    write_image(&dir.path().join("maps/depth/0000.png"), 1);
    std::fs::write(dir.path().join("prepare.json"), r#"{ "fps": 30.0, "import": { "depth": { "kind": "z" } } }"#)
        .unwrap();
    assert!(describe(dir.path()).unwrap().contains("builtin:video"));
}

#[test]
fn a_short_video_keeps_its_training_views() {
    let dir = Workspace::video(5).write();
    (0..5).for_each(|index| write_mask(&dir.path().join(format!("masks/{index:04}.png")), (WIDTH, HEIGHT), 255));
    let recipe = inspect(dir.path()).unwrap().recipe().unwrap();
    assert!(recipe.contains("builtin:video") && recipe.contains("val_count = 0"), "{recipe}");
}

#[test]
fn masks_that_no_stage_reads_are_not_in_the_recipe() {
    let dir = with_masks("jpg");
    let text = describe(dir.path()).unwrap();
    assert!(text.contains("masks/: 12 entries (no PNG file in it"), "{text}");
    assert!(text.contains("missing     masks of the moving subject") && !text.contains("{scene}/masks"), "{text}");
    std::fs::write(dir.path().join("masks/0000.npy"), "").unwrap();
    assert!(describe(dir.path()).unwrap().contains("DIR/masks"));
}

#[test]
fn points_out_of_view_are_warned_of() {
    let mut workspace = Workspace::video(12);
    let is_warned = |workspace: &Workspace| {
        let warnings = inspect(workspace.write().path()).unwrap().captures.remove(0).warnings;
        warnings.iter().any(|warning| warning.starts_with("hardly any of the 6 points"))
    };
    assert!(!is_warned(&workspace));
    workspace.model.points.values_mut().for_each(|point| point.position.z += 100.0);
    assert!(is_warned(&workspace));
}

/// Root may read everything, so that this shows nothing then.
#[cfg(unix)]
#[test]
fn missing_permission_is_not_missing_data() {
    use std::os::unix::fs::PermissionsExt as _;
    let dir = with_masks("png");
    for folder in ["", "images", "masks", "sparse"] {
        let path = dir.path().join(folder);
        let set_mode = |mode| std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        set_mode(0o000);
        let is_root = std::fs::read_dir(&path).is_ok();
        let text = describe(dir.path()).unwrap();
        set_mode(0o755);
        assert!(is_root || text.contains("cannot read the folder (Permission denied"), "{folder}: {text}");
    }
}
