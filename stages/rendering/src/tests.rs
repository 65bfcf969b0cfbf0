//! A few training steps on a tiny capture, rendered and exported.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use engine::{Artifact as _, Coordinates, InputRecord, JobContext, Stage as _};
use glam::DVec3;
use image::{Rgb, RgbImage};
use scene::{Camera, Capture, CaptureInfo, CaptureWriter, Frame, Intrinsics, Protocol, Split, TimeMap, image_file};
use serde_json::{Value, json};
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Device, Tensor};
use training::{FeatureTokens, Model, NOTHING, Player, Supplements, TrainingParams, Watch, train};

use crate::export::ply_sequence;
use crate::film::{Film, film};
use crate::run::{render, to_image};
use crate::{FrameRate, Maps, Rendering, RenderingParams, Renders};

const SIZE: u32 = 20;

/// Six training and two test views of a coloured gradient.
fn write_capture(dir: &Path) -> Capture {
    let protocol = Protocol {
        dataset: "test".into(),
        split: "official".into(),
        width: SIZE,
        height: SIZE,
        resize: "none".into(),
        background: "white".into(),
        time: "analytic".into(),
    };
    let info = CaptureInfo {
        name: "gradient".into(),
        pose_source: "analytic".into(),
        protocol,
        background: [1.0; 3],
        time_map: TimeMap { start_secs: 0.0, end_secs: 2.0, frame_secs: 0.4 },
        class_names: Vec::new(),
        bounds_world: Some([[-1.0; 3], [1.0; 3]]),
    };
    let writer = CaptureWriter::create(dir, info).unwrap();
    for (split, name, count) in [(Split::Train, "train", 6), (Split::Test, "test", 2)] {
        for at in 0..count {
            writer.write_view(&frame(split, format!("{name}_{at}"), at)).unwrap();
        }
    }
    writer.finish().unwrap()
}

fn frame(split: Split, name: String, at: u32) -> Frame {
    let (focal, center) = (24.0, 10.0);
    let intrinsics =
        Intrinsics { width: SIZE, height: SIZE, focal_x: focal, focal_y: focal, center_x: center, center_y: center };
    let angle = f64::from(at);
    let position = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0);
    Frame {
        name,
        split,
        camera: Camera::look_at(intrinsics, position, DVec3::ZERO, DVec3::Z),
        camera_index: 0,
        frame_index: at,
        time_secs: 0.4 * f64::from(at),
        image: RgbImage::from_fn(SIZE, SIZE, |x, y| Rgb([10 * x as u8, 10 * y as u8, 40 * at as u8])),
        alpha: None,
        depth: None,
        flow: None,
        mask: None,
        velocity: None,
    }
}

/// A folder with `capture` and `model`.
fn trained(method: &str) -> (tempfile::TempDir, Model, Capture) {
    let iterations = match method {
        "static3dgs" | "realtime4dgs" => json!({ "train": 30 }),
        _ => json!({ "coarse": 10, "fine": 20 }),
    };
    trained_with(json!({ "method": method, "iterations": iterations }), &NOTHING)
}

/// The same, with parameters beside those that make any training small.
fn trained_with(params: Value, supplements: &Supplements) -> (tempfile::TempDir, Model, Capture) {
    let dir = tempfile::tempdir().unwrap();
    let [capture_dir, model_dir, checkpoints] = ["capture", "model", "checkpoints"].map(|name| dir.path().join(name));
    for path in [&model_dir, &checkpoints] {
        std::fs::create_dir_all(path).unwrap();
    }
    let capture = write_capture(&capture_dir);
    let small = json!({
        "initial_points": { "random_count": 60 },
        "harmonics": { "interval": 5 },
        "deformable4dgs": { "channels": 4, "spatial_resolution": 8, "width": 8 },
    });
    let tables = [small, params].into_iter().filter_map(|table| table.as_object().cloned());
    let params: TrainingParams = serde_json::from_value(Value::Object(tables.flatten().collect())).unwrap();
    let (stop, on_progress) = (&AtomicBool::new(false), &|_| ());
    let watch = Watch { stop, on_progress, checkpoint_dir: &checkpoints, device: Device::Cpu };
    let model = train(capture.clone(), supplements, &params, None, &watch).unwrap().unwrap().model;
    model.save(&model_dir).unwrap();
    (dir, model, capture)
}

#[test]
fn images_are_the_players_images_in_the_captures_order() {
    let (dir, model, capture) = trained("deformable4dgs");
    let out = dir.path().join("renders");
    let params = RenderingParams { maps: Maps::All, ..RenderingParams::default() };
    let (renders, times) = render(&model, &capture, &params, Device::Cpu, &out).unwrap();
    let read = Renders::open(&out).unwrap();
    read.check().unwrap();
    assert_eq!(read, renders);
    assert!(FrameRate::of(&times, |frame| frame.raster_secs).median > 0.0);
    let player = Player::new(&model).unwrap();
    let views: Vec<_> = capture.views_of(Split::Test).map(|(_, view)| view).collect();
    assert_eq!(renders.views.len(), views.len());
    for (rendered, view) in renders.views.iter().zip(views) {
        assert_eq!(rendered.name, view.name);
        let expected = to_image(&player.render(view.time_secs, &PinholeCamera::from(&view.camera)).unwrap());
        assert_eq!(image_file::read_rgb(&renders.image_path(rendered)).unwrap(), expected);
        assert!(out.join(rendered.maps.as_ref().unwrap()).is_file());
    }
}

#[test]
fn gaussians_that_are_not_there_are_not_exported_and_views_without_them_have_surfaces() {
    let (dir, mut model, capture) = trained("realtime4dgs");
    let durations = &mut model.tensors.get_mut("gaussians.log_scales_time").unwrap().values;
    durations.fill(0.1_f32.ln());
    let player = Player::new(&model).unwrap();
    let view = capture.views_of(Split::Test).next().unwrap().1;
    let camera = PinholeCamera::from(&view.camera);
    let there = player.gaussians(view.time_secs, &camera).unwrap().positions.len() / 3;
    let positions = player.positions(view.time_secs, &camera).unwrap();
    let found = (0..60).filter(|&row| positions.of_row(row).is_some()).count();
    assert!(found == there && (1..60).contains(&there), "{there} of 60, {found} by row");
    let params = RenderingParams { maps: Maps::All, ..RenderingParams::default() };
    render(&model, &capture, &params, Device::Cpu, &dir.path().join("renders")).unwrap();
}

#[test]
fn a_model_with_words_says_where_they_are() {
    // The upper half of every training view is what "sky" means, the lower half what "ground" means.
    let tokens = Tensor::from_vec([2, 1, 2], vec![1.0, 0.0, 0.0, 1.0]);
    let features = FeatureTokens {
        visual: (0..8).map(|view| (view < 6).then(|| tokens.clone())).collect(),
        text: Tensor::from_vec([2, 2], vec![1.0, 0.0, 0.0, 1.0]),
        prompts: ["sky", "ground"].map(String::from).to_vec(),
    };
    let supplements = Supplements { features: Some(features), ..Supplements::default() };
    let params = json!({
        "method": "l4dgs",
        "iterations": { "coarse": 5, "teacher": 5, "fine": 5 },
        "effects": ["motion", "static-semantics", "language"],
        "l4dgs": { "hexplane": { "channels": 4, "spatial_resolution": 8, "width": 8 }, "teacher": { "channels": [4, 4, 4] } },
    });
    let (dir, model, capture) = trained_with(params, &supplements);
    let out = dir.path().join("renders");
    let (renders, _) =
        render(&model, &capture, &RenderingParams { maps: Maps::All, ..RenderingParams::default() }, Device::Cpu, &out)
            .unwrap();
    renders.check().unwrap();
    assert_eq!(renders.prompts, ["sky", "ground"]);
    let player = Player::new(&model).unwrap();
    let prompts = player.prompts().unwrap();
    for (rendered, (_, view)) in renders.views.iter().zip(capture.views_of(Split::Test)) {
        let maps = renders.load_semantics(rendered).unwrap().unwrap();
        assert_eq!(((maps.width, maps.height), maps.relevancy.len()), ((SIZE, SIZE), 2));
        let camera = PinholeCamera::from(&view.camera);
        let features = player.render_semantics(view.time_secs, &camera).unwrap().unwrap().features;
        let relevancy = player.prompt_relevancy(view.time_secs, &camera, &prompts).unwrap().unwrap();
        for at in [0, 7, (SIZE * SIZE - 1) as usize] {
            assert!((0..2).all(|prompt| maps.relevancy[prompt][at] == relevancy.as_slice()[2 * at + prompt]));
            let width = maps.features.len();
            assert!((0..width).all(|c| maps.features[c][at] == features.as_slice()[width * at + c]));
        }
    }
    // A film of a prompt dims what is something else; a prompt that the model does not know is refused by those it knows.
    let shot = |prompt, name: &str| {
        let shot = Film { times: &[0.4], views: &[], prompt };
        film(&dir.path().join("model"), &dir.path().join("capture"), &shot, Device::Cpu, &dir.path().join(name))
    };
    for (prompt, name) in [(None, "plain"), (Some("sky"), "sky"), (Some("ground"), "ground")] {
        shot(prompt, name).unwrap();
    }
    let sum = |name: &str| -> u64 {
        let frame = image_file::read_rgb(&dir.path().join(name).join("frame_0000.png")).unwrap();
        frame.as_raw().iter().map(|&byte| u64::from(byte)).sum()
    };
    assert!(sum("sky") < sum("plain") && sum("ground") < sum("plain") && sum("sky") != sum("ground"));
    let unknown = format!("{:?}", shot(Some("cat"), "cat").unwrap_err());
    assert!(unknown.contains("\"cat\"") && unknown.contains("sky, ground"), "{unknown}");
    // No labels, no truth to compare with: by default nothing is written; a model without words never has any.
    let unasked =
        render(&model, &capture, &RenderingParams::default(), Device::Cpu, &dir.path().join("unasked")).unwrap().0;
    assert!(unasked.views.iter().all(|view| view.semantics.is_none()));
}

#[test]
fn the_stage_renders_from_the_reloaded_model_and_measures_three_rates() {
    let (dir, ..) = trained("static3dgs");
    let mut context = JobContext::detached(&dir.path().join("job")).unwrap();
    for port in ["model", "capture"] {
        let record = InputRecord {
            producer: port.into(),
            coordinates: Coordinates::new(),
            artifact: Ok::<PathBuf, _>(dir.path().join(port)),
            measurements: serde_json::Value::Null,
            action_key: String::new(),
        };
        context.inputs.insert(port.into(), vec![record]);
    }
    let renders = Rendering::run(&context, &RenderingParams::default()).unwrap();
    renders.check().unwrap();
    let measured = context.measurements.borrow();
    let median = |name: &str| measured[name]["median"].as_f64().unwrap();
    assert!(median("fps_raster") >= median("fps_model") && median("fps_model") >= median("fps_delivered"));
    assert!(median("fps_delivered") > 0.0);
    // A split without views is an error that says so.
    let error =
        Rendering::run(&context, &RenderingParams { split: Split::Val, ..RenderingParams::default() }).unwrap_err();
    assert!(error.to_string().contains("no val views"), "{error}");
}

#[test]
fn exported_gaussians_render_as_the_model_does() {
    let (dir, ..) = trained("deformable4dgs");
    let [capture, model, out] = ["capture", "model", "ply"].map(|name| dir.path().join(name));
    let report = ply_sequence(&model, &capture, &[0.0, 0.7, 2.0], &out).unwrap();
    assert_eq!(report.lines().count(), 3);
    for (index, line) in report.lines().enumerate() {
        assert!(out.join(format!("frame_{index:04}.ply")).is_file());
        let (_, agreement) = line.split_once("render: ").unwrap();
        let psnr = agreement.split_whitespace().next().and_then(|figure| figure.parse::<f64>().ok());
        assert!(agreement.starts_with("equal") || psnr.is_some_and(|psnr| psnr >= 60.0), "{line}");
    }
    // The planted fault: another time's file must not pass for this one.
    let read = |index: usize| std::fs::read(out.join(format!("frame_{index:04}.ply"))).unwrap();
    assert_ne!(read(0), read(2));
    // A range typed by hand may be longer than the capture by its rounding.
    let report = ply_sequence(&model, &capture, &[0.0, 2.00005], &dir.path().join("rounded")).unwrap();
    assert!(report.lines().last().unwrap().starts_with("2.0000 s"), "{report}");
    let file = out.join("frame_0000.ply");
    assert!(ply_sequence(&model, &capture, &[0.0], &file).unwrap_err().to_string().contains("no folder"));
}

#[test]
fn a_film_is_what_the_player_renders_along_the_way() {
    let (dir, model, capture) = trained("deformable4dgs");
    let [capture_dir, model_dir] = ["capture", "model"].map(|name| dir.path().join(name));
    let shot = |times: &[f64], views: &[&str], name: &str| {
        let views: Vec<String> = views.iter().map(|view| (*view).to_owned()).collect();
        let shot = Film { times, views: &views, prompt: None };
        film(&model_dir, &capture_dir, &shot, Device::Cpu, &dir.path().join(name))
    };
    let frame = |name: &str, index: usize| {
        image_file::read_rgb(&dir.path().join(name).join(format!("frame_{index:04}.png"))).unwrap()
    };
    let player = Player::new(&model).unwrap();
    let rendered = |name: &str, time_secs: f64| {
        let view = capture.views.iter().find(|view| view.name == name).unwrap();
        to_image(&player.render(time_secs, &PinholeCamera::from(&view.camera)).unwrap())
    };
    // Without views the camera stands at the first test view.
    let told = shot(&[0.0, 1.0, 2.0], &[], "standing").unwrap();
    assert!(told.starts_with("3 frames of 20 × 20 px"), "{told}");
    for (index, time_secs) in [0.0, 1.0, 2.0].into_iter().enumerate() {
        assert_eq!(frame("standing", index), rendered("test_0", time_secs));
    }
    // Time stands still, and the camera ends where the last view was taken.
    shot(&[1.0; 3], &["train_0", "train_1"], "moving").unwrap();
    assert_eq!(frame("moving", 2), rendered("train_1", 1.0));
    assert!(frame("moving", 1) != frame("moving", 0) && frame("moving", 1) != frame("moving", 2));

    let refused = |shot: anyhow::Result<String>, reason: &str| {
        let error = format!("{:?}", shot.unwrap_err());
        assert!(error.contains(reason), "{error}");
    };
    refused(shot(&[1.0], &[], "moving"), "the folder is not empty");
    refused(shot(&[1.0], &["train_9"], "other"), "no view \"train_9\"");
    refused(shot(&[3.0], &[], "other"), "outside of the capture");
    let of_prompt = Film { times: &[1.0], views: &[], prompt: Some("ball") };
    let out = dir.path().join("other");
    refused(film(&model_dir, &capture_dir, &of_prompt, Device::Cpu, &out), "answers none");
    assert!(!out.exists(), "nothing was written");
}

#[test]
fn nonsense_times_are_refused() {
    let (dir, ..) = trained("static3dgs");
    let [capture, model, out] = ["capture", "model", "ply"].map(|name| dir.path().join(name));
    for times in [&[][..], &[f64::NAN], &[-1.0], &[2.5], &[1.0, 1.0], &[1.0, 0.5], &[f64::INFINITY]] {
        assert!(ply_sequence(&model, &capture, times, &out).is_err(), "{times:?} was accepted");
    }
}
