//! What a recipe may say about priors.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `depth-flow-import`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Where the maps come from.
    pub source: MapSource,
    /// `files`: the folder with `depth/`, `flow_fwd/`, `flow_bwd/` and `normal/`, relative to the data root.
    pub folder: PathBuf,
    /// Which maps are imported; empty imports all that there are.
    pub maps: BTreeSet<MapKind>,
    /// `files`: training views without a map that others have are no error.
    pub allow_missing: bool,
    /// `files`: what depth maps hold.
    pub depth: DepthParams,
    /// `files`: what flow maps lead to, and when they are believed.
    pub flow: FlowParams,
    /// `files`: what normal maps hold.
    pub normals: NormalParams,
}

/// Where maps come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapSource {
    /// The capture carries them, as synthetic captures do.
    #[default]
    Capture,
    /// Estimators wrote them into a folder.
    Files,
    /// Depth alone, interpolated between the capture's points: coarse, and that of the static scene.
    SparsePoints,
}

/// A kind of map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapKind {
    /// View-space depth.
    Depth,
    /// Optical flow.
    Flow,
    /// Surface normals.
    Normals,
    /// Exact velocity (`capture` only).
    Velocity,
}

/// What depth maps hold.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthParams {
    /// The quantity.
    pub kind: DepthKind,
    /// Distance in scene units that the value 1 stands for: 0.001 for millimetres in a scene in metres. Must be stated
    /// for 16-bit PNG files of distances, and is 1 elsewhere unless stated.
    pub units_per_value: Option<f64>,
    /// How maps get the scale of the scene. Unset: `scale-shift` for inverse depth, `none` for distances.
    pub alignment: Option<Alignment>,
}

/// The quantity in a depth map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthKind {
    /// View-space z.
    #[default]
    Z,
    /// Distance from the camera's centre.
    RayDistance,
    /// Inverse z up to scale and shift, as relative monocular estimators give it.
    InverseDepth,
}

/// What is fitted between a map and the capture's points, per view, in inverse depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Alignment {
    /// Nothing: the map has the scene's scale.
    None,
    /// One factor.
    Scale,
    /// A factor and an offset.
    ScaleShift,
}

/// What flow maps lead to, and when they are believed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowParams {
    /// Frames between the two frames of a pair: forward flow leads to the frame that comes so many frames later in the
    /// same camera's video, backward flow to the one so many frames earlier.
    pub stride: u32,
    /// Where backward flow is there, a pixel is kept if going there and back ends within this many pixels …
    pub max_round_trip_px: f64,
    /// … plus this share of the flow's length.
    pub max_round_trip_share: f64,
}

/// What normal maps hold.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NormalParams {
    /// The axes of the camera's frame.
    pub axes: Axes,
}

/// The axes of a camera's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axes {
    /// Right, down, forward.
    #[default]
    Opencv,
    /// Right, up, backward.
    Opengl,
}

impl Default for FlowParams {
    fn default() -> Self {
        // Half a pixel for the estimate each way, and errors grow with the length of the flow.
        Self { stride: 1, max_round_trip_px: 1.0, max_round_trip_share: 0.05 }
    }
}

impl DepthParams {
    /// What is fitted.
    pub fn alignment(&self) -> Alignment {
        self.alignment.unwrap_or(match self.kind {
            DepthKind::InverseDepth => Alignment::ScaleShift,
            DepthKind::Z | DepthKind::RayDistance => Alignment::None,
        })
    }
}

impl Params {
    /// Whether a kind of map is imported where it is there.
    pub fn wants(&self, kind: MapKind) -> bool {
        self.maps.is_empty() || self.maps.contains(&kind)
    }

    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let files = self.source == MapSource::Files;
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let ungauged = self.depth.kind == DepthKind::InverseDepth && self.depth.alignment() == Alignment::None;
        let FlowParams { stride, max_round_trip_px, max_round_trip_share } = self.flow;
        let checks = [
            (files && self.folder.as_os_str().is_empty(), "folder", "no folder", "folder = \"priors/scene\""),
            (!relative(&self.folder), "folder", "the folder must lie below the data root", "use a relative path"),
            (
                !files && !self.folder.as_os_str().is_empty(),
                "folder",
                "no folder is read from a capture",
                "set source = \"files\", or remove folder",
            ),
            (
                files && self.maps.contains(&MapKind::Velocity),
                "maps",
                "velocity is never imported from files",
                "only synthetic captures know it exactly",
            ),
            (
                !self.depth.units_per_value.is_none_or(positive),
                "depth.units_per_value",
                "must be positive and finite",
                "0.001 for millimetres in a scene in metres",
            ),
            (ungauged, "depth.alignment", "inverse depth has no scale of its own", "use \"scale\" or \"scale-shift\""),
            (stride == 0, "flow.stride", "must be at least 1", "1 leads to the next frame"),
            (
                !(not_negative(max_round_trip_px) && not_negative(max_round_trip_share)),
                "flow",
                "limits of the round trip must be finite and not negative",
                "max_round_trip_px = 1.0, max_round_trip_share = 0.05",
            ),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        checks.into_iter().filter(|check| check.0).map(problem).collect()
    }
}
