//! The file of what a render means: semantic features and the relevancy of prompts, per pixel.

use std::path::Path;

use anyhow::{Context as _, ensure};
use scene::exr_file::{self, ExrImage};

/// What a render means; everything but `alpha` is 0 where nothing is in sight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SemanticMaps {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// [H, W] coverage in [0, 1].
    pub alpha: Vec<f32>,
    /// C planes [H, W]: the mean semantic features of the Gaussians in sight, weighted as their colours are.
    pub features: Vec<Vec<f32>>,
    /// P planes [H, W] in [0, 1]: how much a pixel is what a prompt means rather than what another one means; above one
    /// half for at most one prompt. None where the model does not know what its features mean in words.
    pub relevancy: Vec<Vec<f32>>,
}

/// The channel of the coverage.
const ALPHA: &str = "A";
/// What the channels of features begin with; a number follows.
const FEATURE: &str = "feature.";
/// The same of relevancies.
const PROMPT: &str = "prompt.";

impl SemanticMaps {
    /// Coverage from which on a pixel shows something that can mean something.
    pub const COVERED: f32 = 0.5;
    /// Relevancy above which a prompt selects a pixel: more than any other prompt.
    pub const RELEVANT: f32 = 0.5;

    /// Reads what [`SemanticMaps::write`] wrote; values must be finite.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let image = exr_file::read(path)?;
        let alpha =
            image.channel(&[ALPHA]).with_context(|| format!("no channel {ALPHA}: {}", path.display()))?.to_vec();
        let (features, relevancy) = (numbered(&image, FEATURE), numbered(&image, PROMPT));
        ensure!(!features.is_empty(), "no semantic features: {}", path.display());
        let finite = |plane: &Vec<f32>| plane.iter().all(|value| value.is_finite());
        let all_finite = finite(&alpha) && features.iter().chain(&relevancy).all(finite);
        ensure!(all_finite, "semantic features that are not finite: {}", path.display());
        Ok(Self { width: image.width, height: image.height, alpha, features, relevancy })
    }

    /// Writes an EXR file with the channels A, feature.000 and so on, and prompt.000 and so on.
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

/// The planes whose channels begin so, in the order of their numbers.
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
    fn written_maps_read_back_equal_and_poisoned_ones_are_refused() {
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
        let mute = SemanticMaps { relevancy: Vec::new(), ..maps.clone() };
        mute.write(&path).unwrap();
        assert_eq!(SemanticMaps::read(&path).unwrap(), mute);
        let mut poisoned = maps;
        poisoned.features[11][5] = f32::NAN;
        poisoned.write(&path).unwrap();
        assert!(SemanticMaps::read(&path).unwrap_err().to_string().contains("not finite"));
    }
}
