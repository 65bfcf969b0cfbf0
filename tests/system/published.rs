//! The recipes of papers train with the settings of the published code, which the READMEs of the methods list by data set.

use std::path::Path;

use serde_json::Value;

use crate::papers::plan;
use crate::recipes::param;

const DNERF: &[&str] =
    &["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "lego-val", "mutant", "standup", "trex"];
const N3V: &[&str] =
    &["coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"];
const TWO_CAMERAS: &[&str] = &["broom2", "vrig-3dprinter", "vrig-chicken", "vrig-peel-banana"];
const ONE_CAMERA: &[&str] =
    &["aleks-teapot", "chickchicken", "cut-lemon1", "hand1-dense-v2", "slice-banana", "torchocolate"];
const DYCHECK: &[&str] = &["apple", "block", "paper-windmill", "space-out", "spin", "teddy", "wheel"];

/// Recipes of papers with the scenes of a data set, and its column in [`HEXPLANES`].
const DATA_SETS: [(&str, &[&str], usize); 6] = [
    ("phys4dgs", DNERF, 0),
    ("phys4dgs", TWO_CAMERAS, 1),
    ("kineticgs", ONE_CAMERA, 1),
    ("phys4dgs", DYCHECK, 2),
    ("kineticgs", DYCHECK, 2),
    ("phys4dgs", N3V, 3),
];

/// 4DGaussians 843d5ac, arguments/dnerf, hypernerf, dycheck and dynerf. D-NeRF has no points, so that their limit is not used.
const HEXPLANES: [(&str, [&str; 4]); 19] = [
    ("deformable4dgs.channels", ["32", "16", "16", "16"]),
    ("deformable4dgs.multipliers", ["[1, 2]", "[1, 2, 4]", "[1, 2, 4]", "[1, 2]"]),
    ("deformable4dgs.width", ["64", "128", "128", "128"]),
    ("deformable4dgs.spatial_resolution", ["64", "64", "64", "64"]),
    ("deformable4dgs.spatial_smoothness", ["1e-4", "2e-4", "2e-4", "2e-4"]),
    ("deformable4dgs.temporal_smoothness", ["1e-2", "1e-3", "1e-3", "1e-3"]),
    ("deformable4dgs.time_to_one", ["1e-4", "1e-4", "1e-4", "1e-4"]),
    ("deformable4dgs.heads.opacity", ["false", "false", "false", "true"]),
    ("deformable4dgs.heads.harmonics", ["false", "false", "false", "true"]),
    ("deformable4dgs.plane_rate.start", ["1.6e-3", "1.6e-3", "1.6e-3", "1.6e-3"]),
    ("deformable4dgs.plane_rate.end", ["1.6e-5", "1.6e-4", "1.6e-4", "1.6e-4"]),
    ("deformable4dgs.network_rate.start", ["1.6e-4", "1.6e-4", "1.6e-4", "1.6e-4"]),
    ("deformable4dgs.network_rate.end", ["1.6e-6", "1.6e-5", "1.6e-5", "1.6e-5"]),
    ("iterations.coarse", ["3000", "3000", "3000", "3000"]),
    ("iterations.fine", ["20000", "14000", "60000", "14000"]),
    ("density.until", ["15000", "10000", "10000", "10000"]),
    ("density.prune_interval", ["8000", "100", "100", "100"]),
    ("density.opacity_reset_interval", ["3000", "0", "0", "0"]),
    ("initial_points.max_count", ["200000", "40000", "40000", "40000"]),
];

/// Values that differ between the scenes of a data set, and those of other methods: recipe, job, key, value.
const SINGLE_VALUES: &[(&str, &str, &str, &str)] = &[
    // 4DGaussians: texels along time, views per step.
    ("phys4dgs", "broom2/deformable4dgs", "deformable4dgs.time_resolution", "100"),
    ("phys4dgs", "vrig-3dprinter/deformable4dgs", "deformable4dgs.time_resolution", "100"),
    ("phys4dgs", "vrig-chicken/deformable4dgs", "deformable4dgs.time_resolution", "80"),
    ("phys4dgs", "vrig-peel-banana/deformable4dgs", "deformable4dgs.time_resolution", "250"),
    ("kineticgs", "slice-banana/deformable4dgs", "deformable4dgs.time_resolution", "150"),
    ("phys4dgs", "apple/deformable4dgs", "deformable4dgs.time_resolution", "150"),
    ("phys4dgs", "cook_spinach/deformable4dgs", "deformable4dgs.time_resolution", "150"),
    ("phys4dgs", "trex/deformable4dgs", "batch", "1"),
    ("phys4dgs", "trex/deformable4dgs", "initial_points.random_count", "2000"),
    ("phys4dgs", "broom2/deformable4dgs", "batch", "2"),
    ("phys4dgs", "wheel/deformable4dgs", "batch", "2"),
    ("phys4dgs", "sear_steak/deformable4dgs", "batch", "2"),
    ("phys4dgs", "coffee_martini/deformable4dgs", "batch", "4"),
    ("phys4dgs", "flame_salmon/deformable4dgs", "batch", "4"),
    ("mcgs", "vrig-chicken/deformable4dgs", "deformable4dgs.temporal_smoothness", "1e-3"),
    // What Phys4DGS states.
    ("phys4dgs", "broom2/phys4dgs", "batch", "1"),
    ("phys4dgs", "trex/phys4dgs", "phys4dgs.field.multipliers", "[1, 2]"),
    ("phys4dgs", "cook_spinach/phys4dgs", "phys4dgs.field.multipliers", "[1, 2, 4]"),
    ("phys4dgs", "dance3/phys4dgs", "phys4dgs.field.multipliers", "[1, 2, 4]"),
    ("phys4dgs", "apple/phys4dgs", "initial_points.max_count", "100000"),
    // Deformable-3DGS, its README: D-NeRF and real scenes.
    ("mcgs", "lego/deformable3dgs", "deformable3dgs.network.time_bands", "6"),
    ("mcgs", "lego/deformable3dgs", "deformable3dgs.network.time_features", "30"),
    ("mcgs", "lego/deformable3dgs", "iterations.all", "37000"),
    ("mcgs", "vrig-chicken/deformable3dgs", "deformable3dgs.network.time_bands", "10"),
    ("mcgs", "vrig-chicken/deformable3dgs", "deformable3dgs.network.time_features", "0"),
    ("mcgs", "vrig-chicken/deformable3dgs", "iterations.all", "17000"),
    ("phys4dgs", "dance3/deformable3dgs", "iterations.all", "17000"),
    // SC-GS: D-NeRF and real scenes.
    ("mcgs", "lego/scgs", "scgs.features", "8"),
    ("mcgs", "lego/scgs", "scgs.nodes.count", "512"),
    ("kineticgs", "apple/scgs", "scgs.features", "2"),
    ("kineticgs", "apple/scgs", "scgs.network.time_bands", "10"),
    // 4D-GS, its configurations by scene.
    ("phys4dgs", "bouncingballs/realtime4dgs", "batch", "2"),
    ("phys4dgs", "bouncingballs/realtime4dgs", "iterations.train", "20000"),
    ("phys4dgs", "hellwarrior/realtime4dgs", "batch", "1"),
    ("phys4dgs", "hook/realtime4dgs", "batch", "8"),
    ("phys4dgs", "jumpingjacks/realtime4dgs", "batch", "16"),
    ("phys4dgs", "jumpingjacks/realtime4dgs", "initial_points.random_count", "300000"),
    ("phys4dgs", "lego/realtime4dgs", "batch", "2"),
    ("phys4dgs", "lego/realtime4dgs", "initial_points.random_count", "100000"),
    ("phys4dgs", "mutant/realtime4dgs", "batch", "8"),
    ("phys4dgs", "standup/realtime4dgs", "batch", "8"),
    ("phys4dgs", "trex/realtime4dgs", "batch", "24"),
    ("phys4dgs", "trex/realtime4dgs", "density.batch_gradient", "\"mean-over-views\""),
    ("phys4dgs", "cook_spinach/realtime4dgs", "batch", "4"),
    ("phys4dgs", "cook_spinach/realtime4dgs", "realtime4dgs.clip_length", "10.0"),
    ("phys4dgs", "cook_spinach/realtime4dgs", "initial_points.max_count", "300000"),
    ("phys4dgs", "flame_steak/realtime4dgs", "density.opacity_reset_interval", "10000"),
    // MoDec-GS on HyperNeRF.
    ("kineticgs", "torchocolate/modecgs", "iterations.fine", "30000"),
    ("kineticgs", "torchocolate/modecgs", "batch", "4"),
    ("kineticgs", "slice-banana/modecgs", "batch", "2"),
    ("kineticgs", "apple/modecgs", "iterations.fine", "20000"),
    // Chosen here, because nothing is published for these rigs: as N3V.
    ("phys4dgs", "actor1_4/deformable4dgs", "deformable4dgs.multipliers", "[1, 2]"),
    ("phys4dgs", "box/realtime4dgs", "realtime4dgs.clip_length", "28.0"),
];

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

#[test]
fn hexplanes_train_as_published_on_every_data_set() {
    let plans = ["phys4dgs", "kineticgs"].map(|paper| (paper, plan(paper, Path::new("data"))));
    for (paper, scenes, column) in DATA_SETS {
        let (_, plan) = plans.iter().find(|(name, _)| *name == paper).expect("a plan");
        for scene in scenes {
            let node = format!("train/{scene}/deformable4dgs/0");
            for (key, values) in HEXPLANES {
                assert_eq!(param(plan, &node, key), json(values[column]), "{key} of {node} of {paper}");
            }
        }
    }
}

/// L4DGS states no settings of its base, so that both have those of the published code.
#[test]
fn l4dgs_trains_as_its_base_does() {
    let plan = plan("l4dgs", Path::new("data"));
    for scene in [DNERF, N3V].concat() {
        let [base, own] = ["deformable4dgs", "l4dgs"].map(|method| format!("train/{scene}/{method}/0"));
        assert_eq!(param(&plan, &own, "l4dgs.hexplane"), param(&plan, &base, "deformable4dgs"), "{scene}");
        for key in ["batch", "iterations", "density", "initial_points", "learning_rates"] {
            assert_eq!(param(&plan, &own, key), param(&plan, &base, key), "{key} of {scene}");
        }
    }
}

#[test]
fn published_settings_reach_the_trainings_of_their_scenes_only() {
    let plans = ["phys4dgs", "kineticgs", "mcgs"].map(|paper| (paper, plan(paper, Path::new("data"))));
    for (paper, job, key, value) in SINGLE_VALUES {
        let (_, plan) = plans.iter().find(|(name, _)| name == paper).expect("a plan");
        assert_eq!(param(plan, &format!("train/{job}/0"), key), json(value), "{key} of {job} of {paper}");
    }
    let has = |method: &str, scene: &str, effect: &str| {
        let effects = param(&plans[0].1, &format!("train/{scene}/{method}/0"), "effects");
        effects.as_array().expect("a list").iter().any(|on| on == effect)
    };
    for (method, scene, effect, expected) in [
        ("realtime4dgs", "lego", "rigid", true),
        ("realtime4dgs", "trex", "rigid", false),
        ("deformable3dgs", "apple", "time-noise", true),
        ("deformable3dgs", "trex", "time-noise", false),
    ] {
        assert_eq!(has(method, scene, effect), expected, "{effect} of {method} on {scene}");
    }
}

#[test]
fn protocols_and_masks_reach_their_data_set_only() {
    let expected = [
        ("phys4dgs", "capture/softball", "protocol", "\"cmu-panoptic-1080\""),
        ("kineticgs", "metrics/apple/scgs/0", "masks.co_visibility.folder", "\"dycheck/apple/covisible/2x/val\""),
        ("kineticgs", "ablated-metrics/spin/2/full", "masks.foreground.keeps", "\"half\""),
        ("kineticgs", "metrics/slice-banana/scgs/0", "masks.co_visibility.folder", "\"\""),
    ];
    for (paper, node, key, value) in expected {
        assert_eq!(param(&plan(paper, Path::new("data")), node, key), json(value), "{key} of {node} of {paper}");
    }
}
