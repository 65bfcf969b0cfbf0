//! Short trainings on the test scene, for tests of what an effect allocates and computes.

use std::collections::BTreeSet;

use serde_json::json;

use crate::data::{Dataset, NOTHING};
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;
use crate::trainer::Trainer;

/// The tensors and operations of a short training.
#[derive(Debug, PartialEq)]
pub(crate) struct ShortTraining {
    /// Names of all tensors.
    pub tensors: BTreeSet<String>,
    /// Names of all operations.
    pub operations: BTreeSet<String>,
    /// The bits of every value and moment by name.
    pub checkpoint: Vec<(String, Vec<u32>)>,
}

impl ShortTraining {
    /// Runs every phase of a method for two steps, with these settings and exactly these effects.
    pub(crate) fn run(method: &str, settings: serde_json::Value, effects: &[&str]) -> Self {
        Self::run_on(TestScene { size: 16, ..TestScene::default() }, method, settings, effects)
    }

    /// [`ShortTraining::run`] on another scene.
    pub(crate) fn run_on(scene: TestScene, method: &str, settings: serde_json::Value, effects: &[&str]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let dataset = Dataset::load(scene.write(dir.path()), 1).unwrap();
        let defaults = TrainingParams::of(method).unwrap();
        let iterations: serde_json::Map<_, _> =
            defaults.shared.iterations.keys().map(|phase| (phase.clone(), json!(2))).collect();
        let table = json!({
            "method": method, "iterations": iterations, "effects": effects, "curve": { "points": 0 }, method: settings,
        });
        let params = TrainingParams::from_table(table.as_object().unwrap().clone()).unwrap();
        let mut trainer = Trainer::new(&dataset, &NOTHING, &params).unwrap();
        while !trainer.is_done() {
            trainer.advance().unwrap();
        }
        let tensors = trainer.checkpoint().unwrap().tensors;
        let names = tensors.keys().filter_map(|name| name.strip_prefix("value.")).map(String::from).collect();
        let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect();
        Self {
            tensors: names,
            operations: trainer.report().kernels_ms.into_keys().collect(),
            checkpoint: tensors.iter().map(|(name, tensor)| (name.clone(), bits(&tensor.values))).collect(),
        }
    }

    /// Number of tensors whose names have a prefix.
    pub(crate) fn count_tensors(&self, prefix: &str) -> usize {
        self.tensors.iter().filter(|name| name.starts_with(prefix)).count()
    }

    /// Whether an operation ran.
    pub(crate) fn ran(&self, operation: &str) -> bool {
        self.operations.contains(operation)
    }
}
