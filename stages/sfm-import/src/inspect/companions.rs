//! Results of estimators next to the frames of a video: masks, depth and flow, and which of them are missing.

use std::collections::BTreeMap;
use std::path::Path;

use scene::maps::formats;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::files;

/// Files that help to train on a video of one moving camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Companions {
    /// Whether the capture is a video of one moving camera; otherwise only `co_visible` is filled in.
    pub is_video: bool,
    /// DyCheck's masks of pixels that the training views see, too.
    pub co_visible: Option<CoVisible>,
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
    /// Whether the cameras see points, between which depth can be interpolated and with which it can be aligned.
    pub points: bool,
    /// Parameters of the importers by table (`depth`, `flow`, `normals`, `masks`), as recorded by `prepare`.
    pub import: BTreeMap<String, BTreeMap<String, Value>>,
}

/// Masks that `metric-evaluation` reads, without the import.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CoVisible {
    /// The folder in the capture.
    pub folder: String,
    /// The width of the masks, which the imported images must have.
    pub width: u32,
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
    import: BTreeMap<String, BTreeMap<String, Value>>,
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
    /// Finds the files in the capture `dir`, a video of one camera whose import has this many masks and depth maps, and
    /// `points` that the cameras see.
    pub(super) fn of_video(dir: &Path, imported_masks: usize, imported_depths: usize, points: bool) -> Self {
        let prepared = Prepared::read(dir);
        let has = |folder: &str| !files::children(&dir.join(folder)).is_empty();
        let kinds = ["depth", "flow_fwd", "flow_bwd", "tracks", "normal"];
        let maps = if kinds.iter().any(|kind| has(&format!("maps/{kind}"))) { "maps" } else { "" };
        let has_maps = |kind: &str| has(Path::new(maps).join(kind).to_string_lossy().as_ref());
        let masks = match () {
            () if imported_masks > 0 => MaskPlace::Labels,
            () if has_mask_files(&dir.join("masks")) => MaskPlace::Files,
            () => MaskPlace::Absent,
        };
        let depth = match () {
            () if imported_depths > 0 => DepthPlace::Capture,
            () if has_maps("depth") => DepthPlace::Files,
            () => DepthPlace::Absent,
        };
        Self {
            is_video: true,
            co_visible: None,
            fps: prepared.fps,
            masks,
            depth,
            maps: maps.into(),
            flow: has_maps("flow_fwd") || has_maps("tracks"),
            points,
            import: prepared.import,
        }
    }

    /// Adds DyCheck's masks for images of at most this width. Published numbers are for those in `2x`.
    pub(super) fn with_co_visible(self, dir: &Path, width: u32) -> Self {
        let masks = |size: &str| {
            let folder = format!("covisible/{size}/val");
            let first = dir.join(&folder).join(files::children(&dir.join(&folder)).first()?);
            Some(CoVisible { folder, width: files::image_size(&first).ok()?.0 })
        };
        let found = ["2x", "1x", "4x"].into_iter().filter_map(masks).find(|masks| masks.width <= width);
        Self { co_visible: found, ..self }
    }

    /// Whether the subject can be seeded from its pixels: these can be found from masks, or from flow that the motion of the
    /// camera does not explain, and their depth is known.
    pub(super) fn can_seed(&self) -> bool {
        self.is_video && (self.masks != MaskPlace::Absent || self.flow) && self.has_depth()
    }

    /// Whether the depth of pixels is known in the unit of the capture.
    fn has_depth(&self) -> bool {
        match self.depth {
            DepthPlace::Capture => true,
            DepthPlace::Files => self.points || self.is_depth_metric(),
            DepthPlace::Absent => self.points,
        }
    }

    /// Whether files of depth need no points to be aligned with.
    fn is_depth_metric(&self) -> bool {
        let stated = |key: &str| self.import.get("depth").and_then(|values| values.get(key)).and_then(Value::as_str);
        match stated("alignment") {
            Some(alignment) => alignment == "none",
            None => matches!(stated("kind"), Some("z" | "ray-distance")),
        }
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
        let points = "points that the cameras see: without them, depth is not known in the unit of the capture, and methods cannot \
                      seed the subject from its pixels. points3D of COLMAP, or a PLY file that ply_file_path of transforms.json names";
        let is_interpolated = self.depth == DepthPlace::Absent && self.points;
        let all = [
            (self.masks == MaskPlace::Absent, masks),
            (!self.has_depth(), points),
            (is_interpolated, depth),
            (!self.flow, flow),
        ];
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

/// Whether `layer-split` can read a file in a folder of masks, or in a folder in it for one object.
fn has_mask_files(folder: &Path) -> bool {
    let is_read = |name: &String| {
        let extension = Path::new(name).extension().map(|extension| extension.to_string_lossy().to_lowercase());
        extension.is_some_and(|it| it == "json" || formats::EXTENSIONS.contains(&it.as_str()))
    };
    let names = files::children(folder);
    names.iter().any(is_read) || names.iter().any(|name| files::children(&folder.join(name)).iter().any(is_read))
}
