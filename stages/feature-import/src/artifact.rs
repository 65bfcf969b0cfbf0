//! The artifact: visual tokens of views and text embeddings of prompts.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use scene::index_file;
use scene::{Capture, FloatImage};
use serde::{Deserialize, Serialize};

use crate::tensor_file;

/// Name of the index file.
const INDEX_FILE: &str = "features.json";
/// What the index describes, for error messages.
const WHAT: &str = "features";
/// Name of the file of text embeddings.
const TEXT: &str = "text.safetensors";
/// Name of the folder of visual tokens, with one file per view.
const VISUAL: &str = "visual";

/// Language features of a capture: the index `features.json` (this structure), text embeddings `text.safetensors` [P,
/// F] if there are prompts, and visual tokens `visual/<view>.safetensors` [rows, columns, F]. Both are in one embedding
/// space, in which the cosine similarity of a token and a prompt grows with the share of the image patch that shows the
/// prompt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Features {
    /// The folder of the artifact; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// Origin of tokens and embeddings: `labels` or `files`.
    pub source: String,
    /// Dimension F of the embedding space.
    pub dimension: usize,
    /// The P prompts, one per row of the text embeddings; none for an estimator without text, e.g. DINOv2.
    pub prompts: Vec<String>,
    /// One entry per view of the capture, in its order.
    pub views: Vec<TokenView>,
}

/// The index entry of one view.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenView {
    /// Name of the view.
    pub name: String,
    /// Rows and columns of the token grid; `None` for a view without tokens.
    pub grid: Option<[usize; 2]>,
}

/// Visual tokens on a regular grid over the whole image.
#[derive(Clone, Debug, PartialEq)]
pub struct TokenGrid {
    /// Number of rows, from top to bottom.
    pub rows: usize,
    /// Number of columns, from left to right.
    pub columns: usize,
    /// [rows, columns, F] values.
    pub values: Vec<f32>,
}

impl TokenGrid {
    /// The tokens as an image with one pixel per cell.
    pub(crate) fn into_map(self) -> FloatImage {
        let [width, height] = [self.columns, self.rows].map(|side| side as u32);
        let channels = self.values.len() / (self.columns * self.rows).max(1);
        FloatImage { width, height, channels, values: self.values }
    }
}

impl Features {
    /// Reads the tokens of the view at `index` within the views of the capture, if it has any.
    pub fn load_tokens(&self, index: usize) -> anyhow::Result<Option<TokenGrid>> {
        let TokenView { name, grid } = &self.views[index];
        let Some([rows, columns]) = *grid else { return Ok(None) };
        let path = self.tokens_path(name);
        let values = load(&path, &[rows, columns, self.dimension])?;
        Ok(Some(TokenGrid { rows, columns, values }))
    }

    /// Reads the [P, F] text embeddings, one row per prompt; empty without prompts.
    pub fn load_text(&self) -> anyhow::Result<Vec<f32>> {
        if self.prompts.is_empty() {
            return Ok(Vec::new());
        }
        load(&self.dir.join(TEXT), &[self.prompts.len(), self.dimension])
    }

    /// Checks that these features belong to `capture`: the same views, in the same order.
    pub fn check_against(&self, capture: &Capture) -> scene::Result<()> {
        capture.check_names(self.views.iter().map(|view| view.name.as_str())).map_err(|error| error.at(&self.dir))
    }

    /// Writes the tokens of one view.
    pub(crate) fn write_tokens(&self, name: &str, tokens: &TokenGrid) -> anyhow::Result<()> {
        let path = self.tokens_path(name);
        tensor_file::write(&path, "tokens", &[tokens.rows, tokens.columns, self.dimension], &tokens.values)
    }

    /// Writes the text embeddings and the index, after all tokens.
    pub(crate) fn finish(&self, text: Option<&[f32]>) -> anyhow::Result<()> {
        if let Some(text) = text {
            tensor_file::write(&self.dir.join(TEXT), "text", &[self.prompts.len(), self.dimension], text)?;
        }
        Ok(index_file::write(&self.dir.join(INDEX_FILE), WHAT, self)?)
    }

    /// Creates the folder of tokens.
    pub(crate) fn create_folders(&self) -> anyhow::Result<()> {
        Ok(index_file::create_dir(&self.dir.join(VISUAL))?)
    }

    /// The path of the tokens of a view.
    fn tokens_path(&self, name: &str) -> PathBuf {
        self.dir.join(VISUAL).join(format!("{name}.safetensors"))
    }
}

impl engine::Artifact for Features {
    const NAME: &'static str = "features";
    const SCHEMA: u32 = 1;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        Ok(Self { dir: dir.into(), ..index_file::read(&dir.join(INDEX_FILE), WHAT)? })
    }

    /// Checks for one embedding per prompt, if there are prompts, at least one view with tokens, and files of the stated shapes
    /// with finite, nonzero vectors.
    fn check(&self) -> anyhow::Result<()> {
        if let Some(at) = self.prompts.iter().position(|prompt| prompt.trim().is_empty()) {
            anyhow::bail!("prompt {at} is empty");
        }
        ensure!(self.dimension > 0, "the features have dimension 0");
        ensure!(self.views.iter().any(|view| view.grid.is_some()), "no view has tokens");
        check_vectors(&self.load_text()?, self.dimension, &self.dir.join(TEXT))?;
        for (index, view) in self.views.iter().enumerate() {
            if let Some(tokens) = self.load_tokens(index)? {
                check_vectors(&tokens.values, self.dimension, &self.tokens_path(&view.name))?;
            }
        }
        Ok(())
    }
}

/// Fails on vectors that are zero or not finite.
pub(crate) fn check_vectors(values: &[f32], dimension: usize, path: &Path) -> anyhow::Result<()> {
    for (index, vector) in values.chunks_exact(dimension).enumerate() {
        let squared_norm: f64 = vector.iter().map(|value| f64::from(*value).powi(2)).sum();
        ensure!(squared_norm.is_finite(), "vector {index} is not finite: {}", path.display());
        ensure!(squared_norm > 0.0, "vector {index} is zero: {}", path.display());
    }
    Ok(())
}

/// Reads a tensor file, which must have the given shape.
fn load(path: &Path, shape: &[usize]) -> anyhow::Result<Vec<f32>> {
    let (found, values) = tensor_file::read(path)?;
    ensure!(found == shape, "shape {found:?} instead of {shape:?}: {}", path.display());
    Ok(values)
}
