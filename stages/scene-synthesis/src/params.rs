//! What to synthesise.

use std::collections::BTreeSet;

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Most images that one capture may have; more is a typing error.
const MAX_VIEWS: usize = 100_000;

/// Farthest origin of a scene: there, single precision has 6 cm steps.
const MAX_ORIGIN: f64 = 1e6;

/// Parameters of the stage; the defaults are a small capture like those of D-NeRF (Pumarola et al. 2021).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// What moves.
    pub scene: SceneKind,
    /// How training cameras move.
    pub camera: CameraPath,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Horizontal field of view in degrees.
    pub field_of_view_degrees: f64,
    /// Instants of the training video, evenly from the first to the last second.
    pub frames: usize,
    /// Frames per second.
    pub fps: f64,
    /// Fixed training cameras of a `rig`, each of which sees every frame (unused otherwise).
    pub rig_cameras: usize,
    /// Views to watch training with: other cameras, other times.
    pub val_views: usize,
    /// Views to measure with: other cameras, other times.
    pub test_views: usize,
    /// Rays per pixel on a regular grid: a square number.
    pub samples_per_pixel: u32,
    /// What lies behind the bodies.
    pub background: Background,
    /// Mirror-like part of the reflection (Blinn-Phong, 0 to 1): colours then depend on the view.
    pub specular: f64,
    /// Whether bodies cast hard shadows.
    pub shadows: bool,
    /// Phases of motion and directions of random cameras follow from it.
    pub seed: u64,
    /// Which exact maps to write beside the images.
    pub truths: BTreeSet<Truth>,
    /// Surface points in the point cloud, if it is written.
    pub points: usize,
    /// Where the scene's centre lies; far from zero, single precision has few digits left for the scene.
    pub origin_world: [f64; 3],
    /// Share of the pixels of depth and flow maps that know nothing, 0 to 1, drawn by the seed.
    pub holes: f64,
}

/// The scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SceneKind {
    /// Four spinning textured balls that hop over a floor.
    BouncingSpheres,
    /// Three links on a turning pedestal, with sinusoidal joint angles.
    SwingingArm,
    /// A sheet that hangs on a rod and waves.
    WavingCloth,
    /// A ball that rolls through a tunnel and returns.
    Occluder,
    /// Textured blocks that stand still.
    StaticBlocks,
    /// Hard: a ball flies through the cameras' near plane.
    NearFlyby,
    /// Hard: bodies far thinner than a pixel.
    Needles,
    /// Hard: a ball that is suddenly elsewhere.
    Teleport,
    /// Hard: the occluder with a tunnel that hides the ball two thirds of the time.
    LongOcclusion,
    /// Hard: a body of one pixel.
    Speck,
    /// Hard: everything is black.
    Black,
    /// Hard: what moves is never seen, so that every mask is empty.
    UnseenMotion,
}

/// How training cameras move; all look at the centre of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraPath {
    /// One camera per frame, anywhere on the upper hemisphere (as D-NeRF).
    Hemisphere,
    /// One camera that goes round the scene once.
    Orbit,
    /// One camera that swings 30° to either side: what a hand-held video shows.
    Arc,
    /// Fixed synchronised cameras on a half circle.
    Rig,
}

/// What lies behind the bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// Transparent pixels are composited on white.
    White,
    /// Transparent pixels are composited on black.
    Black,
    /// Nothing is transparent: a textured dome surrounds cameras and bodies.
    None,
}

/// A map, exact at pixel centres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Truth {
    /// Coverage (anti-aliased like the image).
    Alpha,
    /// View-space z.
    Depth,
    /// Forward optical flow.
    Flow,
    /// Instance labels.
    Masks,
    /// 3D velocity of the seen surface.
    Velocity,
    /// A point cloud of surfaces seen at the first instant.
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
            origin_world: [0.0; 3],
            holes: 0.0,
        }
    }
}

impl Params {
    /// Rays along one side of a pixel.
    pub(crate) fn samples_per_side(&self) -> u32 {
        self.samples_per_pixel.isqrt()
    }

    /// Seconds from the first frame to the last.
    pub(crate) fn duration_secs(&self) -> f64 {
        (self.frames - 1) as f64 / self.fps
    }

    /// Whether a map is asked for.
    pub(crate) fn wants(&self, truth: Truth) -> bool {
        self.truths.contains(&truth)
    }

    /// Everything that the types do not exclude, all at once.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let cameras = if self.camera == CameraPath::Rig { self.rig_cameras } else { 1 };
        let views = self.frames.saturating_mul(cameras).saturating_add(self.val_views).saturating_add(self.test_views);
        let samples = self.samples_per_side().pow(2) == self.samples_per_pixel && self.samples_per_pixel <= 1024;
        let fov = self.field_of_view_degrees;
        let rules = [
            ("width", (1..=16384).contains(&self.width), "must be between 1 and 16384 pixels"),
            ("height", (1..=16384).contains(&self.height), "must be between 1 and 16384 pixels"),
            ("field_of_view_degrees", (1.0..=150.0).contains(&fov), "must be between 1 and 150 degrees"),
            ("frames", self.frames >= 1, "must be at least 1"),
            ("frames", views <= MAX_VIEWS, "together with the cameras gives more than 100000 views"),
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
