//! Features of an estimator: `clip/<view>.npy` [rows, columns, F], `text.npy` [P, F], and `prompts.txt` with one prompt
//! per line. Each array may also be a safetensors file with one f32 tensor.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{Capture, Split, View, npy_file};

use crate::artifact::{TokenGrid, check_vectors};
use crate::tensor_file;

/// Name of the folder of visual tokens.
const VISUAL: &str = "clip";
/// Extensions of arrays, in order of preference.
const EXTENSIONS: [&str; 2] = ["npy", "safetensors"];

/// The feature files of one capture.
pub(crate) struct FeatureFiles {
    /// The P prompts.
    pub(crate) prompts: Vec<String>,
    /// [P, F] text embeddings.
    pub(crate) text: Vec<f32>,
    /// Dimension F.
    pub(crate) dimension: usize,
    /// Folder of visual tokens.
    visual: PathBuf,
    /// Whether every frame number identifies one view.
    by_number: bool,
}

impl FeatureFiles {
    /// Reads prompts and text embeddings.
    pub(crate) fn open(folder: &Path, capture: &Capture) -> anyhow::Result<Self> {
        let visual = folder.join(VISUAL);
        if !visual.is_dir() {
            let hint = "check --data-root and the recipe's folder";
            return Err(Failure::new(FailureKind::MissingData, "no such folder of visual tokens")
                .hint(hint)
                .at(visual)
                .into());
        }
        let prompts = read_prompts(&folder.join("prompts.txt"))?;
        let path = array_path(&folder.join("text"))
            .ok_or_else(|| Failure::new(FailureKind::MissingData, "no text embeddings").at(folder.join("text.npy")))?;
        let (shape, text) = read_array(&path)?;
        let [rows, dimension] = *shape.as_slice() else { return Err(wrong_shape(&shape, "[prompts, F]", &path)) };
        if rows != prompts.len() {
            let message = format!("{rows} text embeddings for {} prompts", prompts.len());
            return Err(Failure::new(FailureKind::BadInput, message)
                .hint("prompts.txt must have one prompt per line")
                .at(path)
                .into());
        }
        check_vectors(&text, dimension, &path)?;
        let numbers: BTreeSet<u32> = capture.views.iter().map(|view| view.frame_index).collect();
        Ok(Self { prompts, text, dimension, visual, by_number: numbers.len() == capture.views.len() })
    }

    /// Reads the tokens of a view from a file with its name or, if every frame number identifies one view, with the
    /// frame number in five digits. Training views must have tokens; held-out views may lack them.
    pub(crate) fn tokens(&self, view: &View) -> anyhow::Result<Option<TokenGrid>> {
        let named = array_path(&self.visual.join(&view.name));
        let numbered = || array_path(&self.visual.join(format!("{:05}", view.frame_index)));
        let path = named.or_else(|| if self.by_number { numbered() } else { None });
        let Some(path) = path else {
            if view.split != Split::Train {
                return Ok(None);
            }
            let message = format!("training view {} has no tokens", view.name);
            let path = self.visual.join(format!("{}.npy", view.name));
            return Err(Failure::new(FailureKind::MissingData, message).at(path).into());
        };
        let (shape, values) = read_array(&path)?;
        let [rows, columns, dimension] = *shape.as_slice() else {
            return Err(wrong_shape(&shape, "[rows, columns, F]", &path));
        };
        if dimension != self.dimension {
            let message =
                format!("the tokens have dimension {dimension}, but the text embeddings have {}", self.dimension);
            let hint = "tokens and text must come from the same estimator";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into());
        }
        check_vectors(&values, dimension, &path)?;
        Ok(Some(TokenGrid { rows, columns, values }))
    }
}

/// Reads the lines of a file, none of which may be empty.
fn read_prompts(path: &Path) -> anyhow::Result<Vec<String>> {
    let text = std::fs::read_to_string(path).map_err(|error| {
        let hint = "the file must have one prompt per line, in the order of the text embeddings";
        Failure::new(FailureKind::MissingData, format!("cannot read the prompts ({error})")).hint(hint).at(path)
    })?;
    let prompts: Vec<String> = text.lines().map(|line| line.trim().to_owned()).collect();
    match prompts.iter().position(String::is_empty) {
        None if !prompts.is_empty() => Ok(prompts),
        at => {
            let message = at.map_or("no prompts".into(), |at| format!("line {} is empty", at + 1));
            Err(Failure::new(FailureKind::BadInput, message).at(path).into())
        }
    }
}

/// Finds the file of an array from its path without extension.
fn array_path(stem: &Path) -> Option<PathBuf> {
    // Names may contain dots, which `with_extension` would cut.
    let with = |extension| PathBuf::from(format!("{}.{extension}", stem.display()));
    EXTENSIONS.into_iter().map(with).find(|path| path.is_file())
}

/// Reads shape and values of an array, which must not be empty.
fn read_array(path: &Path) -> anyhow::Result<(Vec<usize>, Vec<f32>)> {
    let (shape, values) = if path.extension().is_some_and(|extension| extension == "safetensors") {
        tensor_file::read(path)?
    } else {
        let array = npy_file::read(path)?;
        (array.shape, array.values.into_iter().map(|value| value as f32).collect())
    };
    if values.is_empty() { Err(wrong_shape(&shape, "values", path)) } else { Ok((shape, values)) }
}

/// The failure for an array of another shape.
fn wrong_shape(shape: &[usize], expected: &str, path: &Path) -> anyhow::Error {
    Failure::new(FailureKind::BadInput, format!("shape {shape:?} instead of {expected}")).at(path).into()
}
