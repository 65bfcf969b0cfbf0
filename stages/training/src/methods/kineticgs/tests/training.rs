//! End-to-end trainings on the test scene.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::*;
use crate::params::TrainingParams;
use crate::trainer::Trainer;

/// Twelve views of blobs, half of them moving; the quality curve is measured on training views.
fn moving_scene() -> (tempfile::TempDir, Dataset, Supplements) {
    let dir = tempfile::tempdir().unwrap();
    let scene = TestScene { train_views: 12, val_views: 0, travel: 1.2, ..TestScene::default() };
    let dataset = Dataset::load(scene.write(dir.path()), 2).unwrap();
    let supplements = scene.supplements(&dataset);
    (dir, dataset, supplements)
}

/// Small, fast-learning fields, with all losses active from the first iterations.
fn params(coarse: u64, fine: u64) -> Value {
    let field = |texels: u64| {
        json!({
            "channels": 8, "spatial_resolution": texels, "time_resolution": 12, "multipliers": [1],
            "regularizers": { "spatial_smoothness": 1e-4, "temporal_smoothness": 1e-3, "time_to_one": 1e-4 },
        })
    };
    json!({
        "method": "kineticgs",
        "iterations": { "coarse": coarse, "fine": fine },
        "batch": 1,
        "loss": { "lambda_dssim": 0.0 },
        "kineticgs": {
            "anchors": { "voxel_size": 0.02 },
            "deformation": {
                "anchors": field(8), "gaussians": field(16), "width": 32,
                "plane_rate": { "start": 5e-3, "end": 5e-4, "steps": 500 },
                "network_rate": { "start": 1e-3, "end": 1e-4, "steps": 500 },
            },
            "losses": { "ramp": 50, "flow_fades_from": 300, "flow_ends": 400 },
        },
    })
}

fn trained(dataset: &Dataset, supplements: &Supplements, params: Value) -> f64 {
    let params: TrainingParams = serde_json::from_value(params).unwrap();
    let mut trainer = Trainer::new(dataset, supplements, &params).unwrap();
    while !trainer.is_done() {
        trainer.advance().unwrap();
    }
    trainer.report().curve.last().unwrap().psnr_val
}

#[test]
fn motion_improves_psnr_over_static_anchors() {
    let (_dir, dataset, supplements) = moving_scene();
    let moving = trained(&dataset, &supplements, params(100, 400));
    let mut still = params(100, 400);
    still["effects"] = json!([]);
    let still = trained(&dataset, &supplements, still);
    assert!(moving >= still + 1.0, "moving {moving:.2} dB, still {still:.2} dB");
}

#[test]
fn resume_with_anchor_growth_is_bytewise_equal() {
    let (_dir, dataset, supplements) = moving_scene();
    let mut params = params(12, 14);
    params["batch"] = json!(2);
    params["density"] =
        json!({ "from": 4, "interval": 5, "gradient_threshold": 1e-7, "min_opacity": 0.05, "max_count": 2000 });
    params["kineticgs"]["anchors"]["growth"] = json!({ "statistics_from": 0, "success": 0.1 });
    let params: TrainingParams = serde_json::from_value(params).unwrap();
    let finish = |mut trainer: Trainer<'_>| {
        while !trainer.is_done() {
            trainer.advance().unwrap();
        }
        trainer.finish().unwrap().tensors
    };
    let whole = finish(Trainer::new(&dataset, &supplements, &params).unwrap());
    let anchors = |tensors: &BTreeMap<String, crate::artifact::NamedTensor>| tensors["anchors.features"].shape[0];
    let first = Trainer::new(&dataset, &supplements, &params).unwrap();
    assert_ne!(anchors(&whole), anchors(&finish_none(first)), "no anchor was added or removed");
    for stop in [3, 11, 17] {
        let mut trainer = Trainer::new(&dataset, &supplements, &params).unwrap();
        (0..stop).for_each(|_| trainer.advance().unwrap());
        let checkpoint = trainer.checkpoint().unwrap();
        let resumed = finish(Trainer::resume(&dataset, &supplements, &params, checkpoint).unwrap());
        assert!(resumed == whole, "stopped after {stop} steps");
    }
}

/// The tensors before the first step.
fn finish_none(mut trainer: Trainer<'_>) -> BTreeMap<String, crate::artifact::NamedTensor> {
    let tensors = trainer.checkpoint().unwrap().tensors;
    tensors.into_iter().filter_map(|(name, tensor)| Some((name.strip_prefix("value.")?.to_string(), tensor))).collect()
}
