//! Features that an estimator wrote: `clip/<view>.npy` [rows, columns, F], `text.npy` [P, F] and `prompts.txt`, one prompt
//! per line; each array may be a safetensors file with one f32 tensor instead.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{Capture, Split, View, npy_file};

use crate::artifact::{TokenGrid, check_vectors};
use crate::tensor_file;

/// The folder of the visual tokens.
const VISUAL: &str = "clip";
/// Extensions of arrays; the first that exists is read.
const EXTENSIONS: [&str; 2] = ["npy", "safetensors"];

/// The files of one capture.
pub struct FeatureFiles {
    /// P prompts.
    pub prompts: Vec<String>,
    /// [P, F].
    pub text: Vec<f32>,
    /// F.
    pub dimension: usize,
    visual: PathBuf,
    /// Whether a frame's number names one view.
    by_number: bool,
}

impl FeatureFiles {
    /// Reads prompts and text embeddings.
    pub fn open(folder: &Path, capture: &Capture) -> anyhow::Result<Self> {
        let visual = folder.join(VISUAL);
        if !visual.is_dir() {
            let hint = "is --data-root right, and are the features computed?";
            return Err(Failure::new(FailureKind::MissingData, "no folder of tokens").hint(hint).at(visual).into());
        }
        let prompts = read_prompts(&folder.join("prompts.txt"))?;
        let path = array_path(&folder.join("text"))
            .ok_or_else(|| Failure::new(FailureKind::MissingData, "no text embeddings").at(folder.join("text.npy")))?;
        let (shape, text) = read_array(&path)?;
        let [rows, dimension] = *shape.as_slice() else { return Err(wrong_shape(&shape, "[prompts, F]", &path)) };
        if rows != prompts.len() {
            let message = format!("{rows} text embeddings for {} prompts", prompts.len());
            return Err(Failure::new(FailureKind::BadInput, message)
                .hint("prompts.txt has one per line")
                .at(path)
                .into());
        }
        check_vectors(&text, dimension, &path)?;
        let numbers: BTreeSet<u32> = capture.views.iter().map(|view| view.frame_index).collect();
        Ok(Self { prompts, text, dimension, visual, by_number: numbers.len() == capture.views.len() })
    }

    /// The tokens of a view: under its name, or, where every view has a frame number of its own, under that number with
    /// five digits. Held-out views may lack tokens, training views may not.
    pub fn tokens(&self, view: &View) -> anyhow::Result<Option<TokenGrid>> {
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
            let message = format!("tokens of length {dimension} where the text embeddings have {}", self.dimension);
            let hint = "tokens and text must come from the same estimator";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into());
        }
        check_vectors(&values, dimension, &path)?;
        Ok(Some(TokenGrid { rows, columns, values }))
    }
}

/// The lines of a file, none of them empty.
fn read_prompts(path: &Path) -> anyhow::Result<Vec<String>> {
    let text = std::fs::read_to_string(path).map_err(|error| {
        let hint = "it holds one prompt per line, in the order of the text embeddings";
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

/// The file of an array, without its extension in `stem`.
fn array_path(stem: &Path) -> Option<PathBuf> {
    // Names may have dots of their own, so that `with_extension` would cut them.
    let with = |extension| PathBuf::from(format!("{}.{extension}", stem.display()));
    EXTENSIONS.into_iter().map(with).find(|path| path.is_file())
}

/// Shape and values of an array that is not empty.
fn read_array(path: &Path) -> anyhow::Result<(Vec<usize>, Vec<f32>)> {
    let (shape, values) = if path.extension().is_some_and(|extension| extension == "safetensors") {
        tensor_file::read(path)?
    } else {
        let array = npy_file::read(path)?;
        (array.shape, array.values.into_iter().map(|value| value as f32).collect())
    };
    if values.is_empty() { Err(wrong_shape(&shape, "values", path)) } else { Ok((shape, values)) }
}

fn wrong_shape(shape: &[usize], expected: &str, path: &Path) -> anyhow::Error {
    Failure::new(FailureKind::BadInput, format!("shape {shape:?} where {expected} is expected")).at(path).into()
}
