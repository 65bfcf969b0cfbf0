//! A tiny moving scene, rendered by the rasteriser itself, for tests.

use std::path::Path;

use glam::DVec3;
use image::{GrayImage, RgbImage};
use scene::{
    Camera, Capture, CaptureInfo, CaptureWriter, DepthMap, FlowMap, Frame, Intrinsics, LabelMap, NormalMap, PointCloud,
    Protocol, Split, TimeMap, VelocityMap,
};
use shaders::arrays::bytes::to_bytes;
use shaders::check::noise;
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{self, RasterSettings, Rendered, ShapeVars, SplatVars};
use shaders::tape::{Device, Tape, Tensor};

use crate::data::{BackgroundView, Dataset, FeatureTokens, FlowPrior, SceneFacts, Supplements, ViewPriors};
use crate::method::Moment;

/// Pixels per side.
pub(crate) const SIZE: u32 = 24;

/// The parameters of the test capture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TestScene {
    /// Training views, evenly over time.
    pub train_views: usize,
    /// Validation views at the first and the last time.
    pub val_views: usize,
    /// Distance that the blobs move from start to end, scene units.
    pub travel: f32,
    /// Pixels per side.
    pub size: u32,
    /// Whether the coverage of the images is known.
    pub with_coverage: bool,
    /// Factor on all lengths of the scene.
    pub scale: f32,
}

impl Default for TestScene {
    fn default() -> Self {
        Self { train_views: 8, val_views: 2, travel: 0.6, size: SIZE, with_coverage: false, scale: 1.0 }
    }
}

impl TestScene {
    /// Writes the capture into `dir`: training, validation and two test views, points near the blobs.
    pub(crate) fn write(&self, dir: &Path) -> Capture {
        let protocol = Protocol {
            dataset: "test".into(),
            split: "official".into(),
            width: self.size,
            height: self.size,
            resize: "none".into(),
            background: "black".into(),
            time: "analytic".into(),
        };
        let info = CaptureInfo {
            name: "blobs".into(),
            pose_source: "analytic".into(),
            protocol,
            background: [0.0; 3],
            time_map: TimeMap { start_secs: 0.0, end_secs: 2.0, frame_secs: 0.25 },
            class_names: Vec::new(),
            bounds_world: Some([[-f64::from(self.scale); 3], [f64::from(self.scale); 3]]),
        };
        let mut writer = CaptureWriter::create(dir, info).unwrap();
        for (split, name, count) in
            [(Split::Train, "train", self.train_views), (Split::Val, "val", self.val_views), (Split::Test, "test", 2)]
        {
            for at in 0..count {
                let share = if count > 1 { at as f64 / (count - 1) as f64 } else { 0.0 };
                writer.write_view(&self.frame(split, &format!("{name}_{at}"), at, share)).unwrap();
            }
        }
        let points = PointCloud {
            positions: (0..30)
                .map(|at| {
                    blob_center(at % 6).map(|value| self.scale * (value + 0.1 * ((at * 7 % 5) as f32 - 2.0) / 2.0))
                })
                .collect(),
            colors: vec![[128; 3]; 30],
        };
        writer.write_points(&points).unwrap();
        writer.finish().unwrap()
    }

    fn frame(&self, split: Split, name: &str, at: usize, time: f64) -> Frame {
        let focal = 1.2 * f64::from(self.size);
        let center = 0.5 * f64::from(self.size);
        let (width, height) = (self.size, self.size);
        let intrinsics =
            Intrinsics { width, height, focal_x: focal, focal_y: focal, center_x: center, center_y: center };
        let angle = if split == Split::Train { 0.7 * time } else { 0.35 };
        let position = f64::from(self.scale) * DVec3::new(3.0 * angle.sin(), -0.8, -3.0 * angle.cos());
        let camera = Camera::look_at(intrinsics, position, DVec3::ZERO, DVec3::new(0.0, -1.0, 0.0));
        let image = RgbImage::from_raw(width, height, self.render(&camera, time as f32)).unwrap();
        Frame {
            name: name.into(),
            split,
            camera,
            camera_index: 0,
            frame_index: at as u32,
            time_secs: 2.0 * time,
            image,
            alpha: self.with_coverage.then(|| self.coverage(&camera, time as f32)),
            depth: None,
            flow: None,
            mask: None,
            velocity: None,
        }
    }

    fn coverage(&self, camera: &Camera, time: f32) -> GrayImage {
        let (tape, rendered, _) = self.blobs(camera, time, false);
        let levels = tape.value(rendered.alpha).as_slice().iter().map(|alpha| (255.0 * alpha).round() as u8);
        GrayImage::from_raw(self.size, self.size, levels.collect()).unwrap()
    }

    /// Every optional input of a training, for the training views: exact depth, optical flow to half a second later in
    /// the same camera, velocity, moving parts, and random features.
    pub(crate) fn supplements(&self, dataset: &Dataset) -> Supplements {
        let views = &dataset.capture.views;
        let mut found = Supplements { features: Some(test_features(views.len())), ..Supplements::default() };
        let (width, height) = (self.size, self.size);
        for view in views {
            let camera = &view.camera;
            let time = (0.5 * view.time_secs) as f32;
            let (tape, rendered, moving) = self.blobs(camera, time, true);
            let image = |var| tape.value(var).as_slice();
            let (alpha, depth) = (image(rendered.alpha), image(rendered.depth.unwrap()));
            let known = |value: f32, alpha: f32| if alpha > 0.5 { value / alpha } else { 0.0 };
            let depth_view: Vec<f32> = depth.iter().zip(alpha).map(|(&depth, &alpha)| known(depth, alpha)).collect();
            let is_moving: Vec<bool> =
                moving.iter().zip(alpha).map(|(&moving, &alpha)| moving > 0.5 * alpha && alpha > 0.5).collect();
            let pixels_per_unit = 1.2 * self.size as f32;
            let step = 0.25 * self.scale * self.travel;
            let flow = |(&depth, &moving): (&f32, &bool)| match (depth > 0.0, moving) {
                (false, _) => [f32::NAN; 2],
                (true, true) => [step * pixels_per_unit / depth, 0.0],
                (true, false) => [0.0; 2],
            };
            let flow_px = depth_view.iter().zip(&is_moving).map(flow).collect();
            // The blobs travel within the two seconds of the capture.
            let velocity = |&moving: &bool| [if moving { 0.5 * self.scale * self.travel } else { 0.0 }, 0.0, 0.0];
            let velocity_world = is_moving.iter().map(velocity).collect();
            let labels = is_moving.iter().map(|&moving| u8::from(moving)).collect();
            let normal = |&depth: &f32| if depth > 0.0 { [0.0, 0.0, -1.0] } else { [0.0; 3] };
            let normals_view = depth_view.iter().map(normal).collect();
            found.priors.push(ViewPriors {
                flow: Some(FlowPrior {
                    map: FlowMap { width, height, flow_px },
                    camera_to: *camera,
                    time_to_secs: view.time_secs + 0.5,
                    view_to: None,
                }),
                normals: Some(NormalMap { width, height, normals_view }),
                velocity: Some(VelocityMap { width, height, velocity_world }),
                depth: Some(DepthMap { width, height, depth_view: depth_view.clone() }),
            });
            found.moving.push(Some(LabelMap { width, height, labels }));
            found.background.push(Some(BackgroundView {
                image: dataset.capture.load_image(view).unwrap(),
                depth: Some(DepthMap { width, height, depth_view }),
                unfilled: LabelMap { width, height, labels: vec![0; (width * height) as usize] },
            }));
        }
        let moving: Vec<[f32; 3]> = (0..6)
            .step_by(2)
            .map(|at| [blob_center(at)[0] - 0.5 * self.travel, blob_center(at)[1], blob_center(at)[2]])
            .map(|position| position.map(|value| self.scale * value))
            .collect();
        found.particles = Some(PointCloud { colors: vec![[128; 3]; moving.len()], positions: moving });
        found
    }

    /// Six coloured blobs, every other one moving along x.
    fn render(&self, camera: &Camera, time: f32) -> Vec<u8> {
        let (tape, rendered, _) = self.blobs(camera, time, false);
        to_bytes(tape.value(rendered.color)).values
    }

    /// The render, with depth if `depth` is set, and the weight of moving blobs per pixel.
    fn blobs(&self, camera: &Camera, time: f32, depth: bool) -> (Tape<f32>, Rendered, Vec<f32>) {
        let shift = |at: usize| if at.is_multiple_of(2) { self.travel * (time - 0.5) } else { 0.0 };
        let positions = (0..6)
            .flat_map(|at| {
                let [x, y, z] = blob_center(at);
                [x + shift(at), y, z].map(|value| self.scale * value)
            })
            .collect();
        let colors =
            (0..6).flat_map(|at| [0, 1, 2].map(|channel| if (at + channel) % 3 == 0 { 1.5 } else { -0.7 })).collect();
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let mut constant = |shape: &[usize], values: Vec<f32>| tape.constant(Tensor::from_vec(shape, values));
        let splats = SplatVars {
            positions: constant(&[6, 3], positions),
            shape: ShapeVars::ScaleRotation {
                log_scales: constant(&[6, 3], vec![(self.scale * 0.15).ln(); 18]),
                rotations: constant(&[6, 4], [1.0, 0.0, 0.0, 0.0].repeat(6)),
            },
            opacity_logits: constant(&[6, 1], vec![2.0; 6]),
            sh: constant(&[6, 1, 3], colors),
        };
        let moves = tape.constant(Tensor::from_vec([6, 1], (0..6).map(|at| f32::from(at % 2 == 0)).collect()));
        let near_view = 0.01 * f64::from(self.scale);
        let settings =
            RasterSettings { background: [0.0; 3], sh_degree: 0, depth, near_view, ..RasterSettings::default() };
        let camera = PinholeCamera::from(camera);
        let rendered = rasteriser::render(&mut tape, &splats, Some(moves), &camera, &settings).unwrap();
        let moving = tape.value(rendered.features.unwrap()).as_slice().to_vec();
        (tape, rendered, moving)
    }
}

/// A camera for moments whose camera does not matter.
pub(crate) const ANY_CAMERA: PinholeCamera = PinholeCamera {
    width: 8,
    height: 8,
    focal: [8.0; 2],
    center: [4.0; 2],
    rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    translation: [0.0; 3],
};

/// A scene for moments whose scene does not matter.
pub(crate) const ANY_SCENE: SceneFacts = SceneFacts {
    extent: 1.0,
    unit_world: 1.0,
    time_map: TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 },
    background: [0.0; 3],
    time_count: 5,
};

/// A moment at a time in [0, 1], for models that read neither scene nor camera.
pub(crate) fn moment(time: f64, phase: &'static str) -> Moment<'static> {
    Moment { scene: &ANY_SCENE, phase, time, camera: &ANY_CAMERA, sh_degree: 0, left_out: None }
}

/// Noise on a grid of 4×4 tokens per view, and three prompts.
fn test_features(views: usize) -> FeatureTokens {
    let tensor = |shape: &[usize], seed| {
        let values = noise(shape.iter().product(), seed).iter().map(|&value| value as f32).collect();
        Tensor::from_vec(shape, values)
    };
    FeatureTokens {
        visual: (0..views).map(|view| Some(tensor(&[4, 4, 8], view as u64))).collect(),
        text: tensor(&[3, 8], 1000),
        prompts: ["left", "middle", "right"].map(String::from).to_vec(),
    }
}

fn blob_center(at: usize) -> [f32; 3] {
    [(at % 3) as f32 * 0.7 - 0.7, (at / 3) as f32 * 0.7 - 0.35, 0.3 * (at % 2) as f32]
}
