//! Captures in the layout of Nerfies, HyperNeRF and DyCheck.

use std::path::Path;

use glam::{DMat3, DVec2, DVec3};
use scene::protocol::Preset;
use scene::{Camera, Split, facts};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::support::*;
use crate::recognise::read;
use crate::{Format, Params};

const SCALE: f64 = 0.05;
const CENTER: [f64; 3] = [3.0, -1.0, 8.0];
/// Distortion coefficients k1, k2, k3, p1, p2 of a phone camera.
pub(super) const BENT: [f64; 5] = [0.05, -0.02, 0.01, 0.001, -0.002];

/// The orientation (world to camera) and the centre of view `index`, in the units of the camera files.
fn pose(index: usize) -> (DMat3, DVec3) {
    let angle = 0.1 * index as f64;
    let position = DVec3::from(CENTER) + 40.0 * DVec3::new(angle.sin(), 0.2, -angle.cos());
    let camera = Camera::look_at(intrinsics(), position, DVec3::from(CENTER), DVec3::NEG_Y);
    (camera.camera_from_world.rotation, position)
}

fn camera_json(index: usize, distortion: [f64; 5]) -> Value {
    let (rotation, position) = pose(index);
    let [k1, k2, k3, p1, p2] = distortion;
    json!({
        "orientation": rotation.transpose().to_cols_array_2d(), // as rows
        "position": position.to_array(),
        "focal_length": 30.0,
        "principal_point": [11.5, 8.5],
        "skew": 0.0,
        "pixel_aspect_ratio": 1.1,
        "radial_distortion": [k1, k2, k3],
        "tangential_distortion": [p1, p2],
        "image_size": [WIDTH, HEIGHT],
    })
}

fn write_json(dir: &Path, name: &str, value: &Value) {
    let path = dir.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, value.to_string()).unwrap();
}

fn write_points(dir: &Path, shape: &str, values: &[f64]) {
    write_npy(&dir.join("points.npy"), shape, values);
}

/// Two unnormalised points near the centre.
const POINTS: [f64; 6] = [3.5, -1.5, 8.5, 2.0, -0.5, 9.0];

/// A capture of `count` frames from one camera, with images at 1x and 2x; every third view is held out.
pub(super) fn capture(count: usize, distortion: [f64; 5]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let ids: Vec<String> = (0..count).map(|index| format!("{:06}", index + 1)).collect();
    let (val, train): (Vec<_>, Vec<_>) = (0..count).partition(|index| index % 3 == 2);
    let named = |indices: Vec<usize>| indices.into_iter().map(|index| ids[index].clone()).collect::<Vec<_>>();
    let (train, val) = (named(train), named(val));
    write_json(dir.path(), "dataset.json", &json!({ "count": count, "ids": ids, "train_ids": train, "val_ids": val }));
    let entry = |index: usize| json!({ "warp_id": index, "appearance_id": index, "camera_id": 0 });
    let metadata: serde_json::Map<_, _> = ids.iter().enumerate().map(|(at, id)| (id.clone(), entry(at))).collect();
    write_json(dir.path(), "metadata.json", &Value::Object(metadata));
    write_json(dir.path(), "scene.json", &json!({ "scale": SCALE, "center": CENTER, "near": 0.1, "far": 3.0 }));
    write_points(dir.path(), "(2, 3)", &POINTS);
    for (index, id) in ids.iter().enumerate() {
        write_json(dir.path(), &format!("camera/{id}.json"), &camera_json(index, distortion));
        write_image(&dir.path().join(format!("rgb/1x/{id}.png")), index as u32);
        let half = image::RgbImage::from_pixel(WIDTH / 2, HEIGHT / 2, image::Rgb([0, 0, index as u8]));
        let path = dir.path().join(format!("rgb/2x/{id}.png"));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        half.save(path).unwrap();
    }
    dir
}

/// The pixel of an unnormalised point in the image at 1x, by the definition of the format.
fn defined_pixel(index: usize, point: DVec3, [k1, k2, k3, p1, p2]: [f64; 5]) -> DVec2 {
    let (rotation, position) = pose(index);
    let view = rotation * (point - position);
    let (x, y) = (view.x / view.z, view.y / view.z);
    let r2 = x * x + y * y;
    let d = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
    let bent_x = x * d + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
    let bent_y = y * d + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y);
    DVec2::new(30.0 * bent_x + 11.5, 30.0 * 1.1 * bent_y + 8.5)
}

#[test]
fn points_project_as_the_format_defines() {
    let dir = capture(7, BENT);
    for (width, factor) in [(None, 1.0), (Some(WIDTH / 2), 2.0)] {
        let params = Params { width, ..Params::default() };
        let source = read(dir.path(), &params).unwrap();
        assert!(source.problems().is_empty(), "{:?}", source.problems());
        for frame in &source.frames {
            let index = frame.frame_index as usize;
            for (raw, (normalised, _)) in POINTS.chunks_exact(3).zip(&source.points) {
                let view = frame.camera_from_world.apply(DVec3::from(*normalised));
                let found = frame.lens.pixel(view.truncate() / view.z);
                let expected = defined_pixel(index, DVec3::from_slice(raw), BENT) / factor;
                assert!(found.distance(expected) <= 1e-9, "view {index} at 1/{factor}: {found} instead of {expected}");
                assert!(expected.x > 0.0 && expected.x < 24.0 && expected.y > 0.0 && expected.y < 16.0, "{expected}");
            }
        }
    }
}

#[test]
fn a_capture_is_imported_with_its_split_times_and_scale() {
    let dir = capture(7, [0.0; 5]);
    let (_root, capture) = run(dir.path(), &Params { fps: 10.0, ..Params::default() }).unwrap();
    let names = |split| capture.views_of(split).map(|(_, view)| view.name.as_str()).collect::<Vec<_>>();
    assert_eq!(names(Split::Train), ["000001", "000002", "000004", "000005", "000007"]);
    assert_eq!(names(Split::Test), ["000003", "000006"]);
    let protocol = &capture.protocol;
    assert_eq!(
        (protocol.dataset.as_str(), protocol.split.as_str(), protocol.resize.as_str()),
        ("nerfies", "official", "none")
    );
    assert_eq!((protocol.width, protocol.height, capture.pose_source.as_str()), (WIDTH, HEIGHT, "nerfies"));
    let (_, last) = capture.views_of(Split::Train).last().unwrap();
    assert!((last.time_secs - 0.6).abs() <= 1e-12 && (capture.time_map.end_secs - 0.6).abs() <= 1e-12);
    let expected = SCALE * (pose(6).1 - DVec3::from(CENTER));
    assert!(last.camera.position_world().distance(expected) <= 1e-12);
    let points = capture.load_points().unwrap().unwrap();
    let first = DVec3::from(points.positions[0].map(f64::from));
    assert!(first.distance(SCALE * DVec3::new(0.5, -0.5, 0.5)) <= 1e-6, "{first}");
    let known = crate::facts::of_capture(dir.path(), &Params::default());
    assert_eq!(
        (known.count(facts::TIMES), known.flag(facts::POINTS), known.flag(facts::MASKS)),
        (Some(5), Some(true), Some(false))
    );
    insta::assert_snapshot!(describe(dir.path()).unwrap());
}

#[test]
fn a_stored_size_is_read_instead_of_resized() {
    let dir = capture(4, [0.0; 5]);
    let import = |width| run(dir.path(), &Params { width: Some(width), ..Params::default() }).unwrap();
    let (_root, stored) = import(WIDTH / 2);
    assert_eq!((stored.protocol.resize.as_str(), stored.protocol.split.as_str()), ("none", "official, images at 1/2"));
    assert_eq!(stored.load_image(&stored.views[0]).unwrap().get_pixel(3, 3).0, [0, 0, 0]);
    let camera = stored.views[0].camera.intrinsics;
    assert_eq!((camera.focal_x, camera.center_x, camera.width), (15.0, 5.75, 12));
    // Other widths are made from the next larger images.
    assert_eq!(import(6).1.protocol.split, "official, images at 1/2");
    assert_eq!(import(18).1.protocol.split, "official");
}

#[test]
fn captures_without_val_ids_test_between_training_views() {
    let dir = capture(11, [0.0; 5]);
    let edit = |name: &str, edit: &dyn Fn(&mut Value)| {
        let mut json: Value = serde_json::from_slice(&std::fs::read(dir.path().join(name)).unwrap()).unwrap();
        edit(&mut json);
        write_json(dir.path(), name, &json);
    };
    edit("dataset.json", &|json| (json["val_ids"], json["train_ids"]) = (json!([]), json["ids"].clone()));
    // Time ids may differ from warp ids.
    edit("metadata.json", &|json| json["000005"]["time_id"] = json!(40));
    let all = frames(dir.path(), &Params::default());
    let of =
        |split| all.iter().filter(|frame| frame.split == split).map(|frame| frame.name.as_str()).collect::<Vec<_>>();
    assert_eq!(of(Split::Train), ["000001", "000009", "000005"]);
    assert_eq!(of(Split::Test), ["000003", "000007"]);
    assert_eq!(all.last().unwrap().frame_index, 40);
}

#[test]
fn own_train_ids_are_honoured_without_val_ids() {
    let dir = capture(5, [0.0; 5]);
    let ids: Vec<String> = (1..=5).map(|id| format!("{id:06}")).collect();
    write_json(dir.path(), "dataset.json", &json!({ "ids": ids, "train_ids": ids[..3], "val_ids": [] }));
    let source = read(dir.path(), &Params::default()).unwrap();
    assert_eq!((source.count(Split::Train), source.count(Split::Test)), (3, 2));
    assert_eq!(source.split_rule, "train_ids, tested on the other ids");
}

/// The notebook of Nerfies writes `bisect_left(train_ids, id)`.
#[test]
fn instants_of_the_notebook_are_replaced_by_ranks() {
    let dir = capture(9, [0.0; 5]);
    let train = ["000001", "000002", "000004", "000005", "000007", "000008"];
    let instants = |ids: &[(String, u32)]| {
        let entry = |(id, instant): &(String, u32)| (id.clone(), json!({ "warp_id": instant, "camera_id": 0 }));
        write_json(dir.path(), "metadata.json", &Value::Object(ids.iter().map(entry).collect()));
        let source = read(dir.path(), &Params::default()).unwrap();
        let mut found: Vec<_> = source.frames.iter().map(|frame| (frame.name.clone(), frame.frame_index)).collect();
        found.sort();
        (found.into_iter().map(|(_, instant)| instant).collect::<Vec<_>>(), source.warnings.join(""))
    };
    let ids = || (1..=9).map(|id| format!("{id:06}"));
    let bisected: Vec<_> =
        ids().map(|id| (id.clone(), train.partition_point(|other| *other < id.as_str()) as u32)).collect();
    let (found, warnings) = instants(&bisected);
    assert_eq!(found, (0..9).collect::<Vec<_>>());
    assert!(warnings.contains("as the notebook of Nerfies writes it"), "{warnings}");
    // Each test view may have the time of the training view before it.
    let shared: Vec<_> = ids().zip([0, 1, 1, 2, 3, 3, 4, 5, 5]).collect();
    let (found, warnings) = instants(&shared);
    assert_eq!((found, warnings.as_str()), (vec![0, 1, 1, 2, 3, 3, 4, 5, 5], ""));
}

#[test]
fn converted_images_and_time_ids_alone_are_read() {
    let dir = capture(6, [0.0; 5]);
    let expected = frames(dir.path(), &Params::default());
    let metadata = dir.path().join("metadata.json");
    let text = std::fs::read_to_string(&metadata).unwrap();
    std::fs::write(&metadata, text.replace("warp_id", "time_id")).unwrap();
    for index in 1..=6 {
        let png = dir.path().join(format!("rgb/1x/{index:06}.png"));
        image::open(&png).unwrap().save(png.with_extension("JPG")).unwrap();
        std::fs::remove_file(png).unwrap();
    }
    let found = frames(dir.path(), &Params::default());
    assert!(found.iter().all(|frame| frame.image.extension().unwrap() == "JPG"));
    let times = |frames: &[crate::source::Frame]| frames.iter().map(|frame| frame.time_secs).collect::<Vec<_>>();
    assert_eq!(times(&found), times(&expected));
    assert!(run(dir.path(), &Params::default()).is_ok());
    std::fs::write(&metadata, text.replacen("warp_id", "warp", 1)).unwrap();
    assert_refused(dir.path(), &Params::default(), &["000001 has neither time_id nor warp_id", "metadata.json"]);
}

#[test]
fn dychecks_splits_take_precedence() {
    let dir = capture(6, [0.0; 5]);
    write_json(dir.path(), "splits/train.json", &json!({ "frame_names": ["000001", "000002"], "camera_ids": [0, 0] }));
    write_json(dir.path(), "splits/val.json", &json!({ "frame_names": ["000004"], "camera_ids": [1] }));
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!((capture.protocol.dataset.as_str(), capture.protocol.split.as_str()), ("dycheck", "DyCheck"));
    assert_eq!((capture.views_of(Split::Train).count(), capture.views_of(Split::Test).count()), (2, 1));
}

/// The cameras of DyCheck's test views stand still and do not train. Its main metrics are measured on pixels that the training
/// views see, too.
#[test]
fn a_video_with_test_cameras_is_a_video_with_its_co_visibility_masks() {
    let dir = capture(15, [0.0; 5]);
    let path = dir.path().join("metadata.json");
    let mut metadata: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for id in (3..=15).step_by(3) {
        metadata[format!("{id:06}")]["camera_id"] = json!(1);
        write_mask(&dir.path().join(format!("covisible/2x/val/{id:06}.png")), (WIDTH / 2, HEIGHT / 2), 255);
    }
    std::fs::write(path, metadata.to_string()).unwrap();
    let text = describe(dir.path()).unwrap();
    assert!(text.contains("cameras     1, moving (one view per instant), and 1 for testing"), "{text}");
    assert!(
        text.contains("ignored     covisible/: 1 entry (masks of metric-evaluation: masks.co_visibility"),
        "{text}"
    );
    let masks = "[nodes.metrics.params.masks.co_visibility]\nfolder = \"{scene}/covisible/2x/val\"\n";
    for (has_flow, extends) in [(false, "builtin:benchmark"), (true, "builtin:video")] {
        if has_flow {
            std::fs::create_dir_all(dir.path().join("maps/flow_fwd")).unwrap();
            std::fs::write(dir.path().join("maps/flow_fwd/000001.flo"), "").unwrap();
        }
        let recipe = crate::inspect::inspect(dir.path()).unwrap().recipe().unwrap();
        assert!(recipe.contains(masks) && recipe.contains("width = 12") && recipe.contains(extends), "{recipe}");
        assert!(recipe.parse::<toml::Table>().is_ok(), "{recipe}");
    }
}

/// The generated scene differs from the named protocols only by its size, and because it is opaque.
#[test]
fn half_size_imports_have_the_named_protocols() {
    let dir = capture(11, [0.0; 5]);
    let differs_from = |name: &str| {
        let (_root, capture) = run(dir.path(), &Params { width: Some(WIDTH / 2), ..Params::default() }).unwrap();
        let differences = capture.protocol.differences(&Preset::named(name).unwrap().protocol());
        differences.into_iter().filter(|difference| !difference.starts_with("size ")).collect::<Vec<_>>()
    };
    assert!(differs_from("hypernerf-vrig-536").is_empty());
    let ids: Vec<String> = (1..=11).map(|id| format!("{id:06}")).collect();
    write_json(dir.path(), "dataset.json", &json!({ "count": 11, "ids": ids, "train_ids": ids, "val_ids": [] }));
    assert!(differs_from("hypernerf-interp-536").is_empty());
    write_json(dir.path(), "splits/train.json", &json!({ "frame_names": ["000001", "000002"], "camera_ids": [0, 0] }));
    write_json(dir.path(), "splits/val.json", &json!({ "frame_names": ["000004"], "camera_ids": [1] }));
    assert_eq!(differs_from("dycheck-360"), ["background none instead of black"]);
}

/// NeRF-DS has COLMAP's masks, in either of two folders: `ID.png.png`, white where nothing moves.
#[test]
fn masks_of_nerf_ds_are_white_where_nothing_moves() {
    for folder in ["mask", "resized_mask"] {
        let dir = capture(6, [0.0; 5]);
        for id in 1..=6 {
            write_mask(&dir.path().join(format!("{folder}/1x/{id:06}.png.png")), (WIDTH, HEIGHT), 255);
        }
        let (_root, imported) = run(dir.path(), &Params::default()).unwrap();
        let mask = imported.load_mask(&imported.views[0]).unwrap().unwrap();
        assert_eq!((mask.labels[0], mask.labels[23], imported.class_names.len()), (1, 0, 1), "{folder}");
        let known = crate::facts::of_capture(dir.path(), &Params::default());
        assert_eq!(known.flag(facts::MASKS), Some(true));
        assert!(!describe(dir.path()).unwrap().contains("ignored     mask/"));
    }
}

#[test]
fn masks_have_the_size_of_the_images() {
    let dir = capture(4, [0.0; 5]);
    for id in 1..=4 {
        write_mask(&dir.path().join(format!("mask/1x/{id:06}.png")), (WIDTH, HEIGHT), 255);
    }
    let (_root, full) = run(dir.path(), &Params::default()).unwrap();
    let mask = full.load_mask(&full.views[0]).unwrap().unwrap();
    assert_eq!((mask.labels[0], mask.labels[23], full.class_names.len()), (0, 1, 1));
    let (_root, half) = run(dir.path(), &Params { width: Some(12), ..Params::default() }).unwrap();
    assert!(half.views.iter().all(|view| view.mask.is_none()));
}

#[test]
fn a_static_scene_has_a_camera_per_view() {
    let dir = capture(4, [0.0; 5]);
    let (_root, capture) = run(dir.path(), &Params { static_scene: Some(true), ..Params::default() }).unwrap();
    assert!(capture.views.iter().all(|view| view.time_secs == 0.0));
}

#[test]
fn faults_are_reported_with_their_file() {
    type Fault = fn(&Path);
    fn edit(dir: &Path, name: &str, edit: impl Fn(&mut Value)) {
        let mut json: Value = serde_json::from_slice(&std::fs::read(dir.join(name)).unwrap()).unwrap();
        edit(&mut json);
        write_json(dir, name, &json);
    }
    let faults: [Fault; 13] = [
        |dir| edit(dir, "metadata.json", |json| _ = json.as_object_mut().unwrap().remove("000002")),
        |dir| edit(dir, "camera/000002.json", |json| json["skew"] = json!(0.7)),
        |dir| edit(dir, "camera/000002.json", |json| json["orientation"] = json!([[2, 0, 0], [0, 1, 0], [0, 0, 1]])),
        |dir| write_json(dir, "camera/000002.json", &json!({})),
        |dir| edit(dir, "scene.json", |json| json["scale"] = json!(0.0)),
        |dir| edit(dir, "dataset.json", |json| json["train_ids"][0] = json!("../x")),
        |dir| edit(dir, "dataset.json", |json| json["train_ids"][0] = json["train_ids"][1].clone()),
        |dir| edit(dir, "dataset.json", |json| json["val_ids"][0] = json["train_ids"][0].clone()),
        |dir| std::fs::remove_file(dir.join("rgb/1x/000003.png")).unwrap(),
        |dir| std::fs::remove_file(dir.join("camera/000003.json")).unwrap(),
        |dir| std::fs::remove_dir_all(dir.join("rgb")).unwrap(),
        |dir| write_points(dir, "(3, 2)", &POINTS),
        |dir| write_points(dir, "(1, 3)", &[1.0, f64::NAN, 2.0]),
    ];
    let mut refusals = Refusals::default();
    for fault in faults {
        let dir = capture(4, [0.0; 5]);
        fault(dir.path());
        refusals.add(dir.path(), &Params::default());
    }
    refusals.add(capture(4, [0.0; 5]).path(), &Params { format: Format::Colmap, ..Params::default() });
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn missing_scene_and_point_files_are_warnings() {
    let dir = capture(4, [0.0; 5]);
    std::fs::remove_file(dir.path().join("scene.json")).unwrap();
    std::fs::remove_file(dir.path().join("points.npy")).unwrap();
    insta::assert_snapshot!(read(dir.path(), &Params::default()).unwrap().warnings.join("\n"));
}
