//! Checkpoints: everything that the next step depends on, written atomically, two generations.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

use anyhow::{Context as _, ensure};
use rand_chacha::ChaCha8Rng;
use safetensors::tensor::SafeTensors;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::artifact::{NamedTensor, read_tensors, write_tensors};
use crate::clock::ClockReading;
use crate::curve::CurvePoint;
use crate::sampler::ViewSampler;

/// The newest checkpoint.
const LATEST: &str = "latest.ckpt";
/// The one before, in case the newest is damaged.
const PREVIOUS: &str = "previous.ckpt";
/// Bytes of the hash at the end of the file.
const HASH_BYTES: usize = 32;
/// The metadata entry of the tensor file that holds [`Progress`].
const PROGRESS: &str = "progress";

/// A training between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Everything but tensors.
    pub progress: Progress,
    /// Values and moments by name.
    pub tensors: BTreeMap<String, NamedTensor>,
}

/// The part of a checkpoint that is not tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// The canonical parameters, so that no other training's checkpoint is taken.
    pub params: serde_json::Value,
    /// Index of the running phase.
    pub phase: usize,
    /// Steps done in it.
    pub iteration: u64,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// Which views come next.
    pub sampler: ViewSampler,
    /// Draws of density control.
    pub density_random: ChaCha8Rng,
    /// Draws of the method.
    pub method_random: ChaCha8Rng,
    /// Statistics of every population control.
    pub controls: Vec<serde_json::Value>,
    /// Steps that the optimiser has taken per tensor.
    pub optimizer_steps: BTreeMap<String, u64>,
    /// Seconds so far.
    pub clock: ClockReading,
    /// The curve so far.
    pub curve: Vec<CurvePoint>,
    /// The loss of the last step.
    pub loss: f64,
    /// Weighted values summed over steps, by loss.
    pub loss_sums: BTreeMap<String, f64>,
}

impl Checkpoint {
    /// Writes the newest generation; the one before it is kept. A crash at any moment leaves a readable one.
    pub fn save(&self, dir: &Path) -> anyhow::Result<()> {
        let bytes = self.to_bytes()?;
        let write = || -> std::io::Result<()> {
            let mut file = tempfile::NamedTempFile::new_in(dir)?;
            file.write_all(&bytes)?;
            file.as_file().sync_all()?;
            if dir.join(LATEST).exists() {
                std::fs::rename(dir.join(LATEST), dir.join(PREVIOUS))?;
            }
            file.persist(dir.join(LATEST)).map_err(|error| error.error)?;
            std::fs::File::open(dir)?.sync_all()
        };
        write().with_context(|| format!("cannot write a checkpoint into {}", dir.display()))
    }

    /// The newest undamaged checkpoint of these parameters, if there is any; damaged ones are reported and passed over.
    pub fn load(dir: &Path, params: &serde_json::Value) -> Option<Self> {
        [LATEST, PREVIOUS].iter().map(|name| dir.join(name)).filter(|path| path.exists()).find_map(|path| {
            let read = std::fs::read(&path).map_err(anyhow::Error::from).and_then(|bytes| Self::from_bytes(&bytes));
            match read {
                Ok(checkpoint) if checkpoint.progress.params == *params => Some(checkpoint),
                Ok(_) => {
                    tracing::warn!("checkpoint of other parameters passed over: {}", path.display());
                    None
                }
                Err(error) => {
                    tracing::warn!("damaged checkpoint passed over: {error:#}: {}", path.display());
                    None
                }
            }
        })
    }

    fn to_bytes(&self) -> anyhow::Result<Vec<u8>> {
        let mut bytes = write_tensors(&self.tensors, Some((PROGRESS, serde_json::to_string(&self.progress)?)))?;
        let hash = Sha256::digest(&bytes);
        bytes.extend_from_slice(&hash);
        Ok(bytes)
    }

    fn from_bytes(bytes: &[u8]) -> anyhow::Result<Self> {
        ensure!(bytes.len() > HASH_BYTES, "the file is too short");
        let (bytes, hash) = bytes.split_at(bytes.len() - HASH_BYTES);
        ensure!(Sha256::digest(bytes).as_slice() == hash, "the hash does not agree");
        let (_, metadata) = SafeTensors::read_metadata(bytes)?;
        let progress = metadata.metadata().as_ref().and_then(|entries| entries.get(PROGRESS));
        let progress = serde_json::from_str(progress.context("no progress in the file")?)?;
        Ok(Self { progress, tensors: read_tensors(bytes)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Stream, generator};

    fn checkpoint(iteration: u64) -> Checkpoint {
        let progress = Progress {
            params: serde_json::json!({ "seed": 4 }),
            phase: 1,
            iteration,
            sh_degree: 2,
            sampler: ViewSampler::new(5, generator(4, Stream::Views)),
            density_random: generator(4, Stream::Density),
            method_random: generator(4, Stream::Method),
            controls: vec![serde_json::json!({ "seen_count": [1, 2] })],
            optimizer_steps: [("gaussians.positions".to_string(), 7)].into(),
            clock: ClockReading::default(),
            curve: Vec::new(),
            loss: 0.1 + 0.2,
            loss_sums: [("photometric".to_string(), 0.7)].into(),
        };
        let values = vec![0.1, -0.0, f32::MIN_POSITIVE / 8.0, 1e30];
        let tensors = [("value.gaussians.positions".to_string(), NamedTensor { shape: vec![4, 1], values })].into();
        Checkpoint { progress, tensors }
    }

    #[test]
    fn reads_back_bit_for_bit_and_keeps_two_generations() {
        let dir = tempfile::tempdir().unwrap();
        let params = serde_json::json!({ "seed": 4 });
        assert!(Checkpoint::load(dir.path(), &params).is_none());
        checkpoint(1).save(dir.path()).unwrap();
        checkpoint(2).save(dir.path()).unwrap();
        let read = Checkpoint::load(dir.path(), &params).unwrap();
        assert_eq!(read, checkpoint(2));
        let bits = |checkpoint: &Checkpoint| -> Vec<u32> {
            checkpoint.tensors.values().flat_map(|tensor| tensor.values.iter().map(|value| value.to_bits())).collect()
        };
        assert_eq!(bits(&read), bits(&checkpoint(2)));
        assert!(Checkpoint::load(dir.path(), &serde_json::json!({ "seed": 5 })).is_none());
    }

    #[test]
    fn a_damaged_newest_generation_falls_back_to_the_one_before() {
        let dir = tempfile::tempdir().unwrap();
        let params = serde_json::json!({ "seed": 4 });
        checkpoint(1).save(dir.path()).unwrap();
        checkpoint(2).save(dir.path()).unwrap();
        let whole = std::fs::read(dir.path().join(LATEST)).unwrap();
        for cut in [0, 10, whole.len() / 2, whole.len() - 1] {
            std::fs::write(dir.path().join(LATEST), &whole[..cut]).unwrap();
            assert_eq!(Checkpoint::load(dir.path(), &params).unwrap(), checkpoint(1), "cut to {cut} bytes");
        }
        let mut flipped = whole.clone();
        flipped[whole.len() / 2] ^= 1;
        std::fs::write(dir.path().join(LATEST), &flipped).unwrap();
        assert_eq!(Checkpoint::load(dir.path(), &params).unwrap(), checkpoint(1));
        std::fs::write(dir.path().join(PREVIOUS), b"").unwrap();
        assert!(Checkpoint::load(dir.path(), &params).is_none());
    }
}
