//! Parameters of the stage.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use scene::Naming;
use scene::maps::DepthKind;
use serde::{Deserialize, Serialize};

/// Parameters of the stage `depth-flow-import`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Where the maps come from.
    pub source: MapSource,
    /// For `files`: the folder with `depth/`, `flow_fwd/`, `flow_bwd/`, `normal/` and `tracks/`, relative to the data root.
    pub folder: PathBuf,
    /// For `files`: what their names refer to.
    pub naming: Naming,
    /// The kinds of maps to import; empty imports every kind that exists.
    pub maps: BTreeSet<MapKind>,
    /// For `files`: whether training views may lack a map that other views have.
    pub allow_missing: bool,
    /// For `files` without a folder `depth/`, e.g. with flow alone: whether the depth of the capture is used, or else depth
    /// that is interpolated between its points.
    pub fill_depth: bool,
    /// For `files`: the content of depth maps.
    pub depth: DepthParams,
    /// For `files`: the target frame of flow maps, and their consistency check.
    pub flow: FlowParams,
    /// For `files`: the content of normal maps.
    pub normals: NormalParams,
}

/// The origin of maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapSource {
    /// Exact maps that are part of a synthetic capture.
    #[default]
    Capture,
    /// Files of estimators in a folder.
    Files,
    /// Only depth, interpolated between the points of the capture: coarse, and only of the static scene.
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
    /// Exact 3D velocity, from synthetic captures only.
    Velocity,
}

/// The content of depth maps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthParams {
    /// The quantity that they store.
    pub kind: DepthKind,
    /// Distance in scene units of the value 1, e.g. 0.001 for millimetres in a scene in metres. Required for 16-bit PNG
    /// files of distances; otherwise it defaults to 1.
    pub units_per_value: Option<f64>,
    /// How maps are fitted to the scale of the scene; by default `scale-shift` for relative depth, `none` for
    /// distances.
    pub alignment: Option<Alignment>,
}

/// The model that is fitted between a map and the points of the capture, per view, in inverse depth (of affine depth in
/// depth).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Alignment {
    /// No fit: the map has the scale of the scene.
    None,
    /// A scale factor.
    Scale,
    /// A scale factor and an offset.
    ScaleShift,
}

/// The target frame of flow maps, and their consistency check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowParams {
    /// Distance in frames between the two frames of a pair, within the video of one camera: forward flow points this
    /// many frames ahead, backward flow this many frames back.
    pub stride: u32,
    /// Largest error of the round trip along forward and backward flow, in pixels, for flow of length 0.
    pub max_round_trip_px: f64,
    /// Increase of that limit, as a share of the length of the flow.
    pub max_round_trip_share: f64,
    /// For tracks: width in pixels of the video in which they were found. If unset, that of the images of the capture.
    pub track_width: Option<u32>,
}

/// The content of normal maps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NormalParams {
    /// The camera axes that the normals refer to.
    pub axes: Axes,
}

/// The axes of a camera's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axes {
    /// OpenCV: right, down, forward.
    #[default]
    Opencv,
    /// OpenGL: right, up, backward.
    Opengl,
}

impl Default for FlowParams {
    fn default() -> Self {
        // Half a pixel of estimation error in each direction; errors grow with the length of the flow.
        Self { stride: 1, max_round_trip_px: 1.0, max_round_trip_share: 0.05, track_width: None }
    }
}

impl DepthParams {
    /// The alignment, with the default of the kind of depth.
    pub fn alignment(&self) -> Alignment {
        self.alignment.unwrap_or(match self.kind {
            DepthKind::InverseDepth | DepthKind::AffineDepth => Alignment::ScaleShift,
            DepthKind::Z | DepthKind::RayDistance => Alignment::None,
        })
    }
}

impl Params {
    /// Whether a kind of map is imported if it exists.
    pub(crate) fn wants(&self, kind: MapKind) -> bool {
        self.maps.is_empty() || self.maps.contains(&kind)
    }

    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let files = self.source == MapSource::Files;
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let no_scale = self.depth.kind.is_relative() && self.depth.alignment() == Alignment::None;
        let FlowParams { stride, max_round_trip_px, max_round_trip_share, track_width } = self.flow;
        let checks = [
            (
                files && self.folder.as_os_str().is_empty(),
                "folder",
                "no folder given",
                "e.g. folder = \"priors/scene\"",
            ),
            (
                !relative(&self.folder),
                "folder",
                "the folder must be below the data root",
                "use a relative path without `..`",
            ),
            (
                !files && !self.folder.as_os_str().is_empty(),
                "folder",
                "this source reads no folder",
                "set source = \"files\", or remove folder",
            ),
            (
                !files && self.fill_depth,
                "fill_depth",
                "only files can lack depth",
                "set source = \"files\", or remove fill_depth",
            ),
            (
                files && self.maps.contains(&MapKind::Velocity),
                "maps",
                "velocity cannot be imported from files",
                "only synthetic captures have it",
            ),
            (
                !self.depth.units_per_value.is_none_or(positive),
                "depth.units_per_value",
                "must be positive and finite",
                "e.g. 0.001 for millimetres in a scene in metres",
            ),
            (no_scale, "depth.alignment", "relative depth has no absolute scale", "use \"scale\" or \"scale-shift\""),
            (
                track_width == Some(0),
                "flow.track_width",
                "must be at least 1 pixel",
                "omit it for the width of the images",
            ),
            (stride == 0, "flow.stride", "must be at least 1", "1 stands for the next frame"),
            (
                !(not_negative(max_round_trip_px) && not_negative(max_round_trip_share)),
                "flow",
                "the limits of the round trip must be finite and not negative",
                "the defaults are max_round_trip_px = 1.0 and max_round_trip_share = 0.05",
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
