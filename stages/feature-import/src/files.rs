//! Features of an estimator: visual tokens in `clip/` or `dino/`, one file per view, and prompts with their embeddings, if
//! the estimator has any. Each array may also be a safetensors file with one f32 tensor.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{Capture, Split, View};

use crate::array_file::{array_path, read_array, wrong_shape};
use crate::artifact::{TokenGrid, check_vectors};
use crate::layouts::{tokens_of, tokens_of_segments};
use crate::text::TextEmbeddings;

/// Names of the folder of visual tokens.
const VISUAL: [&str; 2] = ["clip", "dino"];
/// Tokens along the longer side of an image that is given as segments.
const GRID: usize = 32;

/// The feature files of one capture.
pub(crate) struct FeatureFiles {
    /// Prompts and their embeddings, if there are any.
    pub(crate) text: Option<TextEmbeddings>,
    /// Folder of visual tokens.
    visual: PathBuf,
    /// Whether every frame number identifies one view.
    by_number: bool,
}

impl FeatureFiles {
    /// Reads prompts and text embeddings.
    pub(crate) fn open(folder: &Path, capture: &Capture) -> anyhow::Result<Self> {
        let Some(visual) = VISUAL.iter().map(|name| folder.join(name)).find(|visual| visual.is_dir()) else {
            let failure = Failure::new(FailureKind::MissingData, "no such folder of visual tokens");
            let hint = "check --data-root and the recipe's folder; tokens without text belong into dino/";
            return Err(failure.hint(hint).at(folder.join(VISUAL[0])).into());
        };
        let text = TextEmbeddings::find(folder)?;
        let numbers: BTreeSet<u32> = capture.views.iter().map(|view| view.frame_index).collect();
        Ok(Self { text, visual, by_number: numbers.len() == capture.views.len() })
    }

    /// Reads the tokens of a view, and their dimension, from a file with its name or, if every frame number identifies one
    /// view, with the frame number in five digits. Training views must have tokens; held-out views may lack them.
    pub(crate) fn tokens(&self, view: &View) -> anyhow::Result<Option<(TokenGrid, usize)>> {
        let numbered = self.by_number.then(|| format!("{:05}", view.frame_index));
        for name in [&view.name].into_iter().chain(&numbered) {
            if let Some(path) = array_path(&self.visual.join(name)) {
                return self.read_tokens(view, &path).map(Some);
            }
            let [features, segments] = ["f", "s"].map(|part| array_path(&self.visual.join(format!("{name}_{part}"))));
            if let (Some(features), Some(segments)) = (features, segments) {
                return self.read_segments(&features, &segments).map(Some);
            }
        }
        if view.split != Split::Train {
            return Ok(None);
        }
        let message = format!("training view {} has no tokens", view.name);
        let path = self.visual.join(format!("{}.npy", view.name));
        Err(Failure::new(FailureKind::MissingData, message).at(path).into())
    }

    fn read_tokens(&self, view: &View, path: &Path) -> anyhow::Result<(TokenGrid, usize)> {
        let (shape, values) = read_array(path)?;
        let size = [view.camera.intrinsics.width, view.camera.intrinsics.height];
        let (tokens, dimension) = tokens_of(&shape, values, self.text_dimension(), size, path)?;
        self.checked(tokens, dimension, path)
    }

    fn read_segments(&self, features: &Path, segments: &Path) -> anyhow::Result<(TokenGrid, usize)> {
        let ((feature_shape, values), (shape, indices)) = (read_array(features)?, read_array(segments)?);
        let [_, dimension] = *feature_shape else { return Err(wrong_shape(&feature_shape, "[segments, F]", features)) };
        let tokens = tokens_of_segments((&shape, &indices), &values, dimension, GRID)
            .ok_or_else(|| wrong_shape(&shape, "[levels, H, W]", segments))?;
        self.checked(tokens, dimension, features)
    }

    fn checked(&self, tokens: TokenGrid, dimension: usize, path: &Path) -> anyhow::Result<(TokenGrid, usize)> {
        if let Some(text) = self.text_dimension().filter(|text| *text != dimension) {
            let message = format!("the tokens have dimension {dimension}, but the text embeddings have {text}");
            let hint = "tokens and text must come from the same estimator, projected to its common space";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into());
        }
        check_vectors(&tokens.values, dimension, path)?;
        Ok((tokens, dimension))
    }

    fn text_dimension(&self) -> Option<usize> {
        self.text.as_ref().map(|text| text.dimension)
    }
}
