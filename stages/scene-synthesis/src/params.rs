//! Parameters of the stage.

use std::collections::BTreeSet;
use std::fmt;

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Maximum number of views of one capture; a larger number is most likely a typing error.
const MAX_VIEWS: usize = 100_000;

/// Largest coordinate of the scene origin: at this distance, single precision has steps of 0.06 units.
const MAX_ORIGIN: f64 = 1e6;

/// Parameters of the stage `scene-synthesis`. The defaults give a small capture like those of D-NeRF (Pumarola et al.
/// 2021).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The scene to render.
    pub scene: SceneKind,
    /// The motion of the training cameras.
    pub camera: CameraPath,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Horizontal field of view in degrees.
    pub field_of_view_degrees: f64,
    /// Distance of the cameras from the centre of the scene, in units of the scene before `scale`.
    pub camera_distance: f64,
    /// For `arc`: how far the camera swings to either side, in degrees.
    pub swing_degrees: f64,
    /// Number of frames of the training video.
    pub frames: usize,
    /// Frames per second of the training video.
    pub fps: f64,
    /// For `rig`: number of fixed training cameras, each of which takes every frame.
    pub rig_cameras: usize,
    /// Number of validation views, with other cameras and times than training views.
    pub val_views: usize,
    /// Number of test views, with other cameras and times than training views.
    pub test_views: usize,
    /// Number of rays per pixel, on a regular grid: a square number of at most 1024.
    pub samples_per_pixel: u32,
    /// The background behind the bodies.
    pub background: Background,
    /// Weight of specular highlights (Blinn–Phong), 0 to 1; above 0, colours depend on the view.
    pub specular: f64,
    /// Whether bodies cast hard shadows.
    pub shadows: bool,
    /// Seed of the phases of motion and of random cameras.
    pub seed: u64,
    /// The exact maps to write next to the images.
    pub truths: BTreeSet<Truth>,
    /// Number of surface points in the point cloud, if `truths` includes it.
    pub points: usize,
    /// Surfaces that have points.
    pub points_on: PointSurfaces,
    /// World position of the scene origin; far from zero, single precision resolves the scene poorly.
    pub origin_world: [f64; 3],
    /// Factor on all lengths of the scene and of the camera poses; the images do not change.
    pub scale: f64,
    /// Where the bounds of the capture come from.
    pub bounds: Bounds,
    /// Share of random pixels without depth and flow, 0 to 1.
    pub holes: f64,
}

/// The available scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SceneKind {
    /// Four spinning textured balls that bounce on a floor.
    BouncingSpheres,
    /// Three links on a turning pedestal, with sinusoidal joint angles.
    SwingingArm,
    /// A waving sheet, held by a rod along one edge.
    WavingCloth,
    /// A ball that rolls through a tunnel and back.
    Occluder,
    /// Static textured blocks.
    StaticBlocks,
    /// Hard: a ball that flies through the near plane of the cameras.
    NearFlyby,
    /// Hard: bodies far thinner than a pixel.
    Needles,
    /// Hard: a ball that jumps from place to place.
    Teleport,
    /// Hard: the occluder scene with a tunnel that hides the ball two thirds of the time.
    LongOcclusion,
    /// Hard: a body of the size of one pixel.
    Speck,
    /// Hard: three small balls that cover a few per cent of the pixels, without a floor.
    SmallBodies,
    /// Hard: everything is black.
    Black,
    /// Hard: motion that no camera sees, so that every mask is empty.
    UnseenMotion,
}

impl fmt::Display for SceneKind {
    /// Writes the name in recipes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// The motion of the training cameras, which all look at the centre of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraPath {
    /// One random camera on the upper hemisphere per frame (like D-NeRF).
    Hemisphere,
    /// One camera that circles the scene once.
    Orbit,
    /// One camera that swings by `swing_degrees` to either side, like a hand-held video.
    Arc,
    /// Fixed synchronised cameras on a half circle.
    Rig,
}

/// The background behind the bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// White behind transparent pixels.
    White,
    /// Black behind transparent pixels.
    Black,
    /// No transparent pixels: a textured dome surrounds cameras and bodies.
    None,
}

/// Where the bounds of a capture come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bounds {
    /// The box that the scene states for its bodies. Parts below the floor reach out of it, and the ball of `near-flyby` leaves it.
    Exact,
    /// The common view volume of the training cameras, as an importer estimates it.
    Cameras,
}

/// Surfaces that have points in the point cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointSurfaces {
    /// All surfaces at the first instant, which only several cameras at that instant could reconstruct.
    All,
    /// Surfaces of bodies that never move: what structure from motion reconstructs from one camera.
    Still,
}

/// An exact map, sampled at pixel centres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Truth {
    /// Coverage, anti-aliased like the image.
    Alpha,
    /// View-space z.
    Depth,
    /// Forward optical flow.
    Flow,
    /// Instance labels.
    Masks,
    /// 3D velocity of the visible surface.
    Velocity,
    /// A point cloud of surfaces that training cameras see at the first instant.
    Points,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            scene: SceneKind::BouncingSpheres,
            camera: CameraPath::Hemisphere,
            width: 200,
            height: 200,
            field_of_view_degrees: 39.6,
            camera_distance: 4.0,
            swing_degrees: 30.0,
            frames: 60,
            fps: 30.0,
            rig_cameras: 8,
            val_views: 10,
            test_views: 10,
            samples_per_pixel: 16,
            background: Background::White,
            specular: 0.0,
            shadows: false,
            seed: 0,
            truths: [Truth::Alpha].into(),
            points: 5000,
            points_on: PointSurfaces::All,
            origin_world: [0.0; 3],
            scale: 1.0,
            bounds: Bounds::Exact,
            holes: 0.0,
        }
    }
}

impl Params {
    /// Number of rays along one side of a pixel.
    pub(crate) fn samples_per_side(&self) -> u32 {
        self.samples_per_pixel.isqrt()
    }

    /// Time from the first to the last frame in seconds.
    pub(crate) fn duration_secs(&self) -> f64 {
        (self.frames - 1) as f64 / self.fps
    }

    /// Number of training cameras that take every frame.
    pub(crate) fn cameras(&self) -> usize {
        if self.camera == CameraPath::Rig { self.rig_cameras } else { 1 }
    }

    /// Number of training views.
    pub(crate) fn training_views(&self) -> usize {
        self.frames.saturating_mul(self.cameras())
    }

    /// Whether a map is requested.
    pub(crate) fn wants(&self, truth: Truth) -> bool {
        self.truths.contains(&truth)
    }

    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let cameras = self.cameras();
        let views = self.training_views().saturating_add(self.val_views).saturating_add(self.test_views);
        let samples = self.samples_per_side().pow(2) == self.samples_per_pixel && self.samples_per_pixel <= 1024;
        let fov = self.field_of_view_degrees;
        let rules = [
            ("width", (1..=16384).contains(&self.width), "must be between 1 and 16384 pixels"),
            ("height", (1..=16384).contains(&self.height), "must be between 1 and 16384 pixels"),
            ("field_of_view_degrees", (1.0..=150.0).contains(&fov), "must be between 1 and 150 degrees"),
            ("camera_distance", (0.1..=1e3).contains(&self.camera_distance), "must be between 0.1 and 1000"),
            ("swing_degrees", (0.0..=90.0).contains(&self.swing_degrees), "must be between 0 and 90 degrees"),
            ("scale", (1e-4..=1e4).contains(&self.scale), "must be between 0.0001 and 10000"),
            ("frames", self.frames >= 1, "must be at least 1"),
            ("frames", views <= MAX_VIEWS, "and the cameras give more than 100000 views"),
            ("fps", self.fps > 0.0 && self.fps.is_finite(), "must be a positive number"),
            ("rig_cameras", cameras >= 1, "must be at least 1"),
            ("samples_per_pixel", samples && self.samples_per_pixel >= 1, "must be a square number up to 1024"),
            ("origin_world", self.origin_world.iter().all(|at| at.abs() <= MAX_ORIGIN), "must be within ±1e6"),
            ("holes", (0.0..=1.0).contains(&self.holes), "must be between 0 and 1"),
            ("specular", (0.0..=1.0).contains(&self.specular), "must be between 0 and 1"),
        ];
        let problem = |(key, _, message): (&str, bool, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: None,
        };
        rules.into_iter().filter(|(_, holds, _)| !holds).map(problem).collect()
    }
}
