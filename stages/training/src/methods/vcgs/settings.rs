//! Recipe settings of VC-GS.

use serde::{Deserialize, Serialize};

use crate::check::{Checks, Table, fields};
use crate::effects::{Effect, Effects, Need, SEED_FROM_MASKS};

/// The method's table in a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// Spacing of the surfels in pixels: one on every N-th pixel of every N-th row.
    pub pixel_stride: usize,
    /// Maximum number of surfels per layer. If there are more, evenly chosen ones are kept and widened to cover the
    /// same area.
    pub max_count: usize,
    /// Share of a displacement's component along the viewing direction that is kept (ε of equation 5).
    pub depth_share: f64,
    /// Ablation: whether moving surfels keep their initial position, although they rotate and fade.
    pub zero_offset: bool,
    /// The static layer.
    pub background: StaticLayer,
    /// Pruning of the surfels of both layers.
    pub pruning: Pruning,
}

/// What the static layer consists of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum StaticLayer {
    /// Surfels of pixels, which keep their positions and colours, as published.
    #[default]
    Surfels,
    /// Gaussians on the points of the capture, trained and densified as in 3D Gaussian splatting: for depth that is not
    /// exact, e.g. without an estimator.
    Gaussians,
}

/// Pruning rounds and thresholds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Pruning {
    /// Iterations between two rounds; the first round comes after the second interval (scaled with the schedule).
    pub interval: u64,
    /// Surfels with a lower opacity are removed.
    pub min_opacity: f64,
    /// Surfels with a larger radius in any render are removed; pixels (30 for images 512 pixels wide).
    pub max_radius_px: f64,
    /// Minimum number of surfels that a layer keeps, the most opaque ones.
    pub min_count: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            pixel_stride: 1,
            max_count: 400_000,
            depth_share: 0.05,
            zero_offset: false,
            background: StaticLayer::default(),
            pruning: Pruning::default(),
        }
    }
}

impl Default for Pruning {
    fn default() -> Self {
        Self { interval: 200, min_opacity: 0.05, max_radius_px: 30.0, min_count: 1000 }
    }
}

/// The active effects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Switches {
    pub motion: bool,
    pub constraint: bool,
    pub layer_split: bool,
    /// Seeds instead of surfels that begin without velocity.
    pub seeds: bool,
    /// Inpainted images as targets; needs a static layer to fill.
    pub inpainting: bool,
}

impl Switches {
    pub(crate) fn new(effects: &Effects) -> Self {
        let layer_split = effects.has("layer-split");
        Self {
            motion: effects.has("motion"),
            constraint: effects.has("view-plane-constraint"),
            layer_split,
            seeds: *effects != Effects::Auto && effects.has(SEED_FROM_MASKS.name),
            inpainting: layer_split && effects.has("inpainting"),
        }
    }
}

/// The method's effects, in the order of its README.
pub(crate) fn effects() -> Vec<Effect> {
    vec![
        Effect::new(
            "motion",
            "4D surfels on the moving pixels of every frame",
            &[Need::Times(2), Need::Motion, Need::Depth],
        ),
        Effect::new(
            "view-plane-constraint",
            "surfels move perpendicular to the viewing direction of their source view",
            &[Need::Effect("motion")],
        ),
        Effect::new("layer-split", "static pixels form a separate layer, trained first", &[Need::Layers, Need::Depth]),
        Effect::new(
            "inpainting",
            "the static layer is trained on inpainted images",
            &[Need::Background, Need::Effect("layer-split")],
        ),
        Effect {
            needs: &[Need::Layers, Need::Depth, Need::Effect("motion"), Need::Effect("layer-split")],
            ..SEED_FROM_MASKS
        },
    ]
}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default()
            .at_least_one(fields!(self, pixel_stride, max_count))
            .shares(fields!(self, depth_share))
            .at_least_one(fields!(self, pruning.interval))
            .require("pruning.min_opacity", (0.0..1.0).contains(&self.pruning.min_opacity), "must be in [0, 1)")
            .positive(fields!(self, pruning.max_radius_px))
    }
}
