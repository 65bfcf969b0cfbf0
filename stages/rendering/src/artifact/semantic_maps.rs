//! The file of rendered semantics: semantic features and the relevancy of prompts, per pixel.

use std::path::Path;

use anyhow::{Context as _, ensure};
use scene::exr_file::{self, ExrImage};

/// The semantics of one render. Everything but `alpha` is 0 where no Gaussian covers the pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SemanticMaps {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// [H, W] coverage in [0, 1].
    pub alpha: Vec<f32>,
    /// C planes [H, W]: mean semantic features of the visible Gaussians, with the blending weights of the colours.
    pub features: Vec<Vec<f32>>,
    /// P planes [H, W] in [0, 1]: relevancy of each prompt relative to the other prompts; above one half for at most one
    /// prompt. Empty if the model cannot decode its features into prompts.
    pub relevancy: Vec<Vec<f32>>,
}

/// Channel of the coverage.
const ALPHA: &str = "A";
/// Prefix of feature channels; a three-digit index follows.
const FEATURE: &str = "feature.";
/// Prefix of relevancy channels; a three-digit index follows.
const PROMPT: &str = "prompt.";

impl SemanticMaps {
    /// Minimum coverage of a pixel whose semantics are meaningful.
    pub const COVERED: f32 = 0.5;
    /// Relevancy above which a prompt selects a pixel; it then exceeds that of every other prompt.
    pub const RELEVANT: f32 = 0.5;

    /// Reads a file of [`SemanticMaps::write`]. A missing channel or a non-finite value is an error.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let image = exr_file::read(path)?;
        let alpha =
            image.channel(&[ALPHA]).with_context(|| format!("no channel {ALPHA}: {}", path.display()))?.to_vec();
        let (features, relevancy) = (numbered(&image, FEATURE), numbered(&image, PROMPT));
        ensure!(!features.is_empty(), "no semantic features: {}", path.display());
        let finite = |plane: &Vec<f32>| plane.iter().all(|value| value.is_finite());
        let all_finite = finite(&alpha) && features.iter().chain(&relevancy).all(finite);
        ensure!(all_finite, "semantic features are not finite: {}", path.display());
        Ok(Self { width: image.width, height: image.height, alpha, features, relevancy })
    }

    /// Writes an EXR file with the channels `A`, `feature.000`, `feature.001`, …, `prompt.000`, `prompt.001`, …
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let named = |prefix: &str, planes: &[Vec<f32>]| -> Vec<(String, Vec<f32>)> {
            planes.iter().enumerate().map(|(at, plane)| (channel(prefix, at), plane.clone())).collect()
        };
        let planes = [(ALPHA.to_owned(), self.alpha.clone())].into_iter();
        let planes: Vec<_> =
            planes.chain(named(FEATURE, &self.features)).chain(named(PROMPT, &self.relevancy)).collect();
        let channels: Vec<(&str, Vec<f32>)> =
            planes.iter().map(|(name, plane)| (name.as_str(), plane.clone())).collect();
        Ok(exr_file::write(path, self.width, self.height, &channels)?)
    }
}

/// The planes whose channels have this prefix, in the order of their indices.
fn numbered(image: &ExrImage, prefix: &str) -> Vec<Vec<f32>> {
    (0..).map_while(|at| image.channel(&[&channel(prefix, at)]).map(<[f32]>::to_vec)).collect()
}

fn channel(prefix: &str, at: usize) -> String {
    format!("{prefix}{at:03}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_maps_read_back_equal_and_non_finite_values_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("maps.exr");
        let plane = |seed: usize| (0..6).map(|at| (seed + at) as f32 / 8.0).collect::<Vec<f32>>();
        let maps = SemanticMaps {
            width: 3,
            height: 2,
            alpha: plane(0),
            features: (0..12).map(plane).collect(),
            relevancy: vec![plane(3), plane(4)],
        };
        maps.write(&path).unwrap();
        assert_eq!(SemanticMaps::read(&path).unwrap(), maps);
        let without_prompts = SemanticMaps { relevancy: Vec::new(), ..maps.clone() };
        without_prompts.write(&path).unwrap();
        assert_eq!(SemanticMaps::read(&path).unwrap(), without_prompts);
        let mut poisoned = maps;
        poisoned.features[11][5] = f32::NAN;
        poisoned.write(&path).unwrap();
        assert!(SemanticMaps::read(&path).unwrap_err().to_string().contains("not finite"));
    }
}
