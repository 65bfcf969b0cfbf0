//! Checkpoint files: the state of a training and its measurements, hashed, written atomically, in two generations.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

use anyhow::{Context as _, ensure};
use safetensors::tensor::SafeTensors;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::telemetry::History;
use super::train_state::SavedState;
use crate::artifact::{NamedTensor, read_tensors, write_tensors};
use crate::clock::ClockReading;

/// File name of the newest checkpoint.
const LATEST: &str = "latest.ckpt";
/// File name of the checkpoint before it, the fallback if the newest one is damaged.
const PREVIOUS: &str = "previous.ckpt";
/// Bytes of the hash at the end of the file.
const HASH_BYTES: usize = 32;
/// The metadata entry of the tensor file that holds [`Progress`].
const PROGRESS: &str = "progress";

/// A training between two steps, as stored in a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Checkpoint {
    /// Everything but tensors.
    pub(super) progress: Progress,
    /// Values and moments of the model's tensors by name.
    pub(crate) tensors: BTreeMap<String, NamedTensor>,
}

/// The part of a checkpoint that is not tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Progress {
    /// The canonical parameters: a checkpoint of other parameters is ignored.
    pub params: serde_json::Value,
    /// The state of the training.
    pub state: SavedState,
    /// Its measurements so far.
    pub history: History,
    /// Seconds by phase and activity so far.
    pub clock: ClockReading,
}

impl Checkpoint {
    /// Writes the newest generation and keeps the previous one. A crash at any moment leaves a readable file.
    pub(crate) fn save(&self, dir: &Path) -> anyhow::Result<()> {
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

    /// The newest intact checkpoint of these parameters, if there is one. Damaged ones are skipped with a warning.
    pub(crate) fn load(dir: &Path, params: &serde_json::Value) -> Option<Self> {
        [LATEST, PREVIOUS].iter().map(|name| dir.join(name)).filter(|path| path.exists()).find_map(|path| {
            let read = std::fs::read(&path).map_err(anyhow::Error::from).and_then(|bytes| Self::from_bytes(&bytes));
            match read {
                Ok(checkpoint) if checkpoint.progress.params == *params => Some(checkpoint),
                Ok(_) => {
                    tracing::warn!("ignoring a checkpoint of other parameters: {}", path.display());
                    None
                }
                Err(error) => {
                    tracing::warn!("ignoring a damaged checkpoint: {error:#}: {}", path.display());
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
        ensure!(Sha256::digest(bytes).as_slice() == hash, "the hash does not match");
        let (_, metadata) = SafeTensors::read_metadata(bytes)?;
        let progress = metadata.metadata().as_ref().and_then(|entries| entries.get(PROGRESS));
        let progress = serde_json::from_str(progress.context("no progress in the file")?)?;
        Ok(Self { progress, tensors: read_tensors(bytes)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Streams, ViewSampler};
    use crate::method::LossUnits;

    fn checkpoint(iteration: u64) -> Checkpoint {
        let state = SavedState {
            phase: 1,
            iteration,
            sh_degree: 2,
            optimizer_steps: [("gaussians.positions".to_string(), 7)].into(),
            hooks: vec![serde_json::json!({ "seen_count": [1, 2] })],
            sampler: ViewSampler::new(5, Streams::new(4).views("fine")),
            units: LossUnits::ones(["static_depth"]),
        };
        let history =
            History { loss: 0.1 + 0.2, loss_sums: [("photometric".to_string(), 0.7)].into(), ..History::default() };
        let params = serde_json::json!({ "seed": 4 });
        let progress = Progress { params, state, history, clock: ClockReading::default() };
        let values = vec![0.1, -0.0, f32::MIN_POSITIVE / 8.0, 1e30];
        let tensors = [("value.gaussians.positions".to_string(), NamedTensor { shape: vec![4, 1], values })].into();
        Checkpoint { progress, tensors }
    }

    #[test]
    fn checkpoints_survive_a_round_trip_bit_for_bit() {
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
    fn a_damaged_checkpoint_falls_back_to_the_previous_one() {
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
