//! Prompts to a model in films and exports: the selected part is highlighted, recoloured, removed, kept (all else is
//! removed), or written as a mask.

use std::path::Path;
use std::str::FromStr;

use anyhow::Context as _;
use engine::{Failure, FailureKind};
use feature_import::TextEmbeddings;
use shaders::tape::Tensor;
use training::{Edit, Model, Player};

/// A prompt, and the edit of the part that it selects.
#[derive(Clone, Copy, Debug)]
pub struct Selection<'a> {
    /// The prompt: one that the model was trained with, or one of `embeddings`.
    pub prompt: &'a str,
    /// A folder with the embeddings of further prompts (`prompts.txt`, `text.npy`), made like those that the model was
    /// trained with.
    pub embeddings: Option<&'a Path>,
    /// What to do with the part of the scene that the prompt selects.
    pub show: Show,
}

/// What to do with the part of the scene that a prompt selects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Show {
    /// All other pixels are dimmed.
    #[default]
    Highlight,
    /// Its pixels are white, all others are black.
    Mask,
    /// Its Gaussians are edited.
    Edit(Edit),
}

impl FromStr for Show {
    type Err = String;

    /// `highlight`, `mask`, `remove`, `keep`, or `recolour=#rrggbb`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "highlight" => Ok(Self::Highlight),
            "mask" => Ok(Self::Mask),
            "remove" => Ok(Self::Edit(Edit::Remove)),
            "keep" => Ok(Self::Edit(Edit::Keep)),
            _ => {
                let color = text.strip_prefix("recolour=#").and_then(color);
                let expected = "expected highlight, mask, remove, keep, or a colour, e.g. recolour=#3070ff";
                color.map(|color| Self::Edit(Edit::Recolor(color))).ok_or_else(|| expected.into())
            }
        }
    }
}

/// The colour of six hexadecimal digits.
fn color(digits: &str) -> Option<[f32; 3]> {
    let is_color = digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    let value = u32::from_str_radix(digits, 16).ok().filter(|_| is_color)?;
    let [_, rgb @ ..] = value.to_be_bytes();
    Some(rgb.map(|level| f32::from(level) / 255.0))
}

/// A prompt among others: its row in their embeddings [P, E].
pub(crate) struct Prompt {
    pub(crate) embeddings: Tensor<f32>,
    pub(crate) row: usize,
}

impl Prompt {
    /// The prompt of a selection among those of the model and of the given embeddings; the given ones take precedence.
    pub(crate) fn of(selection: &Selection<'_>, player: &Player, model: &Model) -> anyhow::Result<Self> {
        let Some(own) = player.prompts().filter(|_| !player.prompt_names().is_empty()) else {
            let message = format!("this model of {} was trained without prompts", model.header.method);
            let hint = "train l4dgs with features (effects `language` and `static-semantics`)";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
        };
        let mut names: Vec<&str> = player.prompt_names().iter().map(String::as_str).collect();
        let mut rows: Vec<&[f32]> = (0..own.rows()).map(|row| own.row(row)).collect();
        let given = selection.embeddings.map(TextEmbeddings::read).transpose()?;
        for (name, row) in given.iter().flat_map(TextEmbeddings::rows) {
            match names.iter().position(|own| *own == name) {
                Some(at) => rows[at] = row,
                None => (names.push(name), rows.push(row)).0,
            }
        }
        let width = own.row_len();
        if let Some(other) = rows.iter().find(|row| row.len() != width) {
            let message = format!("embeddings of {} dimensions for a model trained with {width}", other.len());
            let hint = "make them with the text encoder that made the model's prompts";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
        }
        let row = names.iter().position(|name| *name == selection.prompt).ok_or_else(|| {
            let hint = format!("it knows {}; --embeddings DIR adds prompts", names.join(", "));
            Failure::new(FailureKind::BadInput, format!("the model does not know the prompt {:?}", selection.prompt))
                .hint(hint)
        })?;
        Ok(Self { embeddings: Tensor::from_vec([rows.len(), width], rows.concat()), row })
    }

    /// The player of the model that this prompt edits.
    pub(crate) fn edit(&self, player: Player, edit: Edit) -> anyhow::Result<Player> {
        let edited = player.edited(edit, &self.embeddings, self.row)?;
        edited.context("the model has no semantic features that could be compared with prompts")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_to_show_is_parsed_and_nonsense_refused() {
        assert_eq!("mask".parse(), Ok(Show::Mask));
        assert_eq!("keep".parse(), Ok(Show::Edit(Edit::Keep)));
        assert_eq!("recolour=#ff0033".parse(), Ok(Show::Edit(Edit::Recolor([1.0, 0.0, 0.2]))));
        for bad in ["", "recolour", "recolour=#12345", "recolour=#+12345", "recolour=red", "Remove"] {
            assert!(bad.parse::<Show>().is_err(), "{bad}");
        }
    }
}
