//! Results of estimators next to the frames of a video: masks, depth and flow, and which of them are missing.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::files;

/// Files that help to train on a video of one moving camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Companions {
    /// Whether the capture is a video of one moving camera; otherwise nothing else is filled in.
    pub is_video: bool,
    /// Frames per second, if `prepare` recorded them.
    pub fps: Option<f64>,
    /// The location of masks of moving pixels.
    pub masks: MaskPlace,
    /// Where depth is.
    pub depth: DepthPlace,
    /// The folder in the capture with `depth/`, `flow_fwd/`, …; empty for the capture itself.
    pub maps: String,
    /// Whether there is optical flow, or tracks.
    pub flow: bool,
    /// Parameters of the importers by table (`depth`, `flow`, `normals`, `masks`), as recorded by `prepare`.
    pub import: BTreeMap<String, BTreeMap<String, serde_json::Value>>,
}

/// The location of masks of moving pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum MaskPlace {
    /// Nowhere.
    #[default]
    Absent,
    /// Next to the images, so that the import reads them as labels.
    Labels,
    /// In files of the folder `masks` that only `layer-split` reads, e.g. arrays.
    Files,
}

/// Where depth is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum DepthPlace {
    /// Nowhere.
    #[default]
    Absent,
    /// In the capture, in its unit.
    Capture,
    /// In files of an estimator.
    Files,
}

/// The data that `prepare` recorded.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Prepared {
    fps: Option<f64>,
    import: BTreeMap<String, BTreeMap<String, serde_json::Value>>,
}

impl Prepared {
    fn read(dir: &Path) -> Self {
        let text = std::fs::read_to_string(dir.join("prepare.json")).ok();
        let read: Self = text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        Self { fps: read.fps.filter(|fps| *fps > 0.0 && fps.is_finite()), ..read }
    }
}

/// Frames per second of the images, if `prepare` recorded them.
pub(super) fn fps(dir: &Path) -> Option<f64> {
    Prepared::read(dir).fps
}

impl Companions {
    /// Finds the files in the capture `dir`, a video of one camera whose import has this many masks and depth maps.
    pub(super) fn of_video(dir: &Path, imported_masks: usize, imported_depths: usize) -> Self {
        let prepared = Prepared::read(dir);
        let has = |folder: &str| !files::children(&dir.join(folder)).is_empty();
        let kinds = ["depth", "flow_fwd", "flow_bwd", "tracks", "normal"];
        let maps = if kinds.iter().any(|kind| has(&format!("maps/{kind}"))) { "maps" } else { "" };
        let has_maps = |kind: &str| has(Path::new(maps).join(kind).to_string_lossy().as_ref());
        let masks = match () {
            () if imported_masks > 0 => MaskPlace::Labels,
            () if has("masks") => MaskPlace::Files,
            () => MaskPlace::Absent,
        };
        let depth = match () {
            () if imported_depths > 0 => DepthPlace::Capture,
            () if has_maps("depth") => DepthPlace::Files,
            () => DepthPlace::Absent,
        };
        Self {
            is_video: true,
            fps: prepared.fps,
            masks,
            depth,
            maps: maps.into(),
            flow: has_maps("flow_fwd") || has_maps("tracks"),
            import: prepared.import,
        }
    }

    /// Whether moving pixels can be found: from masks, or from flow that the motion of the camera does not explain.
    pub(super) fn show_what_moves(&self) -> bool {
        self.is_video && (self.masks != MaskPlace::Absent || self.flow)
    }

    /// Whether files of estimators have depth or flow.
    pub(super) fn has_maps(&self) -> bool {
        self.depth == DepthPlace::Files || self.flow
    }

    /// The missing inputs, the most useful first.
    pub(super) fn missing(&self) -> Vec<&'static str> {
        if !self.is_video {
            return Vec::new();
        }
        let masks = "masks of the moving subject: with them, methods seed it from its own pixels and tables evaluate it separately. \
                     One PNG per image in masks/, e.g. of SAM 2";
        let depth = "depth: it is interpolated between the points of the static scene, which are behind the subject. One file \
                     per image in maps/depth, e.g. of Video-Depth-Anything";
        let flow =
            "optical flow: velocities come from block matching. One file per image in maps/flow_fwd, e.g. of SEA-RAFT";
        let all =
            [(self.masks == MaskPlace::Absent, masks), (self.depth == DepthPlace::Absent, depth), (!self.flow, flow)];
        all.into_iter().filter(|(is_missing, _)| *is_missing).map(|(_, text)| text).collect()
    }

    /// The files that were found, in words.
    pub(super) fn found(&self) -> String {
        let all = [
            (self.masks != MaskPlace::Absent, "masks"),
            (self.depth != DepthPlace::Absent, "depth"),
            (self.flow, "flow"),
        ];
        let found: Vec<&str> = all.into_iter().filter(|(is_found, _)| *is_found).map(|(_, name)| name).collect();
        if found.is_empty() { "neither masks, nor depth, nor flow".into() } else { found.join(" and ") }
    }
}
