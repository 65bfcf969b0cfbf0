//! What a recipe may say about an import.

use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use scene::protocol::{PRESETS, Preset};
use serde::{Deserialize, Serialize};

/// Parameters of the stage `sfm-import`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The capture's folder, relative to the data root, as `dnerf/lego`. Required.
    pub source: PathBuf,
    /// What the folder holds.
    pub format: Format,
    /// Pixels per row of the imported images; the height follows the aspect ratio. Unset keeps the native size. Nerfies: the
    /// smallest stored images that are as wide are read, so that one of their widths resizes nothing.
    pub width: Option<u32>,
    /// How images get to `width`: `area` (the default where `width` is set) or `lanczos3`.
    pub resize: Option<Resize>,
    /// What transparent images are composited on, and what models of this capture render on.
    pub background: Background,
    /// Blender: which official split is tested on; `val` is what the literature does for D-NeRF's Lego.
    pub test_split: TestSplit,
    /// The name of the protocol that the capture must come to have, as `dnerf-800-white` (`scene::protocol::PRESETS`); anything
    /// else is then refused. Empty: any.
    pub protocol: String,
    /// COLMAP: every n-th image, from the first, is a test view; 0 makes none.
    pub every_nth: u32,
    /// Validation views. Unset: Blender's official val split unless it is tested on, none elsewhere. A number: so
    /// many, evenly spread, of that split, or held out of the training views where there is no such split.
    pub val_count: Option<u32>,
    /// Keeps every n-th training view.
    pub frame_step: u32,
    /// Keeps at most so many training views (after `frame_step`), evenly spread.
    pub train_limit: Option<u32>,
    /// COLMAP, Nerfies and Neural 3D Video: frames per second of the video whose frames the images are.
    pub fps: f64,
    /// Every image shows the same instant (a photo collection of a scene at rest).
    #[serde(rename = "static")]
    pub static_scene: bool,
    /// COLMAP: refuse when a smaller share of the images has a pose; 0 accepts anything.
    pub min_registered_share: f64,
}

/// What a folder holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Recognised by its files.
    #[default]
    Auto,
    /// `transforms_{train,val,test}.json`, as D-NeRF and synthetic NeRF scenes.
    Blender,
    /// A COLMAP sparse model (`sparse/0/{cameras,images,points3D}.{bin,txt}`) beside its images.
    Colmap,
    /// `camera/*.json` with `dataset.json`, `metadata.json` and `rgb/1x`, as Nerfies, HyperNeRF and DyCheck.
    Nerfies,
    /// `poses_bounds.npy` and the frames of every camera in `camNN/images` or `camNN`, as Neural 3D Video.
    N3v,
}

/// A resize filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resize {
    /// Box average.
    Area,
    /// Windowed sinc of three lobes.
    Lanczos3,
}

/// What transparent pixels become.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// (1, 1, 1), the default of most of the literature on D-NeRF.
    #[default]
    White,
    /// (0, 0, 0).
    Black,
}

/// An official split that may be tested on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TestSplit {
    /// `transforms_test.json`.
    #[default]
    Test,
    /// `transforms_val.json`.
    Val,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: PathBuf::new(),
            format: Format::Auto,
            width: None,
            resize: None,
            background: Background::White,
            test_split: TestSplit::Test,
            protocol: String::new(),
            every_nth: 8, // the split of LLFF, Mip-NeRF 360 and the 3DGS loaders
            val_count: None,
            frame_step: 1,
            train_limit: None,
            fps: 30.0,
            static_scene: false,
            min_registered_share: 0.5, // below, structure from motion has lost the scene
        }
    }
}

impl Format {
    /// As protocols and captures spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Blender => "blender",
            Self::Colmap => "colmap",
            Self::Nerfies => "nerfies",
            Self::N3v => "n3v",
        }
    }
}

impl Background {
    /// As recipes and protocols spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::White => "white",
            Self::Black => "black",
        }
    }

    /// As a colour in [0, 1].
    pub fn rgb(self) -> [f32; 3] {
        match self {
            Self::White => [1.0; 3],
            Self::Black => [0.0; 3],
        }
    }
}

impl Params {
    /// The filter that images are resized with, if they are.
    pub fn filter(&self) -> Resize {
        self.resize.unwrap_or(Resize::Area)
    }

    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let checks = [
            (self.source.as_os_str().is_empty(), "source", "no source folder", "source = \"dnerf/bouncingballs\""),
            (!relative(&self.source), "source", "the source must lie below the data root", "use a relative path"),
            (
                self.width == Some(0),
                "width",
                "an image needs at least one pixel per row",
                "leave it out to keep the size",
            ),
            (
                self.resize.is_some() && self.width.is_none(),
                "resize",
                "nothing is resized",
                "set width, or remove resize",
            ),
            (self.frame_step == 0, "frame_step", "must be at least 1", "1 keeps every training view"),
            (
                self.train_limit == Some(0),
                "train_limit",
                "must be at least 1",
                "leave it out to keep every training view",
            ),
            (
                self.every_nth == 1,
                "every_nth",
                "every image would be a test view",
                "8 is the usual choice, 0 tests on none",
            ),
            (!(self.fps > 0.0 && self.fps.is_finite()), "fps", "must be positive and finite", "30 is a common rate"),
            (
                !(0.0..=1.0).contains(&self.min_registered_share),
                "min_registered_share",
                "must lie in [0, 1]",
                "0 accepts anything",
            ),
        ];
        let problem = |(_, key, message, hint): (bool, &str, &str, &str)| ParamProblem {
            key: key.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        let problems = checks.into_iter().filter(|check| check.0).map(problem);
        problems.chain(self.unknown_protocol()).collect()
    }

    fn unknown_protocol(&self) -> Option<ParamProblem> {
        if self.protocol.is_empty() || Preset::named(&self.protocol).is_some() {
            return None;
        }
        let names: Vec<_> = PRESETS.iter().map(|preset| preset.name).collect();
        Some(ParamProblem {
            key: "protocol".into(),
            message: format!("no protocol is called {:?}", self.protocol),
            hint: Some(format!("one of {}", names.join(", "))),
        })
    }
}
