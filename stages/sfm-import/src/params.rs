//! The parameters of the stage.

use std::path::{Component, Path, PathBuf};

use engine::ParamProblem;
use scene::protocol::{PRESETS, Preset};
use serde::{Deserialize, Serialize};

/// The parameters of an import.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The capture's folder, relative to the data root, e.g. `dnerf/lego`. Required.
    pub source: PathBuf,
    /// The format of the folder; `auto` recognises it by its files.
    pub format: Format,
    /// Width of the imported images in pixels; the height follows the aspect ratio. If unset, images keep their native
    /// size. Nerfies: the smallest stored images of at least this width are read, so that a stored width needs no resizing.
    pub width: Option<u32>,
    /// The filter for resizing to `width`: `area` (the default) or `lanczos3`.
    pub resize: Option<Resize>,
    /// COLMAP: the folder of images in the capture, e.g. `images_4`. If unset: the smallest copy `images_2`, `images_4`, … of
    /// at least `width`, otherwise `images`. Names and sizes must be those of the model.
    pub images: Option<PathBuf>,
    /// EasyVolcap: the folder of `intri.yml` and `extri.yml` in the capture, e.g. `optimized`. If unset: the capture itself.
    pub calibration: Option<PathBuf>,
    /// The background for compositing transparent images and for rendering models of this capture.
    pub background: Background,
    /// Blender and nerfstudio: the official split that serves as the test split. The literature uses `val` for D-NeRF's Lego.
    pub test_split: TestSplit,
    /// The name of the protocol that the capture must have after the import, e.g. `dnerf-800-white`
    /// (`scene::protocol::PRESETS`). Captures with another protocol are refused. Empty accepts every protocol.
    pub protocol: String,
    /// Captures without an official split (COLMAP, TUM, ScanNet, nerfstudio without lists of file names, Blender without
    /// test and val files): every n-th image, starting with the first, is a test view; for a rig, every n-th camera. 0: no test
    /// views.
    pub every_nth: u32,
    /// Rigs: the names of the cameras that are test views, e.g. `["08"]`. If empty: those of the benchmark (`cam00` for
    /// Neural 3D Video, `camera_0001` for Immersive Light Field Video, 10 for Technicolor, the test file for Dynamic 3D
    /// Gaussians), otherwise every `every_nth`-th camera.
    pub test_cameras: Vec<String>,
    /// Rigs: the number of the first frame, as in the file names. If unset: the first frame that exists.
    pub first_frame: Option<u64>,
    /// Rigs: number of frames. If unset: all frames, or at most 300 for Neural 3D Video.
    pub frame_count: Option<u32>,
    /// Number of validation views, evenly spread over the official val split, or held out of the training views if there is
    /// no such split. If unset: Blender's official val split, unless it serves as the test split; otherwise none.
    pub val_count: Option<u32>,
    /// Keeps every n-th training view.
    pub frame_step: u32,
    /// Maximum number of training views, evenly spread, after `frame_step`.
    pub train_limit: Option<u32>,
    /// Frames per second of the videos that the images come from. Transforms files and TUM's sequences state times instead.
    pub fps: f64,
    /// Whether all images show the same instant (photos of a static scene). If unset: only those of LLFF do, unless the capture
    /// has a folder `flow`, `flow_i1`, `motion_masks` or `mv_masks`, which is made for videos.
    #[serde(rename = "static")]
    pub static_scene: Option<bool>,
    /// Transforms files, TUM and ScanNet: scene units per stored unit of a depth file. If unset: what the transforms file states,
    /// otherwise 0.001 (millimetres) for PNG and NumPy and 1 for EXR and PFM; for TUM 0.0002, and for Bonn 1.059 times that.
    pub depth_unit: Option<f64>,
    /// COLMAP: minimum share of images with a pose; 0 accepts every model.
    pub min_registered_share: f64,
    /// VGGT and MonST3R: share of the depth values, those with the least confidence, that are treated as unknown.
    pub unsure_share: f64,
}

/// The format of a capture's folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Recognised by its files.
    #[default]
    Auto,
    /// `transforms_{train,val,test}.json`: D-NeRF and the synthetic scenes of NeRF.
    Blender,
    /// A single `transforms.json`: nerfstudio, instant-ngp, Polycam, Record3D, KIRI Engine, Metashape.
    Nerfstudio,
    /// A COLMAP sparse model (`sparse/0/{cameras,images,points3D}.{bin,txt}`) next to its images.
    Colmap,
    /// `camera/*.json` with `dataset.json`, `metadata.json` and `rgb/1x`: Nerfies, HyperNeRF and DyCheck.
    Nerfies,
    /// `intri.yml`, `extri.yml`, and `images/CAMERA/FRAME.jpg` or `videos/CAMERA.mp4`: EasyMocap, EasyVolcap, ENeRF-Outdoor,
    /// MobileStage.
    EasyVolcap,
    /// CMU Panoptic: `train_meta.json` and `ims/` of Dynamic 3D Gaussians, or `calibration_*.json` and `hdImgs/` or
    /// `hdVideos/` of the studio's toolbox.
    Panoptic,
    /// `cameras_parameters.txt` and `SCENE_undist_FFFFF_CC.png`: the light-field videos of Technicolor.
    Technicolor,
    /// `poses_bounds.npy` and `images/`: photos of a static scene, as LLFF stores them, or frames of one moving
    /// camera, as NSFF and DynamicNeRF do.
    Llff,
    /// `poses_bounds.npy`, `images/` and `mv_images/`: NVIDIA's Dynamic Scenes, as NSFF prepares them.
    Nvidia,
    /// `poses_bounds.npy` and `camNN.mp4` of each camera, or its frames in `camNN/images` or `camNN`: Neural 3D Video.
    N3v,
    /// `models.json` and `camera_NNNN.mp4` of each camera, or its frames in `camera_NNNN`: Immersive Light Field Video.
    Immersive,
    /// `rgb.txt`, `depth.txt` and `groundtruth.txt`: RGB-D sequences of TUM, Bonn and ETH3D.
    Tum,
    /// `color/N.jpg`, `depth/N.png`, `pose/N.txt` and `intrinsic/`: exported scenes of ScanNet.
    ScanNet,
    /// `predictions.npz` of VGGT, and `images/`: poses and depth in one gauge.
    Vggt,
    /// `SCENE_sgd_cvd_hr.npz` or `SCENE_droid.npz` of MegaSaM: images, poses and depth in one gauge.
    MegaSam,
    /// `pred_traj.txt`, `pred_intrinsics.txt` and `frame_0000.{png,npy}`: MonST3R, the video version of DUSt3R.
    Monst3r,
}

/// A resize filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resize {
    /// Box average.
    Area,
    /// Windowed sinc with three lobes.
    Lanczos3,
}

/// The colour behind transparent pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// White (1, 1, 1), as in most of the literature on D-NeRF.
    #[default]
    White,
    /// Black (0, 0, 0).
    Black,
}

/// An official split that can serve as the test split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TestSplit {
    /// `transforms_test.json`, or `test_filenames`.
    #[default]
    Test,
    /// `transforms_val.json`, or `val_filenames`.
    Val,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            source: PathBuf::new(),
            format: Format::Auto,
            width: None,
            resize: None,
            images: None,
            calibration: None,
            background: Background::White,
            test_split: TestSplit::Test,
            protocol: String::new(),
            every_nth: 8, // the split of LLFF, Mip-NeRF 360 and the 3DGS loaders
            test_cameras: Vec::new(),
            first_frame: None,
            frame_count: None,
            val_count: None,
            frame_step: 1,
            train_limit: None,
            fps: 30.0,
            static_scene: None,
            depth_unit: None,
            min_registered_share: 0.5, // below this share, structure from motion has failed
            unsure_share: 0.2,         // sky, reflections and edges; VGGT's viewer hides half
        }
    }
}

impl Format {
    /// The formats with one video or folder per camera.
    pub(crate) const RIGS: [Self; 5] =
        [Self::N3v, Self::Immersive, Self::Technicolor, Self::EasyVolcap, Self::Panoptic];

    /// The name in protocols and captures.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Blender => "blender",
            Self::Nerfstudio => "nerfstudio",
            Self::Colmap => "colmap",
            Self::Nerfies => "nerfies",
            Self::EasyVolcap => "easyvolcap",
            Self::Panoptic => "panoptic",
            Self::Technicolor => "technicolor",
            Self::Llff => "llff",
            Self::Nvidia => "nvidia",
            Self::N3v => "n3v",
            Self::Immersive => "immersive",
            Self::Tum => "tum",
            Self::ScanNet => "scannet",
            Self::Vggt => "vggt",
            Self::MegaSam => "megasam",
            Self::Monst3r => "monst3r",
        }
    }
}

impl Background {
    /// The name in recipes and protocols.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::White => "white",
            Self::Black => "black",
        }
    }

    /// The colour, with components in [0, 1].
    pub(crate) fn rgb(self) -> [f32; 3] {
        match self {
            Self::White => [1.0; 3],
            Self::Black => [0.0; 3],
        }
    }
}

/// The widest image that renderers and GPUs support; larger numbers are probably typing errors.
const MAX_WIDTH: u32 = 16384;

impl Params {
    /// Whether all images are stated to show the same instant.
    pub(crate) fn is_static(&self) -> bool {
        self.static_scene == Some(true)
    }

    /// The resize filter.
    pub(crate) fn filter(&self) -> Resize {
        self.resize.unwrap_or(Resize::Area)
    }

    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let relative = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
        let checks = [
            (
                self.source.as_os_str().is_empty(),
                "source",
                "the source folder is missing",
                "e.g. source = \"dnerf/bouncingballs\"",
            ),
            (
                !relative(&self.source),
                "source",
                "the source must be below the data root",
                "use a relative path without . and ..",
            ),
            (
                self.images.as_deref().is_some_and(|images| !relative(images)),
                "images",
                "the folder of images must be inside the capture",
                "e.g. images = \"images_4\"",
            ),
            (
                self.calibration.as_deref().is_some_and(|folder| !relative(folder)),
                "calibration",
                "the folder of the calibration must be inside the capture",
                "e.g. calibration = \"optimized\"",
            ),
            (self.frame_count == Some(0), "frame_count", "must be at least 1", "omit it to keep every frame"),
            (self.width == Some(0), "width", "must be at least 1 pixel", "omit it to keep the native size"),
            (
                self.width.is_some_and(|width| width > MAX_WIDTH),
                "width",
                "must be at most 16384 pixels",
                "omit it to keep the native size",
            ),
            (
                self.resize.is_some() && self.width.is_none(),
                "resize",
                "has no effect without width",
                "set width, or remove resize",
            ),
            (self.frame_step == 0, "frame_step", "must be at least 1", "1 keeps every training view"),
            (self.train_limit == Some(0), "train_limit", "must be at least 1", "omit it to keep every training view"),
            (
                self.every_nth == 1,
                "every_nth",
                "every image would be a test view",
                "use 8 (the usual choice), or 0 for no test views",
            ),
            (
                self.depth_unit.is_some_and(|unit| !(unit > 0.0 && unit.is_finite())),
                "depth_unit",
                "must be positive and finite",
                "0.001 for millimetres in scenes in metres",
            ),
            (!(self.fps > 0.0 && self.fps.is_finite()), "fps", "must be positive and finite", "30 is a common rate"),
            (
                !(0.0..=1.0).contains(&self.min_registered_share),
                "min_registered_share",
                "must lie in [0, 1]",
                "0 accepts every model",
            ),
            (!(0.0..1.0).contains(&self.unsure_share), "unsure_share", "must lie in [0, 1)", "0 keeps every value"),
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
            message: format!("there is no protocol {:?}", self.protocol),
            hint: Some(format!("use one of {}", names.join(", "))),
        })
    }
}
