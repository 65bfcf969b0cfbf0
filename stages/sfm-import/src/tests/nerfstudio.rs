//! A single `transforms.json`: round trips of captures in other layouts, splits, and oddities.

use glam::{DMat4, DQuat, DVec3};
use scene::{Capture, LabelMap, Split};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::nerfstudio_files::{Rewriting, rewrite};
use super::support::*;
use crate::mask_polarity::SetPixels;
use crate::recognise::read;
use crate::source::SourceCapture;
use crate::{Format, Params, TestSplit};

/// Largest difference of cameras and points after a round trip: points are stored in single precision.
const TOLERANCE: f64 = 1e-6;

/// What ns-process-data applies to poses of COLMAP.
fn axes_of_nerfstudio() -> DMat4 {
    DMat4::from_cols_array_2d(&[
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ])
    .transpose()
}

/// A rotation about a skew axis, a shift, and a scale.
fn any_similarity() -> (DMat4, f64) {
    let rotation = DQuat::from_axis_angle(DVec3::new(0.3, -0.5, 0.8).normalize(), 2.1);
    (DMat4::from_rotation_translation(rotation, DVec3::new(0.4, -1.5, 2.0)), 0.37)
}

/// Asserts that two captures have the same views, and points in the same places, in any order of the points.
fn assert_same(found: &SourceCapture, expected: &SourceCapture) {
    assert_eq!(found.frames.len(), expected.frames.len());
    for frame in &expected.frames {
        let same = found.frames.iter().find(|other| other.image == frame.image).unwrap();
        assert_eq!(same.split, frame.split, "{}", frame.name);
        let (a, b) = (&same.camera_from_world, &frame.camera_from_world);
        assert!(a.rotation.abs_diff_eq(b.rotation, TOLERANCE), "{} {} {}", frame.name, a.rotation, b.rotation);
        assert!(a.translation.abs_diff_eq(b.translation, TOLERANCE), "{} {}", a.translation, b.translation);
        assert_eq!((same.lens, same.time_secs), (frame.lens, frame.time_secs), "{}", frame.name);
    }
    assert_eq!(found.points.len(), expected.points.len());
    for ((found, rgb), (expected, stated)) in found.points.iter().zip(&expected.points) {
        assert!(DVec3::from(*found).abs_diff_eq((*expected).into(), TOLERANCE), "{found:?} {expected:?}");
        assert_eq!(rgb, stated);
    }
}

/// Reads the rewritten capture and removes it again.
fn reread(dir: &TempDir, original: &SourceCapture, rewriting: &Rewriting, params: &Params) -> SourceCapture {
    rewrite(dir.path(), original, rewriting);
    read(dir.path(), &Params { format: Format::Nerfstudio, ..params.clone() }).unwrap()
}

/// A D-NeRF scene whose split files are gone after reading.
fn dnerf_scene() -> (TempDir, SourceCapture) {
    let dir = blender_scene();
    let original = read(dir.path(), &Params::default()).unwrap();
    for label in ["train", "val", "test"] {
        std::fs::remove_file(transforms_path(dir.path(), label)).unwrap();
    }
    (dir, original)
}

#[test]
fn a_dnerf_scene_survives_rewriting() {
    let (dir, original) = dnerf_scene();
    for applied in [None, Some((axes_of_nerfstudio(), 1.0)), Some(any_similarity())] {
        let rewriting = Rewriting { applied, is_timed: true, ..Rewriting::default() };
        let found = reread(&dir, &original, &rewriting, &Params::default());
        assert_same(&found, &original);
        assert_eq!((found.time_map, found.split_rule.as_str()), (original.time_map, "official"));
        let places = |capture: &SourceCapture| {
            capture.frames.iter().map(|frame| (frame.camera_index, frame.frame_index)).collect::<Vec<_>>()
        };
        assert_eq!(places(&found), places(&original));
    }
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!((capture.pose_source.as_str(), capture.views.len()), ("nerfstudio", 10));
}

/// A static COLMAP capture whose model is gone after reading, and parameters for it.
fn colmap_capture(model: &'static str, lens: &[f64]) -> (TempDir, SourceCapture, Params) {
    let dir = Workspace::new(9, model, lens, |index| format!("{index:04}.png")).write();
    let params = Params { static_scene: Some(true), ..colmap_params() };
    let original = read(dir.path(), &params).unwrap();
    std::fs::remove_dir_all(dir.path().join("sparse")).unwrap();
    (dir, original, params)
}

#[test]
fn colmap_captures_survive_rewriting() {
    let opencv = json!({ "camera_model": "OPENCV", "k1": -0.03, "k2": 0.01, "p1": 0.001, "p2": -0.002 });
    let fisheye = json!({ "camera_model": "OPENCV_FISHEYE", "k1": -0.03, "k2": 0.01, "k3": 0.001, "k4": -0.002 });
    let coefficients = [30.0, 31.0, 12.5, 8.0, -0.03, 0.01, 0.001, -0.002];
    for (count, distortion) in [(4, json!({ "camera_model": "PINHOLE" })), (8, opencv), (8, fisheye)] {
        let model = distortion["camera_model"].as_str().unwrap().to_owned().leak();
        let (dir, original, params) = colmap_capture(model, &coefficients[..count]);
        for applied in [None, Some((axes_of_nerfstudio(), 1.0)), Some(any_similarity())] {
            let rewriting = Rewriting { applied, distortion: distortion.clone(), ..Rewriting::default() };
            let found = reread(&dir, &original, &rewriting, &params);
            assert_same(&found, &original);
            assert_eq!(found.split_rule, "1 of 4 images");
            assert_eq!(found.frames[0].name, original.frames[0].name);
        }
    }
}

#[test]
#[should_panic(expected = "0000")]
fn a_forgotten_transform_is_a_difference() {
    let (dir, original, params) = colmap_capture("PINHOLE", &[30.0, 31.0, 12.5, 8.0]);
    let applied = Some((DMat4::from_rotation_x(1e-4), 1.0));
    rewrite(dir.path(), &original, &Rewriting { applied, ..Rewriting::default() });
    edit(dir.path(), |json| remove(json, &["applied_transform"]));
    assert_same(&read(dir.path(), &params).unwrap(), &original);
}

#[test]
fn clouds_of_early_versions_are_used_as_they_are() {
    let (dir, original, params) = colmap_capture("PINHOLE", &[30.0, 31.0, 12.0, 8.0]);
    let shift = DMat4::from_translation(DVec3::new(0.0, 20.0, 0.0));
    let applied = Some((shift * axes_of_nerfstudio(), 1.0));
    let rewriting = Rewriting { applied, keeps_points: true, ..Rewriting::default() };
    let found = reread(&dir, &original, &rewriting, &params);
    assert_same(&found, &original);
    assert!(found.warnings.iter().any(|warning| warning.contains("lacks applied_transform")), "{:?}", found.warnings);
}

/// Edits `transforms.json`.
fn edit(dir: &std::path::Path, edit: impl FnOnce(&mut Value)) {
    let path = dir.join("transforms.json");
    let mut json: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    edit(&mut json);
    std::fs::write(path, json.to_string()).unwrap();
}

/// A timed capture in one file, edited.
fn edited(change: impl FnOnce(&mut Value)) -> TempDir {
    let (dir, original) = dnerf_scene();
    rewrite(dir.path(), &original, &Rewriting { is_timed: true, ..Rewriting::default() });
    edit(dir.path(), change);
    dir
}

fn counts(capture: &Capture) -> [usize; 3] {
    [Split::Train, Split::Val, Split::Test].map(|split| capture.views_of(split).count())
}

fn remove(json: &mut Value, keys: &[&str]) {
    keys.iter().for_each(|key| drop(json.as_object_mut().unwrap().remove(*key)));
}

#[test]
fn splits_follow_lists_or_the_stated_rule() {
    let import = |dir: &TempDir| {
        let capture = run(dir.path(), &Params::default()).unwrap().1;
        (counts(&capture), capture.protocol.split)
    };
    let lists = ["train_filenames", "val_filenames", "test_filenames"];
    let untested = edited(|json| remove(json, &["test_filenames"]));
    assert_eq!(import(&untested), ([5, 0, 2], "official, tested on val".into()));
    let rest = edited(|json| remove(json, &["train_filenames"]));
    assert_eq!(import(&rest), ([5, 2, 3], "official".into()));
    let unlisted = edited(|json| drop(json["train_filenames"].as_array_mut().unwrap().pop()));
    assert_eq!(import(&unlisted), ([4, 2, 3], "official".into()));
    let overlapping = edited(|json| json["test_filenames"] = json["train_filenames"].as_array().unwrap()[..2].into());
    assert_eq!(import(&overlapping), ([3, 2, 2], "official".into()));
    // Three frames share the time 0: the folders are cameras, of which the first is held out.
    let none = edited(|json| remove(json, &lists));
    assert_eq!(import(&none), ([7, 0, 3], "1 of 8 cameras".into()));
    let still = edited(|json| {
        remove(json, &lists);
        json["frames"].as_array_mut().unwrap().iter_mut().for_each(|frame| remove(frame, &["time"]));
    });
    assert_eq!(import(&still), ([8, 0, 2], "1 of 8 images".into()));
    let capture = run(still.path(), &Params { every_nth: 0, ..Params::default() }).unwrap().1;
    assert_eq!(capture.time_map.end_secs, 0.0);
    let names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names[..4], ["test_r_000", "test_r_001", "test_r_002", "train_r_000"]);
}

#[test]
fn lists_of_a_video_leave_its_frames_numbered_as_one_recording() {
    let frames = |dir: &TempDir| {
        let frames = read(dir.path(), &Params::default()).unwrap().frames;
        let mut numbers: Vec<u32> = frames.iter().map(|frame| frame.frame_index).collect();
        numbers.sort_unstable();
        (frames, numbers)
    };
    let video = edited(|json| {
        let frames = json["frames"].as_array_mut().unwrap();
        frames.iter_mut().zip(0..).for_each(|(frame, at)| frame["time"] = (f64::from(at) / 9.0).into());
    });
    let (ranked, numbers) = frames(&video);
    assert_eq!(numbers, (0..10).collect::<Vec<_>>());
    assert!(ranked.iter().all(|frame| f64::from(frame.frame_index) == (frame.time_secs * 9.0).round()));
    // A test view at the time of a training view of the same camera belongs to another recording.
    let apart = edited(|json| {
        let frames = json["frames"].as_array_mut().unwrap();
        frames.iter_mut().zip(0..).for_each(|(frame, at)| frame["time"] = (f64::from(at % 5) / 4.0).into());
    });
    assert!(frames(&apart).1.windows(2).any(|pair| pair[0] == pair[1]));
}

/// Moves the last `count` frames of a file without lists and times to `test_frames`.
fn with_test_frames(json: &mut Value, count: usize) {
    remove(json, &["train_filenames", "val_filenames", "test_filenames"]);
    let frames = json["frames"].as_array_mut().unwrap();
    frames.iter_mut().for_each(|frame| remove(frame, &["time"]));
    json["test_frames"] = frames.split_off(frames.len() - count).into();
}

#[test]
fn test_frames_are_the_test_views_and_bad_frames_are_left_out() {
    let counts_of = |dir: &TempDir| {
        let source = read(dir.path(), &Params::default()).unwrap();
        assert!(source.problems().is_empty(), "{:?}", source.problems());
        let counts = [Split::Train, Split::Val, Split::Test].map(|split| source.count(split));
        (
            counts,
            source.split_rule,
            source.warnings.iter().any(|it| it == "2 frames are marked by is_bad and are left out"),
        )
    };
    let dir = edited(|json| with_test_frames(json, 4));
    assert_eq!(counts_of(&dir), ([6, 0, 4], "official".into(), false));
    edit(dir.path(), |json| {
        (json["frames"][0]["is_bad"], json["frames"][1]["is_bad"]) = (true.into(), false.into());
        json["test_frames"][0]["is_bad"] = true.into();
    });
    assert_eq!(counts_of(&dir), ([5, 0, 3], "official".into(), true));
    // With a list of validation views, they do not become training views.
    edit(dir.path(), |json| json["val_filenames"] = json!([json["frames"][1]["file_path"]]));
    assert_eq!(counts_of(&dir), ([4, 1, 3], "official".into(), true));
    // The validation views replace them.
    let on_val = Params { test_split: TestSplit::Val, ..Params::default() };
    let source = read(dir.path(), &on_val).unwrap();
    let counts = [Split::Train, Split::Val, Split::Test].map(|split| source.count(split));
    assert_eq!((counts, source.split_rule.as_str()), ([4, 0, 1], "official, tested on val"));
    edit(dir.path(), |json| remove(json, &["val_filenames"]));
    assert_refused(dir.path(), &on_val, &["test_split = \"val\", but the file has no val_filenames"]);
}

#[test]
fn scenes_of_scannetpp_are_read_as_distributed() {
    let dir = edited(|json| {
        with_test_frames(json, 3);
        for list in ["frames", "test_frames"] {
            for frame in json[list].as_array_mut().unwrap() {
                frame["file_path"] = frame["file_path"].as_str().unwrap().replace('/', "_").into();
            }
        }
    });
    let scene = tempfile::tempdir().unwrap();
    let dslr = scene.path().join("dslr");
    for folder in ["colmap", "nerfstudio", "resized_images"] {
        std::fs::create_dir_all(dslr.join(folder)).unwrap();
    }
    for name in crate::image_names::image_names(dir.path()) {
        std::fs::copy(dir.path().join(&name), dslr.join("resized_images").join(name.replace('/', "_"))).unwrap();
    }
    std::fs::copy(dir.path().join("transforms.json"), dslr.join("nerfstudio/transforms.json")).unwrap();
    std::fs::write(dslr.join("colmap/cameras.txt"), "").unwrap();
    std::fs::write(dslr.join("colmap/images.txt"), "").unwrap();
    let source = read(&dslr, &Params::default()).unwrap();
    assert!(source.problems().is_empty(), "{:?}", source.problems());
    assert_eq!([source.count(Split::Train), source.count(Split::Test)], [7, 3]);
    assert!(!source.warnings.iter().any(|it| it.contains("by the end of their paths")), "{:?}", source.warnings);
    assert_refused(scene.path(), &Params::default(), &["name one of them, e.g. dslr"]);
    // A folder without the images leads to the one that has them.
    let hint = format!("name {}, which contains both", dslr.display());
    assert_refused(&dslr.join("nerfstudio"), &Params::default(), &["image file is missing", &hint]);
    let missing =
        crate::files::image_size(&dslr.join("colmap/images").join(crate::files::name(&source.frames[0].image)));
    assert!(missing.unwrap_err().to_string().contains(&hint));
}

#[test]
fn masks_depths_and_bounds_are_imported() {
    let dir = edited(|json| {
        for (index, frame) in json["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
            frame["mask_path"] = format!("masks/{index}.png").into();
            frame["depth_file_path"] = format!("depth/{index}.png").into();
        }
        json["aabb"] = json!([[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]]);
    });
    std::fs::create_dir(dir.path().join("depth")).unwrap();
    for index in 0..10 {
        write_mask(&dir.path().join(format!("masks/{index}.png")), (WIDTH, HEIGHT), 255);
        let millimetres = |column: u32, _| image::Luma([if column < 6 { 0_u16 } else { 1500 }]);
        let depth = image::ImageBuffer::<image::Luma<u16>, _>::from_fn(WIDTH / 2, HEIGHT / 2, millimetres);
        depth.save(dir.path().join(format!("depth/{index}.png"))).unwrap();
    }
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let view = &capture.views[3];
    let depth = capture.load_depth(view).unwrap().unwrap();
    assert_eq!((depth.width, depth.height, depth.depth_view[2], depth.depth_view[23]), (WIDTH, HEIGHT, 0.0, 1.5));
    let LabelMap { labels, .. } = capture.load_mask(view).unwrap().unwrap();
    assert_eq!((labels[2], labels[23]), (0, 1));
    assert_eq!(capture.bounds_world, Some([[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]]));
    let metres = Params { depth_unit: Some(1.0), ..Params::default() };
    let (_root, capture) = run(dir.path(), &metres).unwrap();
    assert_eq!(capture.load_depth(&capture.views[3]).unwrap().unwrap().depth_view[23], 1500.0);
    edit(dir.path(), |json| json["depth_unit_scale_factor"] = 0.01.into());
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!(capture.load_depth(&capture.views[3]).unwrap().unwrap().depth_view[23], 15.0);
}

#[test]
fn images_are_found_by_the_end_of_foreign_paths() {
    let dir = edited(|json| {
        for frame in json["frames"].as_array_mut().unwrap() {
            frame["file_path"] = format!("D:\\scans\\one/{}", frame["file_path"].as_str().unwrap()).into();
        }
        remove(json, &["train_filenames", "val_filenames", "test_filenames"]);
    });
    let capture = read(dir.path(), &Params::default()).unwrap();
    assert!(capture.problems().is_empty());
    assert!(
        capture.warnings[0].starts_with("10 images are found by the end of their paths, e.g. test/r_000.png for D:")
    );
}

#[test]
fn equal_names_in_other_folders_are_other_images() {
    let dir = edited(|json| remove(json, &["train_filenames", "val_filenames", "test_filenames"]));
    let images = dir.path().join("images");
    std::fs::create_dir(&images).unwrap();
    for name in crate::image_names::image_names(dir.path()) {
        let path = dir.path().join(name);
        std::fs::rename(&path, images.join(crate::files::name(&path))).unwrap();
    }
    assert_refused(dir.path(), &Params::default(), &["image file is missing"]);
}

#[test]
fn one_image_with_two_poses_has_no_two_names() {
    let dir = edited(|json| {
        json["frames"][1]["file_path"] = json["frames"][0]["file_path"].clone();
        json["frames"][1]["time"] = 0.001.into();
        remove(json, &["train_filenames", "val_filenames", "test_filenames"]);
    });
    assert_refused(dir.path(), &Params::default(), &["two views are named", "list every image once"]);
}

#[test]
fn usual_mistakes_are_named() {
    let refused = |change: fn(&mut Value), parts: &[&str]| {
        let dir = edited(change);
        std::fs::write(dir.path().join("a.bmp"), "BM").unwrap();
        assert_refused(dir.path(), &Params::default(), parts);
    };
    refused(|json| json["frames"][2]["time"] = "0.5".into(), &["time of frame 2 is \"0.5\"", "not a number"]);
    refused(|json| json["w"] = "24".into(), &["w at the top is \"24\""]);
    refused(|json| json["frames"][0]["camera_model"] = "EQUIRECTANGULAR".into(), &["perspective views"]);
    refused(|json| json["frames"][0]["file_path"] = "a.bmp".into(), &["a.bmp is not an image", "convert"]);
    refused(
        |json| (json["frames"][0]["w"], json["frames"][0]["h"]) = (16.into(), 24.into()),
        &["image is 24×16, but", "auto-orient"],
    );
    for model in ["opencv", "PERSPECTIVE", "pinhole"] {
        let dir = edited(|json| (json["frames"][0]["camera_model"], json["is_fisheye"]) = (model.into(), Value::Null));
        assert!(read(dir.path(), &Params::default()).unwrap().problems().is_empty(), "{model}");
    }
}

#[test]
fn extensions_may_differ_and_paths_may_turn_back() {
    type Change = fn(&str) -> String;
    let stated = |change: Change| {
        edited(|json| {
            for frame in json["frames"].as_array_mut().unwrap() {
                frame["file_path"] = change(frame["file_path"].as_str().unwrap()).into();
            }
            remove(json, &["train_filenames", "val_filenames", "test_filenames"]);
        })
    };
    let upper = |dir: &std::path::Path| {
        for name in crate::image_names::image_names(dir) {
            std::fs::rename(dir.join(&name), dir.join(&name).with_extension("PNG")).unwrap();
        }
    };
    let without: Change = |path| path.trim_end_matches(".png").to_owned();
    let changes: [(bool, Change); 5] = [
        (true, |path| path.to_owned()),
        (true, without),
        (false, |path| path.replace(".png", ".jpg")), // the images were converted
        (false, |path| format!("other/../{path}")),
        (false, |path| format!("../capture/{path}")),
    ];
    for (is_upper, change) in changes {
        let dir = stated(change);
        if is_upper {
            upper(dir.path());
        }
        let source = read(dir.path(), &Params::default()).unwrap();
        assert!(source.problems().is_empty(), "{:?}", source.problems());
        assert_eq!(
            source.warnings.iter().any(|it| it.contains("by the end of their paths")),
            change("a").starts_with("../")
        );
    }
}

#[test]
fn faults_are_refused_with_their_reason() {
    let mut refusals = Refusals::default();
    let mut add = |change: &dyn Fn(&mut Value)| refusals.add(edited(change).path(), &Params::default());
    add(&|json| json["frames"].as_array_mut().unwrap().iter_mut().for_each(|frame| frame["file_path"] = "".into()));
    add(&|json| json["frames"][1]["file_path"] = "/data/images/r_000.png".into());
    add(&|json| json["frames"][1]["camera_angle_x"] = 2.0.into());
    add(&|json| json["frames"][1]["fl_x"] = 0.7.into());
    add(&|json| json["frames"][1]["camera_model"] = "EQUIRECTANGULAR".into());
    add(&|json| json["applied_transform"] = json!([[1, 0, 0, 0], [0, 1, 0, 0]]));
    add(&|json| json["applied_transform"] = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]]));
    add(&|json| json["applied_transform"] = json!([[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0]]));
    add(&|json| json["applied_scale"] = 0.into());
    add(&|json| json["test_filenames"][0] = "test/r_999.png".into());
    add(&|json| json["frames"][1]["transform_matrix"] = json!([[1, 0, 0, 0]]));
    add(&|json| remove(&mut json["frames"][1], &["time"]));
    add(&|json| json["frames"][2]["file_path"] = json["frames"][1]["file_path"].clone());
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn transforms_are_preferred_to_the_model_that_they_come_from() {
    let (dir, original, params) = colmap_capture("PINHOLE", &[30.0, 31.0, 12.0, 8.0]);
    rewrite(dir.path(), &original, &Rewriting::default());
    assert_eq!(read(dir.path(), &params).unwrap().warnings.len(), 0);
    let model = Workspace::video(9).write();
    std::fs::create_dir(dir.path().join("colmap")).unwrap();
    std::fs::rename(model.path().join("sparse"), dir.path().join("colmap/sparse")).unwrap();
    let found = read(dir.path(), &Params::default()).unwrap();
    assert_eq!((found.format, found.time_map.end_secs), (Format::Nerfstudio, 0.0));
    assert!(found.warnings[1].contains("set format = \"colmap\""), "{:?}", found.warnings);
    let video = read(dir.path(), &Params { format: Format::Colmap, ..Params::default() }).unwrap();
    assert!(video.time_map.end_secs > 0.0);
}

#[test]
fn the_recipe_of_inspect_imports_what_it_describes() {
    let lists = ["train_filenames", "val_filenames", "test_filenames"];
    let only_train = blender_scene();
    ["val", "test"].iter().for_each(|label| std::fs::remove_file(transforms_path(only_train.path(), label)).unwrap());
    for dir in [edited(|_| ()), edited(|json| remove(json, &lists)), only_train] {
        let recipe = crate::inspect::inspect(dir.path()).unwrap().recipe().unwrap();
        let recipe: toml::Table = recipe.parse().unwrap();
        let params: Params = recipe["nodes"]["capture"]["params"].clone().try_into().unwrap();
        assert!(params.problems().is_empty());
        let counts = counts(&run(dir.path(), &params).unwrap().1);
        assert!(counts[0] > 0 && counts[2] > 0, "{counts:?}");
    }
}

#[test]
fn oddities_are_warnings() {
    let dir = edited(|json| {
        json["frames"][1]["file_path"] = "".into();
        json["train_filenames"].as_array_mut().unwrap().remove(1);
        json["frames"][2]["mask_path"] = "masks/none.png".into();
        json["frames"][3]["camera_angle_x"] =
            json!(2.0 * (12.0 / (1.05 * json["frames"][3]["fl_x"].as_f64().unwrap())).atan());
        json["ply_file_path"] = "none.ply".into();
        json["aabb"] = json!([1, 2]);
    });
    insta::assert_snapshot!(describe(dir.path()).unwrap());
}

/// The frames of one moving camera, in one folder and without lists of file names, at these times.
fn moving_camera(times: &[f64]) -> TempDir {
    let dir = Workspace::video(times.len() as u32).write();
    let original = read(dir.path(), &colmap_params()).unwrap();
    std::fs::remove_dir_all(dir.path().join("sparse")).unwrap();
    rewrite(dir.path(), &original, &Rewriting { is_timed: true, ..Rewriting::default() });
    edit(dir.path(), |json| {
        remove(json, &["train_filenames", "val_filenames", "test_filenames"]);
        let frames = json["frames"].as_array_mut().unwrap().iter_mut();
        frames.zip(times).for_each(|(frame, time)| frame["time"] = (*time).into());
    });
    dir
}

#[test]
fn axes_that_meet_behind_the_cameras_are_a_warning() {
    let dir = moving_camera(&(0..12).map(|index| f64::from(index) / 11.0).collect::<Vec<_>>());
    std::fs::remove_file(dir.path().join("sparse_pc.ply")).unwrap();
    let warns = || describe(dir.path()).unwrap().contains("the optical axes meet behind the cameras");
    assert!(!warns());
    edit(dir.path(), |json| {
        remove(json, &["ply_file_path"]);
        for frame in json["frames"].as_array_mut().unwrap() {
            for row in frame["transform_matrix"].as_array_mut().unwrap() {
                (1..3).for_each(|column| row[column] = (-row[column].as_f64().unwrap()).into());
            }
        }
    });
    assert!(warns());
}

#[test]
fn a_few_repeated_times_are_those_of_one_camera() {
    let frame_secs = 1.0 / 23.0;
    let times = |frame: fn(usize) -> f64| (0..24).map(|index| frame_secs * frame(index)).collect::<Vec<_>>();
    let once = times(|index| if index == 12 { 11.0 } else { index as f64 });
    let rounded: Vec<f64> = times(|index| index as f64).iter().map(|time| (20.0 * time).round() / 20.0).collect();
    for (times, repeated) in [(once, 2), (rounded.clone(), 6)] {
        let dir = moving_camera(&times);
        let source = read(dir.path(), &Params::default()).unwrap();
        assert!(source.problems().is_empty(), "{:?}", source.problems());
        assert_eq!([source.camera_count(), source.count(Split::Train), source.count(Split::Test)], [1, 21, 3]);
        let warning = format!("{repeated} frames share their time with another");
        assert!(source.warnings.iter().any(|it| it.starts_with(&warning)), "{:?}", source.warnings);
        assert!((source.time_map.frame_secs - frame_secs).abs() <= 0.2 * frame_secs, "{:?}", source.time_map);
        let mut frames: Vec<_> = source.frames.iter().collect();
        frames.sort_by(|a, b| a.time_secs.total_cmp(&b.time_secs));
        assert!(frames.is_sorted_by(|a, b| a.name < b.name && a.time_secs < b.time_secs), "the order is kept");
        let is_near = |frame: &&crate::source::Frame| {
            let stated = times[frame.name.parse::<usize>().unwrap()];
            (frame.time_secs - stated).abs() <= frame_secs
        };
        assert!(frames.iter().all(is_near));
    }
    // Three moving cameras.
    let rig = read(moving_camera(&times(|index| (index / 3) as f64)).path(), &Params::default()).unwrap();
    assert_eq!((rig.camera_count(), rig.count(Split::Test)), (3, 8));
    assert!(rig.warnings.iter().any(|it| it.contains("numbered as cameras")), "{:?}", rig.warnings);
}

#[test]
fn points_of_the_model_are_used_in_the_world_of_the_frames() {
    // Early versions of nerfstudio turned the world without stating it.
    for is_stated in [true, false] {
        let (dir, original, params) = colmap_capture("PINHOLE", &[30.0, 31.0, 12.0, 8.0]);
        let workspace = Workspace::new(9, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], |index| format!("{index:04}.png"));
        super::colmap_files::write_binary(&dir.path().join("colmap/sparse/0"), &workspace.cameras, &workspace.model);
        let applied = Some((axes_of_nerfstudio(), 1.0));
        rewrite(dir.path(), &original, &Rewriting { applied, ..Rewriting::default() });
        std::fs::remove_file(dir.path().join("sparse_pc.ply")).unwrap();
        edit(dir.path(), |json| {
            remove(json, &["ply_file_path"]);
            if !is_stated {
                remove(json, &["applied_transform", "applied_scale"]);
            }
        });
        let found = read(dir.path(), &params).unwrap();
        assert_eq!((found.points.len(), found.has_cloud()), (original.points.len(), Some(true)));
        // The images show the points where they were.
        let seen = |source: &SourceCapture| {
            let frame = source.frames.iter().find(|frame| frame.name == "0003").unwrap();
            source.points.iter().map(|(point, _)| frame.camera_from_world.apply((*point).into())).collect::<Vec<_>>()
        };
        assert!(seen(&found).iter().zip(seen(&original)).all(|(a, b)| a.abs_diff_eq(b, TOLERANCE)), "{is_stated}");
        assert!(!describe(dir.path()).unwrap().contains("ignored"));
        edit(dir.path(), |json| json["frames"][3]["transform_matrix"][0][3] = 0.5.into());
        let found = read(dir.path(), &params).unwrap();
        assert!(found.points.is_empty() && found.warnings.iter().any(|it| it.contains("name it by ply_file_path")));
    }
}

/// A rig of four fixed cameras with `instants` instants, in a folder each if `has_folders`; `time` of a camera and an instant.
fn fixed_rig(instants: usize, has_folders: bool, time: impl Fn(usize, usize) -> f64) -> TempDir {
    let dir = moving_camera(&vec![0.0; 4 * instants]);
    edit(dir.path(), |json| {
        let frames = json["frames"].as_array_mut().unwrap();
        let poses: Vec<Value> = (0..4).map(|camera| frames[3 * camera]["transform_matrix"].clone()).collect();
        for (index, frame) in frames.iter_mut().enumerate() {
            let (camera, instant) = (index / instants, index % instants);
            frame["transform_matrix"] = poses[camera].clone();
            frame["time"] = time(camera, instant).into();
            if has_folders {
                let path = format!("cam{camera}/{instant:04}.png");
                write_image(&dir.path().join(&path), index as u32);
                frame["file_path"] = path.into();
            }
        }
    });
    dir
}

#[test]
fn time_stamps_of_a_rig_may_differ_by_fractions_of_a_frame() {
    // Constant delays of triggers, then noise.
    let delayed = |camera: usize, instant: usize| instant as f64 / 30.0 + 0.0014 * camera as f64;
    let noisy = |camera: usize, instant: usize| {
        instant as f64 / 30.0 + 0.004 * (7.0 * camera as f64 + 3.0 * instant as f64).sin()
    };
    for has_folders in [true, false] {
        for dir in [fixed_rig(10, has_folders, delayed), fixed_rig(10, has_folders, noisy)] {
            let source = read(dir.path(), &Params::default()).unwrap();
            assert!(source.problems().is_empty(), "{:?}", source.problems());
            assert_eq!([source.camera_count(), source.count(Split::Train), source.count(Split::Test)], [4, 30, 10]);
            assert_eq!(source.frames.iter().map(|frame| frame.frame_index).max(), Some(9));
            assert!((source.time_map.frame_secs - 1.0 / 30.0).abs() <= 2e-3, "{:?}", source.time_map);
            assert!(source.warnings.iter().any(|it| it.contains("the times of a rig differ by up to 0.00")));
        }
        let exact = fixed_rig(10, has_folders, |_, instant| instant as f64 / 30.0);
        let exact = read(exact.path(), &Params::default()).unwrap();
        assert_eq!((exact.camera_count(), exact.time_map.frame_secs), (4, 1.0 / 30.0));
        assert!(exact.warnings.iter().all(|it| !it.contains("the times of a rig")), "{:?}", exact.warnings);
        // One camera jumps between four places.
        let jumping = fixed_rig(10, has_folders, |camera, instant| (4 * instant + camera) as f64 / 30.0);
        assert_eq!(read(jumping.path(), &Params::default()).unwrap().camera_count(), 1);
    }
}

#[test]
fn masks_that_mark_what_is_static_are_inverted() {
    let dir = moving_camera(&[0.0, 0.1, 0.2, 0.3]);
    let masks = dir.path().join("masks");
    let written = |ending: &str| {
        std::fs::create_dir_all(&masks).unwrap();
        let kept = image::GrayImage::from_fn(WIDTH, HEIGHT, |x, _| image::Luma([if x < 6 { 0 } else { 255 }]));
        (0..4).for_each(|index| kept.save(masks.join(format!("{index:04}{ending}"))).unwrap());
    };
    let found = || {
        let source = read(dir.path(), &Params::default()).unwrap();
        (source.set_pixels, source.warnings.join("\n"))
    };
    let named = |key: &str| {
        edit(dir.path(), |json| {
            let frames = json["frames"].as_array_mut().unwrap().iter_mut().enumerate();
            frames.for_each(|(index, frame)| frame[key] = format!("masks/{index:04}.png").into());
        });
    };
    written(".png.png");
    let (set_pixels, warnings) = found();
    assert_eq!(set_pixels, SetPixels::Static);
    assert!(warnings.contains("0000.png.png, and most of their pixels are set"), "{warnings}");
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let labels = capture.load_mask(&capture.views[0]).unwrap().unwrap().labels;
    assert_eq!((labels[0], labels[23]), (1, 0));

    std::fs::remove_dir_all(&masks).unwrap();
    written(".png");
    let (set_pixels, warnings) = found();
    assert_eq!(set_pixels, SetPixels::Moving);
    assert!(warnings.contains("if set pixels are static, invert the masks"), "{warnings}");
    named("mask_path");
    let (set_pixels, warnings) = found();
    assert_eq!(set_pixels, SetPixels::Static);
    assert!(warnings.contains("if set pixels move, name the key fg_mask_path"), "{warnings}");
    // The mask of the subject counts, with or without the other key.
    named("fg_mask_path");
    let (set_pixels, warnings) = found();
    assert_eq!(set_pixels, SetPixels::Moving);
    assert!(!warnings.contains("set pixels"), "{warnings}");
}

#[test]
fn masks_that_start_with_another_number_are_warned_of() {
    let dir = moving_camera(&[0.0, 0.1, 0.2, 0.3]);
    (1..=4).for_each(|index| write_mask(&dir.path().join(format!("masks/{index:04}.png")), (WIDTH, HEIGHT), 255));
    let warnings = read(dir.path(), &Params::default()).unwrap().warnings;
    assert!(warnings.iter().any(|it| it.starts_with("only 3 of 4 images have a mask")), "{warnings:?}");
    write_mask(&dir.path().join("masks/0000.png"), (WIDTH, HEIGHT), 255);
    let warnings = read(dir.path(), &Params::default()).unwrap().warnings;
    assert!(!warnings.iter().any(|it| it.contains("have a mask")), "{warnings:?}");
}
