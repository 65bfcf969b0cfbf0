//! The artifact: visual tokens of views and text embeddings of prompts.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use scene::Capture;
use scene::index_file;
use serde::{Deserialize, Serialize};

use crate::tensor_file;

/// The file that describes the features.
const INDEX_FILE: &str = "features.json";
/// What the index describes, for errors.
const WHAT: &str = "features";
/// The text embeddings' file name.
const TEXT: &str = "text.safetensors";
/// The folder of the visual tokens, a file per view.
const VISUAL: &str = "visual";

/// What a capture shows in words: `features.json` (this structure), `text.safetensors` [P, F] and
/// `visual/<view>.safetensors` [rows, columns, F]. Tokens and embeddings live in one space: the more a patch shows of what
/// a prompt says, the larger the cosine between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Features {
    /// The folder; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// Who computed tokens and embeddings: `labels` or `files`.
    pub source: String,
    /// F.
    pub dimension: usize,
    /// P of them, one per row of the text embeddings.
    pub prompts: Vec<String>,
    /// By index within the capture's views.
    pub views: Vec<TokenView>,
}

/// The tokens of one view.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenView {
    /// The view's name in the capture.
    pub name: String,
    /// Rows and columns of its grid; `None` for views without tokens.
    pub grid: Option<[usize; 2]>,
}

/// Tokens on a grid that covers the whole image evenly.
#[derive(Clone, Debug, PartialEq)]
pub struct TokenGrid {
    /// From top to bottom.
    pub rows: usize,
    /// From left to right.
    pub columns: usize,
    /// [rows, columns, F].
    pub values: Vec<f32>,
}

impl Features {
    /// The tokens of the view at `index` within the capture's views, where it has any.
    pub fn load_tokens(&self, index: usize) -> anyhow::Result<Option<TokenGrid>> {
        let TokenView { name, grid } = &self.views[index];
        let Some([rows, columns]) = *grid else { return Ok(None) };
        let path = self.tokens_path(name);
        let values = load(&path, &[rows, columns, self.dimension])?;
        Ok(Some(TokenGrid { rows, columns, values }))
    }

    /// [P, F], one row per prompt.
    pub fn load_text(&self) -> anyhow::Result<Vec<f32>> {
        load(&self.dir.join(TEXT), &[self.prompts.len(), self.dimension])
    }

    /// Whether these features were made for `capture`: the same views, in the same order.
    pub fn check_against(&self, capture: &Capture) -> scene::Result<()> {
        capture.check_names(self.views.iter().map(|view| view.name.as_str())).map_err(|error| error.at(&self.dir))
    }

    /// Writes the tokens of one view of these features.
    pub(crate) fn write_tokens(&self, name: &str, tokens: &TokenGrid) -> anyhow::Result<()> {
        let path = self.tokens_path(name);
        tensor_file::write(&path, "tokens", &[tokens.rows, tokens.columns, self.dimension], &tokens.values)
    }

    /// Writes header and text embeddings, after all tokens.
    pub(crate) fn finish(&self, text: &[f32]) -> anyhow::Result<()> {
        tensor_file::write(&self.dir.join(TEXT), "text", &[self.prompts.len(), self.dimension], text)?;
        Ok(index_file::write(&self.dir.join(INDEX_FILE), WHAT, self)?)
    }

    /// Makes the folder that tokens are written into.
    pub(crate) fn create_folders(&self) -> anyhow::Result<()> {
        Ok(index_file::create_dir(&self.dir.join(VISUAL))?)
    }

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

    /// One embedding per prompt, at least one view with tokens, and files of the stated shapes whose vectors are finite
    /// and have a direction.
    fn check(&self) -> anyhow::Result<()> {
        ensure!(!self.prompts.is_empty(), "features without prompts");
        if let Some(at) = self.prompts.iter().position(|prompt| prompt.trim().is_empty()) {
            anyhow::bail!("prompt {at} is empty");
        }
        ensure!(self.dimension > 0, "features of length 0");
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

/// Refuses vectors that are not finite or have no direction.
pub(crate) fn check_vectors(values: &[f32], dimension: usize, path: &Path) -> anyhow::Result<()> {
    for (index, vector) in values.chunks_exact(dimension).enumerate() {
        let squared_norm: f64 = vector.iter().map(|value| f64::from(*value).powi(2)).sum();
        ensure!(squared_norm.is_finite(), "vector {index} is not finite: {}", path.display());
        ensure!(squared_norm > 0.0, "vector {index} is zero and has no direction: {}", path.display());
    }
    Ok(())
}

/// The values of a tensor file that must have this shape.
fn load(path: &Path, shape: &[usize]) -> anyhow::Result<Vec<f32>> {
    let (found, values) = tensor_file::read(path)?;
    ensure!(found == shape, "shape {found:?} where {shape:?} is expected: {}", path.display());
    Ok(values)
}
