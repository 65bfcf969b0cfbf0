//! Prompts and their embeddings in files: `prompts.txt` with one prompt per line, and `text.npy` [P, F].

use std::path::Path;

use engine::{Failure, FailureKind};

use crate::array_file::{array_path, read_array, wrong_shape};
use crate::artifact::check_vectors;

/// Prompts and their embeddings.
#[derive(Clone, Debug, PartialEq)]
pub struct TextEmbeddings {
    /// The P prompts.
    pub prompts: Vec<String>,
    /// [P, F] values, one row per prompt.
    pub values: Vec<f32>,
    /// Dimension F.
    pub dimension: usize,
}

impl TextEmbeddings {
    /// Reads the embeddings in a folder.
    pub fn read(folder: &Path) -> anyhow::Result<Self> {
        let prompts = read_prompts(&folder.join("prompts.txt"))?;
        let path = array_path(&folder.join("text"))
            .ok_or_else(|| Failure::new(FailureKind::MissingData, "no text embeddings").at(folder.join("text.npy")))?;
        let (shape, values) = read_array(&path)?;
        let [rows, dimension] = *shape.as_slice() else { return Err(wrong_shape(&shape, "[prompts, F]", &path)) };
        if rows != prompts.len() {
            let message = format!("{rows} text embeddings for {} prompts", prompts.len());
            let failure = Failure::new(FailureKind::BadInput, message);
            return Err(failure.hint("prompts.txt must have one prompt per line").at(path).into());
        }
        check_vectors(&values, dimension, &path)?;
        Ok(Self { prompts, values, dimension })
    }

    /// Reads the embeddings in a folder; none if it has neither prompts nor embeddings.
    pub(crate) fn find(folder: &Path) -> anyhow::Result<Option<Self>> {
        let has_any = folder.join("prompts.txt").exists() || array_path(&folder.join("text")).is_some();
        has_any.then(|| Self::read(folder)).transpose()
    }

    /// Each prompt with its embedding.
    pub fn rows(&self) -> impl Iterator<Item = (&str, &[f32])> {
        self.prompts.iter().map(String::as_str).zip(self.values.chunks_exact(self.dimension))
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
