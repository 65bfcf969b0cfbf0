//! Protocols that results are quoted under, by name, and the sets of scenes that their means are over.

use super::Protocol;

/// A protocol with a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preset {
    /// As recipes and tables have it.
    pub name: &'static str,
    /// Who publishes numbers under it, and what they leave open.
    pub about: &'static str,
    dataset: &'static str,
    split: &'static str,
    size: [u32; 2],
    resize: &'static str,
    background: &'static str,
    time: &'static str,
}

/// Every preset; where importers offer no filter of a source's own, the nearest that they offer.
pub const PRESETS: &[Preset] = &[
    dnerf(
        "dnerf-800-white",
        800,
        "none",
        "white",
        "4DGaussians; Grid4D's re-measurement of it; L4DGS (background open)",
    ),
    dnerf("dnerf-800-black", 800, "none", "black", "Deformable 3DGS and Grid4D; MCGS (background open)"),
    dnerf("dnerf-400-white", 400, "area", "white", "D-NeRF (which resizes before it composites), TiNeuVox, K-Planes"),
    dnerf("dnerf-400-white-lanczos", 400, "lanczos3", "white", "MonoDyGauBench, an independent benchmark"),
    dnerf(
        "dnerf-400-black",
        400,
        "area",
        "black",
        "4D-GS of Fudan (bicubic), SC-GS (some scenes), Phys4DGS (background open)",
    ),
    dnerf_val(
        "dnerf-800-white-val",
        800,
        "none",
        "white",
        "Lego on its validation views, whose shovel stands as in training",
    ),
    dnerf_val("dnerf-800-black-val", 800, "none", "black", "Lego on its validation views: Deformable 3DGS, nearly"),
    dnerf_val("dnerf-400-white-val", 400, "area", "white", "Lego on its validation views"),
    dnerf_val("dnerf-400-black-val", 400, "area", "black", "Lego on its validation views: 4D-GS of Fudan"),
    Preset {
        name: "n3v-1352",
        about: "Neural 3D Video, 300 frames, the central camera held out: 4DGaussians, L4DGS, Phys4DGS",
        dataset: "n3v",
        split: "camera 0 held out",
        size: [1352, 1014],
        resize: "lanczos3",
        background: "none",
        time: "index / (count - 1)",
    },
    hypernerf(
        "hypernerf-vrig-536",
        "official, images at 1/2",
        [536, 960],
        "4DGaussians and MCGS: tested on the other camera",
    ),
    hypernerf(
        "hypernerf-vrig-268",
        "official, images at 1/4",
        [268, 480],
        "HyperNeRF's own: tested on the other camera",
    ),
    hypernerf(
        "hypernerf-interp-536",
        "interpolation: 1 of 4, tested half-way, images at 1/2",
        [536, 960],
        "HyperNeRF's own; KineticGS (size open): tested between frames",
    ),
    Preset {
        name: "dycheck-360",
        about: "DyCheck's iPhone scenes under its masks of co-visibility, on which the metrics depend: KineticGS, Phys4DGS",
        dataset: "dycheck",
        split: "DyCheck, images at 1/2",
        size: [360, 480],
        resize: "none",
        background: "black",
        time: "time id / last time id",
    },
];

const fn dnerf(
    name: &'static str,
    side: u32,
    resize: &'static str,
    background: &'static str,
    about: &'static str,
) -> Preset {
    let time = "(file time - min) / (max - min)";
    Preset { name, about, dataset: "dnerf", split: "official", size: [side, side], resize, background, time }
}

const fn dnerf_val(
    name: &'static str,
    side: u32,
    resize: &'static str,
    background: &'static str,
    about: &'static str,
) -> Preset {
    Preset { split: "official, tested on val", ..dnerf(name, side, resize, background, about) }
}

const fn hypernerf(name: &'static str, split: &'static str, size: [u32; 2], about: &'static str) -> Preset {
    let (dataset, time) = ("nerfies", "time id / last time id");
    Preset { name, about, dataset, split, size, resize: "none", background: "none", time }
}

impl Preset {
    /// The preset of a name.
    pub fn named(name: &str) -> Option<&'static Self> {
        PRESETS.iter().find(|preset| preset.name == name)
    }

    /// The protocol itself.
    pub fn protocol(&self) -> Protocol {
        Protocol {
            dataset: self.dataset.into(),
            split: self.split.into(),
            width: self.size[0],
            height: self.size[1],
            resize: self.resize.into(),
            background: self.background.into(),
            time: self.time.into(),
        }
    }
}

/// Names of scenes, in the order of the data set's table.
type Scenes = &'static [&'static str];

const DNERF: &[Scenes] = &[
    &["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex"],
    // Lego's test views show another state than its training views: the literature drops it more often than not.
    &["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "mutant", "standup", "trex"],
];
const N3V: &[Scenes] = &[
    &["coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"],
    // HexPlane leaves out the scene with a camera that is badly synchronised.
    &["cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"],
];
const HYPERNERF: &[Scenes] = &[
    // Two cameras, tested on the other one.
    &["vrig-3dprinter", "broom2", "vrig-chicken", "vrig-peel-banana"],
    // One camera, tested between frames.
    &["aleks-teapot", "chickchicken", "cut-lemon1", "hand1-dense-v2", "slice-banana", "torchocolate"],
];
const DYCHECK: &[Scenes] = &[
    &["apple", "block", "paper-windmill", "space-out", "spin", "teddy", "wheel"],
    // Shape of Motion leaves out two.
    &["apple", "block", "paper-windmill", "spin", "teddy"],
];

impl Protocol {
    /// The sets of scenes whose means are quoted of this data set, at whatever size; side by side where there are
    /// several, since they differ by more than most methods do.
    pub fn quoted_means(&self) -> &'static [Scenes] {
        match self.dataset.as_str() {
            "dnerf" => DNERF,
            "n3v" => N3V,
            "nerfies" => HYPERNERF,
            "dycheck" => DYCHECK,
            _ => &[],
        }
    }
}
