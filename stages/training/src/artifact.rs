//! The artifact of training: every tensor of a model by name, and the header needed to use them.

mod influence;

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context as _, bail, ensure};
use engine::Decision;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use scene::{Protocol, TimeMap};
use serde::{Deserialize, Serialize};

pub use influence::{GroupShare, INERT_SHARE, LossInfluence, PhaseInfluence, largest_share};
pub(crate) use influence::{PHOTOMETRIC, Stalled};

/// The header's file name.
const HEADER: &str = "model.json";
/// The tensors' file name.
const TENSORS: &str = "model.safetensors";

/// A trained model: `model.json` (the header) and `model.safetensors` (every tensor, f32, by name).
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Everything that is not a tensor: method, parameters, scene and effects.
    pub header: ModelHeader,
    /// Tensors by name, e.g. `gaussians.positions`.
    pub tensors: BTreeMap<String, NamedTensor>,
}

/// The largest magnitude of a tensor's gradient during a training, and the step at which it occurred.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LargestGradient {
    /// The largest absolute value in the gradient, loss per unit of the tensor.
    pub magnitude: f64,
    /// The phase in which it occurred.
    pub phase: String,
    /// The step within that phase.
    pub iteration: u64,
}

/// Everything about a model that is not a tensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelHeader {
    /// The method's name, e.g. `deformable4dgs`.
    pub method: String,
    /// The canonical training parameters, defaults filled in.
    pub method_params: serde_json::Value,
    /// The protocol of the training images.
    pub protocol: Protocol,
    /// The colour behind the Gaussians, in [0, 1].
    pub background: [f32; 3],
    /// Maps seconds of the capture to the normalised time in [0, 1] of the motion model.
    pub time_map: TimeMap,
    /// The size of the scene ([`scene::SceneScale::extent`]), scene units.
    pub scene_extent: f64,
    /// Factor on published constants in scene units ([`scene::SceneScale::unit`]).
    pub unit_world: f64,
    /// Number of distinct times among the training views.
    pub time_count: usize,
    /// Spherical-harmonics degree at the end of the training.
    pub sh_degree: usize,
    /// Number of Gaussians in the model, including those that are invisible at some times. Anchor methods spawn their
    /// Gaussians for a view: those of the first training camera at time 0 count.
    pub n_gaussians: u64,
    /// Name and optimizer steps of every phase, in order.
    pub iterations: Vec<(String, u64)>,
    /// The seed of every random choice.
    pub seed: u64,
    /// The decision on every effect of the method: whether it was simulated, and the reason.
    pub effects: Vec<Decision>,
    /// The prompts that the method was trained with, in the order of their embeddings; empty for methods without
    /// prompts.
    pub prompts: Vec<String>,
}

/// A row-major f32 tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedTensor {
    /// Sizes, outermost first.
    pub shape: Vec<usize>,
    /// The values in row-major order.
    pub values: Vec<f32>,
}

impl Model {
    /// Writes both files into `dir`; equal models give equal bytes.
    pub fn save(&self, dir: &Path) -> anyhow::Result<()> {
        let header = serde_json::to_string_pretty(&self.header)? + "\n";
        std::fs::write(dir.join(HEADER), header)
            .with_context(|| format!("cannot write {}", dir.join(HEADER).display()))?;
        save_tensors(&self.tensors, &dir.join(TENSORS))
    }

    /// The model's size in result tables: the bytes of all tensor values on disk.
    pub fn size_bytes(&self) -> u64 {
        self.tensors.values().map(|tensor| 4 * tensor.values.len() as u64).sum()
    }
}

impl engine::Artifact for Model {
    const NAME: &'static str = "model";
    const SCHEMA: u32 = 4;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        let path = dir.join(HEADER);
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let header = serde_json::from_str(&text).with_context(|| format!("not a model header: {}", path.display()))?;
        Ok(Self { header, tensors: load_tensors(&dir.join(TENSORS))? })
    }

    fn check(&self) -> anyhow::Result<()> {
        ensure!(!self.tensors.is_empty(), "model without tensors");
        ensure!(self.header.scene_extent.is_finite() && self.header.scene_extent > 0.0, "scene extent is not positive");
        ensure!(
            self.header.unit_world.is_finite() && self.header.unit_world > 0.0,
            "the unit of length is not positive"
        );
        ensure!(self.header.background.iter().all(|value| (0.0..=1.0).contains(value)), "background is not a colour");
        self.header.time_map.check()?;
        for (name, tensor) in &self.tensors {
            let count: usize = tensor.shape.iter().product();
            ensure!(
                count == tensor.values.len(),
                "{name} has {} values for shape {:?}",
                tensor.values.len(),
                tensor.shape
            );
            if let Some(at) = tensor.values.iter().position(|value| !value.is_finite()) {
                bail!("{name}[{at}] is {}", tensor.values[at]);
            }
        }
        Ok(())
    }
}

/// Writes named f32 tensors as one safetensors file.
fn save_tensors(tensors: &BTreeMap<String, NamedTensor>, path: &Path) -> anyhow::Result<()> {
    let bytes = write_tensors(tensors, None)?;
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Reads named f32 tensors from one safetensors file.
fn load_tensors(path: &Path) -> anyhow::Result<BTreeMap<String, NamedTensor>> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    read_tensors(&bytes).with_context(|| format!("cannot use {}", path.display()))
}

/// The bytes of a safetensors file, with at most one metadata entry (more would have no fixed order).
pub(crate) fn write_tensors(
    tensors: &BTreeMap<String, NamedTensor>,
    metadata: Option<(&str, String)>,
) -> anyhow::Result<Vec<u8>> {
    let mut views = Vec::with_capacity(tensors.len());
    for (name, tensor) in tensors {
        let bytes = bytemuck::cast_slice(&tensor.values);
        views.push((name, TensorView::new(Dtype::F32, tensor.shape.clone(), bytes)?));
    }
    Ok(safetensors::serialize(views, metadata.map(|(key, value)| [(key.to_string(), value)].into()))?)
}

/// The named f32 tensors of a safetensors file.
pub(crate) fn read_tensors(bytes: &[u8]) -> anyhow::Result<BTreeMap<String, NamedTensor>> {
    let file = SafeTensors::deserialize(bytes)?;
    let read = |(name, view): (String, TensorView<'_>)| {
        ensure!(view.dtype() == Dtype::F32, "{name} is {:?} instead of f32", view.dtype());
        let values = bytemuck::pod_collect_to_vec(view.data());
        Ok((name, NamedTensor { shape: view.shape().to_vec(), values }))
    };
    file.tensors().into_iter().map(read).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use engine::Artifact as _;

    use super::*;

    pub(crate) fn tiny_model() -> Model {
        let protocol = Protocol {
            dataset: "synthetic".into(),
            split: "official".into(),
            width: 8,
            height: 8,
            resize: "analytic".into(),
            background: "white".into(),
            time: "analytic".into(),
        };
        let header = ModelHeader {
            method: "static3dgs".into(),
            method_params: serde_json::json!({ "seed": 0 }),
            protocol,
            background: [1.0; 3],
            time_map: TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.1 },
            scene_extent: 1.5,
            unit_world: 1.0,
            time_count: 3,
            sh_degree: 0,
            n_gaussians: 2,
            iterations: vec![("train".into(), 10)],
            seed: 0,
            effects: Vec::new(),
            prompts: Vec::new(),
        };
        let values = (0..6).map(|i| i as f32 * 0.1).collect();
        let tensors = [("gaussians.positions".to_string(), NamedTensor { shape: vec![2, 3], values })].into();
        Model { header, tensors }
    }

    #[test]
    fn saved_model_reads_back_equal_and_bytes_are_stable() {
        let model = tiny_model();
        let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        model.save(first.path()).unwrap();
        model.save(second.path()).unwrap();
        assert_eq!(Model::open(first.path()).unwrap(), model);
        for file in [HEADER, TENSORS] {
            let read = |dir: &tempfile::TempDir| std::fs::read(dir.path().join(file)).unwrap();
            assert_eq!(read(&first), read(&second));
        }
    }

    #[test]
    fn values_that_are_not_finite_and_wrong_counts_are_refused() {
        let mut model = tiny_model();
        model.check().unwrap();
        model.tensors.get_mut("gaussians.positions").unwrap().values[4] = f32::NAN;
        assert!(model.check().unwrap_err().to_string().contains("gaussians.positions[4]"));
        let mut short = tiny_model();
        short.tensors.get_mut("gaussians.positions").unwrap().values.pop();
        assert!(short.check().is_err());
    }

    #[test]
    fn truncated_files_are_errors() {
        let dir = tempfile::tempdir().unwrap();
        tiny_model().save(dir.path()).unwrap();
        for file in [HEADER, TENSORS] {
            let bytes = std::fs::read(dir.path().join(file)).unwrap();
            for keep in [0, 1, 7, bytes.len() / 2, bytes.len() - 2] {
                std::fs::write(dir.path().join(file), &bytes[..keep]).unwrap();
                assert!(Model::open(dir.path()).is_err(), "{file} cut to {keep} bytes was read");
            }
            std::fs::write(dir.path().join(file), &bytes).unwrap();
        }
    }
}
