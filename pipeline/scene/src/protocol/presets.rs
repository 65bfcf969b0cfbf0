//! Named protocols under which papers publish results, and the sets of scenes over which they average.

use super::Protocol;

/// A named protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preset {
    /// Name in recipes and tables.
    pub name: &'static str,
    /// The papers that publish results under it, and the details that they leave open.
    pub about: &'static str,
    dataset: &'static str,
    split: &'static str,
    size: [u32; 2],
    resize: &'static str,
    background: &'static str,
    time: &'static str,
}

/// All presets. Where the importers lack the resize filter of a paper, the preset has the most similar one.
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
        "Lego on its validation views, which show the shovel in its training pose",
    ),
    dnerf_val(
        "dnerf-800-black-val",
        800,
        "none",
        "black",
        "Lego on its validation views, nearly as in Deformable 3DGS",
    ),
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
    rig_1080(
        "enerf-outdoor-1080",
        "enerf-outdoor",
        "camera 08 held out, 1200 frames",
        "Phys4DGS, Long Volumetric Video",
    ),
    rig_1080("mobilestage-1080", "mobilestage", "camera 05 held out, 1600 frames", "Phys4DGS, Long Volumetric Video"),
    rig_1080(
        "cmu-panoptic-1080",
        "cmu-panoptic",
        "cameras 00_00 00_10 00_15 00_30 held out",
        "the studio's videos with the test cameras of Dynamic 3D Gaussians: Phys4DGS, Long Volumetric Video (clips open)",
    ),
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
        about: "DyCheck's iPhone scenes with its co-visibility masks, on which metrics depend: KineticGS, Phys4DGS",
        dataset: "dycheck",
        split: "DyCheck, images at 1/2",
        size: [360, 480],
        resize: "none",
        background: "black",
        time: "time id / last time id",
    },
];

/// A preset of D-NeRF with square images, tested on the official test views.
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

/// A preset of D-NeRF with square images, tested on the validation views.
const fn dnerf_val(
    name: &'static str,
    side: u32,
    resize: &'static str,
    background: &'static str,
    about: &'static str,
) -> Preset {
    Preset { split: "official, tested on val", ..dnerf(name, side, resize, background, about) }
}

/// A preset of a rig that films long clips at 1920×1080.
const fn rig_1080(name: &'static str, dataset: &'static str, split: &'static str, about: &'static str) -> Preset {
    let time = "index / (count - 1)";
    Preset { name, about, dataset, split, size: [1920, 1080], resize: "none", background: "none", time }
}

/// A preset of HyperNeRF, with images of `size` (width, height).
const fn hypernerf(name: &'static str, split: &'static str, size: [u32; 2], about: &'static str) -> Preset {
    let (dataset, time) = ("nerfies", "time id / last time id");
    Preset { name, about, dataset, split, size, resize: "none", background: "none", time }
}

impl Preset {
    /// Finds a preset by its name.
    pub fn named(name: &str) -> Option<&'static Self> {
        PRESETS.iter().find(|preset| preset.name == name)
    }

    /// The protocol of the preset.
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

/// Names of scenes, in the order of the published table.
type Scenes = &'static [&'static str];

const DNERF: &[Scenes] = &[
    &["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex"],
    // Without Lego, whose test views show another state than its training views: most papers omit it.
    &["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "mutant", "standup", "trex"],
];
const N3V: &[Scenes] = &[
    &["coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"],
    // HexPlane omits the scene with a badly synchronised camera.
    &["cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"],
];
const HYPERNERF: &[Scenes] = &[
    // Two cameras, tested on the held-out one.
    &["vrig-3dprinter", "broom2", "vrig-chicken", "vrig-peel-banana"],
    // One camera, tested between training frames.
    &["aleks-teapot", "chickchicken", "cut-lemon1", "hand1-dense-v2", "slice-banana", "torchocolate"],
];
const DYCHECK: &[Scenes] = &[
    &["apple", "block", "paper-windmill", "space-out", "spin", "teddy", "wheel"],
    // Shape of Motion omits two scenes.
    &["apple", "block", "paper-windmill", "spin", "teddy"],
];
const ENERF_OUTDOOR: &[Scenes] = &[&["actor1_4", "actor2_3", "actor5_6"]];
const CMU_PANOPTIC: &[Scenes] = &[
    // Clips of Long Volumetric Video, at full size.
    &["basketball", "box", "softball"],
    // Dynamic 3D Gaussians, at 640×360.
    &["basketball", "boxes", "football", "juggle", "softball", "tennis"],
];

impl Protocol {
    /// The sets of scenes over which papers average on this data set, for images of any size. If there are several,
    /// reports show them side by side, because they differ by more than most methods do.
    pub fn quoted_means(&self) -> &'static [Scenes] {
        match self.dataset.as_str() {
            "dnerf" => DNERF,
            "n3v" => N3V,
            "nerfies" => HYPERNERF,
            "dycheck" => DYCHECK,
            "enerf-outdoor" => ENERF_OUTDOOR,
            "cmu-panoptic" => CMU_PANOPTIC,
            _ => &[],
        }
    }
}
