//! Tests on tiny captures and models of a few training steps.

mod export;
mod film;
mod prompts;

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

use crate::film::{Film, film_to_folder};
use crate::frame_rate::FrameRate;
use crate::quantize::to_image;
use crate::run::render;
use crate::{Maps, Rendering, RenderingParams, Renders, Selection, Show};

const SIZE: u32 = 20;

/// Writes a capture of a coloured gradient with six training views and two test views.
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

/// Trains a method for a few steps; the folder holds `capture` and `model`.
fn trained(method: &str) -> (tempfile::TempDir, Model, Capture) {
    let iterations = match method {
        "static3dgs" | "realtime4dgs" => json!({ "train": 30 }),
        _ => json!({ "coarse": 10, "fine": 20 }),
    };
    trained_with(json!({ "method": method, "iterations": iterations }), &NOTHING)
}

/// Trains with these parameters in addition to those that keep every model small; the folder holds `capture` and
/// `model`.
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
    let watch = Watch { stop, pause_at: None, on_progress, checkpoint_dir: &checkpoints, device: Device::Cpu };
    let model = train(capture.clone(), supplements, &params, None, &watch).unwrap().unwrap().model;
    model.save(&model_dir).unwrap();
    (dir, model, capture)
}

#[test]
fn images_equal_the_players_in_the_captures_order() {
    let (dir, model, capture) = trained("deformable4dgs");
    let out = dir.path().join("renders");
    let params = RenderingParams { maps: Maps::All, ..RenderingParams::default() };
    let (renders, times) = render(&model, &capture, &params, Device::Cpu, &out).unwrap();
    let read = Renders::open(&out).unwrap();
    read.check().unwrap();
    assert_eq!(read, renders);
    assert!(FrameRate::of(times.raster_secs.iter().copied()).median > 0.0);
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
fn values_of_tensors_can_be_replaced() {
    let (dir, mut model, capture) = trained("static3dgs");
    let images = |model: &Model, name: &str| {
        let params = RenderingParams { maps: Maps::None, ..RenderingParams::default() };
        let (renders, _) = render(model, &capture, &params, Device::Cpu, &dir.path().join(name)).unwrap();
        image_file::read_rgb(&renders.image_path(&renders.views[0])).unwrap()
    };
    let before = images(&model, "before");
    let name = "gaussians.opacity_logits";
    let count = model.tensors[name].values.len();
    let replaced = |values| std::collections::BTreeMap::from([(name.to_string(), values)]);
    crate::run::replace(&mut model, &replaced(vec![-100.0; count])).unwrap();
    let after = images(&model, "after");
    assert!(before != after && after.pixels().all(|pixel| *pixel == after[(0, 0)]));
    let error = crate::run::replace(&mut model, &replaced(vec![0.0])).unwrap_err().to_string();
    assert_eq!(error, format!("tensor `{name}` has {count} values, not 1"));
    let unknown = std::collections::BTreeMap::from([("mixing.shares".to_string(), vec![0.0; 2])]);
    let error = crate::run::replace(&mut model, &unknown).unwrap_err().to_string();
    assert!(error.starts_with("the model has no tensor `mixing.shares`; it has gaussians.log_scales,"), "{error}");
}

#[test]
fn absent_gaussians_are_left_out_of_exports_and_surfaces() {
    let (dir, mut model, capture) = trained("realtime4dgs");
    let durations = &mut model.tensors.get_mut("gaussians.log_scales_time").unwrap().values;
    durations.fill(0.1_f32.ln());
    let player = Player::new(&model).unwrap();
    let view = capture.views_of(Split::Test).next().unwrap().1;
    let camera = PinholeCamera::from(&view.camera);
    let present = player.gaussians(view.time_secs, &camera).unwrap().positions.len() / 3;
    let positions = player.positions(view.time_secs, &camera).unwrap();
    let found = (0..60).filter(|&row| positions.of_row(row).is_some()).count();
    assert!(found == present && (1..60).contains(&present), "{present} of 60, {found} by row");
    let params = RenderingParams { maps: Maps::All, ..RenderingParams::default() };
    render(&model, &capture, &params, Device::Cpu, &dir.path().join("renders")).unwrap();
}

/// Trains l4dgs for a few steps with the prompts "sky" and "ground"; the folder holds `capture` and `model`.
fn trained_with_prompts() -> (tempfile::TempDir, Model, Capture) {
    // In every training view, "sky" describes the upper half and "ground" the lower half.
    let tokens = Tensor::from_vec([2, 1, 2], vec![1.0, 0.0, 0.0, 1.0]);
    let features = FeatureTokens {
        visual: (0..8).map(|view| (view < 6).then(|| tokens.clone())).collect(),
        text: Tensor::from_vec([2, 2], vec![1.0, 0.0, 0.0, 1.0]),
        prompts: ["sky", "ground"].map(String::from).to_vec(),
    };
    let supplements = Supplements { features: Some(features), ..Supplements::default() };
    let params = json!({
        "method": "l4dgs",
        "iterations": { "coarse": 5, "fine": 5 },
        "effects": ["motion", "static-semantics", "language"],
        "l4dgs": { "hexplane": { "channels": 4, "spatial_resolution": 8, "width": 8 }, "teacher": { "iterations": 5, "channels": [4, 4, 4] } },
    });
    trained_with(params, &supplements)
}

#[test]
fn prompts_select_pixels_in_maps_and_films() {
    let (dir, model, capture) = trained_with_prompts();
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
    // A film with a prompt dims irrelevant pixels. The error about an unknown prompt lists the known ones.
    let shot = |prompt: Option<&str>, name: &str| {
        let selection = prompt.map(|prompt| Selection { prompt, embeddings: None, show: Show::Highlight });
        let shot = Film { times: &[0.4], views: &[], selection };
        film_to_folder(
            &dir.path().join("model"),
            &dir.path().join("capture"),
            &shot,
            Device::Cpu,
            &dir.path().join(name),
        )
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
    // By default, views without labels get no semantic maps.
    let default =
        render(&model, &capture, &RenderingParams::default(), Device::Cpu, &dir.path().join("default")).unwrap().0;
    assert!(default.views.iter().all(|view| view.semantics.is_none()));
}

#[test]
fn the_stage_renders_a_reloaded_model_and_measures_three_rates() {
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
    assert!(median("fps_raster") >= median("fps_model"));
    assert!(median("fps_delivered") > 0.0);
    // A split without views is an error.
    let error =
        Rendering::run(&context, &RenderingParams { split: Split::Val, ..RenderingParams::default() }).unwrap_err();
    assert!(error.to_string().contains("no val views"), "{error}");
}
