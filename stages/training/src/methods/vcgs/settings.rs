//! What a recipe may say about this method.

use serde::{Deserialize, Serialize};

use crate::effects::{Effect, Effects, Need};

/// What only this method understands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// A surfel stands on every so many pixels of every so many rows.
    pub pixel_stride: usize,
    /// At most so many surfels per layer, evenly chosen.
    pub max_count: usize,
    /// Share of a displacement's part along the viewing direction that is kept (ε of equation 5).
    pub depth_share: f64,
    /// Whether moving surfels stay where they are born, although they turn and fade: a row of the ablation.
    pub zero_offset: bool,
    /// Pruning.
    pub pruning: Pruning,
}

/// When surfels are removed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Pruning {
    /// Iterations between two rounds, none up to the first interval (stretched with the schedule).
    pub interval: u64,
    /// Surfels less opaque than this go.
    pub min_opacity: f64,
    /// Surfels that were seen with a larger radius go; pixels (30 for images 512 pixels wide).
    pub max_radius_px: f64,
    /// A layer keeps at least so many, the most opaque ones.
    pub min_count: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { pixel_stride: 1, max_count: 400_000, depth_share: 0.05, zero_offset: false, pruning: Pruning::default() }
    }
}

impl Default for Pruning {
    fn default() -> Self {
        Self { interval: 200, min_opacity: 0.05, max_radius_px: 30.0, min_count: 1000 }
    }
}

/// Which effects are on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Switches {
    pub motion: bool,
    pub constraint: bool,
    pub layer_split: bool,
    /// Only with a layer to paint in.
    pub inpainting: bool,
}

impl Switches {
    pub(crate) fn new(effects: &Effects) -> Self {
        let layer_split = effects.has("layer-split");
        Self {
            motion: effects.has("motion"),
            constraint: effects.has("view-plane-constraint"),
            layer_split,
            inpainting: layer_split && effects.has("inpainting"),
        }
    }
}

/// What the method can simulate or leave out, in the order of its README.
pub(crate) fn effects() -> Vec<Effect> {
    let effect = |name, about, needs| Effect { name, about, needs, by_default: true };
    vec![
        effect(
            "motion",
            "4D surfels on the moving pixels of every frame",
            &[Need::Times(2), Need::Motion, Need::Depth],
        ),
        effect(
            "view-plane-constraint",
            "surfels move across the viewing direction of the view that they come from",
            &[Need::Effect("motion")],
        ),
        effect("layer-split", "what stands still is a layer of its own, trained first", &[Need::Layers, Need::Depth]),
        effect(
            "inpainting",
            "the static layer is trained on images without what moves",
            &[Need::Background, Need::Effect("layer-split")],
        ),
    ]
}

impl Settings {
    /// Why these settings cannot work, if so.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.pixel_stride == 0 || self.max_count == 0 || self.pruning.interval == 0 {
            return Err("vcgs: pixel_stride, max_count and pruning.interval must be positive".into());
        }
        if !(0.0..=1.0).contains(&self.depth_share) {
            return Err(format!("vcgs: depth_share must lie between 0 and 1, not {}", self.depth_share));
        }
        Ok(())
    }
}
