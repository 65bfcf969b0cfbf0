//! Prompts to a model in films and exports: the selected part is highlighted, recoloured, removed, kept (all else is
//! removed), or written as a mask.

use std::path::Path;
use std::str::FromStr;

use anyhow::Context as _;
use engine::{Failure, FailureKind};
use feature_import::TextEmbeddings;
use shaders::tape::Tensor;
use training::{Edit, Model, Player};

use crate::artifact::SemanticMaps;

/// Why no prompt selects anything of some models.
pub(crate) const NO_SEMANTICS: &str = "the model has no semantic features that could be compared with prompts";

/// A prompt, and the edit of the part that it selects.
#[derive(Clone, Copy, Debug)]
pub struct Selection<'a> {
    /// The prompt: one that the model was trained with, or one of `embeddings`.
    pub prompt: &'a str,
    /// A folder with the embeddings of further prompts (`prompts.txt`, `text.npy`), made like those that the model was
    /// trained with. They compete with the model's own prompts for every part of the scene.
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

/// A prompt and its competitors: the embeddings [P, E] of all prompts, and the row of this one.
pub(crate) struct Prompt {
    pub(crate) embeddings: Tensor<f32>,
    pub(crate) row: usize,
    /// The number of Gaussians that it selects, at least one, and of all.
    pub(crate) selected: [usize; 2],
}

impl Prompt {
    /// The prompt of a selection among those of the model and of the given embeddings; the given ones take precedence.
    /// A prompt that selects nothing is refused.
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
            let hint = format!("known prompts: {}; --embeddings DIR adds more", names.join(", "));
            Failure::new(FailureKind::BadInput, format!("no embedding of the prompt {:?}", selection.prompt)).hint(hint)
        })?;
        let embeddings = Tensor::from_vec([rows.len(), width], rows.concat());
        let relevancy = player.gaussian_relevancy(&embeddings)?.context(NO_SEMANTICS)?;
        let selected = selected(&relevancy, &names, row)?;
        Ok(Self { embeddings, row, selected })
    }

    /// What the prompt selects, as a line of a report.
    pub(crate) fn line(&self, name: &str) -> String {
        let [selected, all] = self.selected;
        format!("{name:?} selects {selected} of {all} Gaussians\n")
    }

    /// The player of the model that this prompt edits.
    pub(crate) fn edit(&self, player: Player, edit: Edit) -> anyhow::Result<Player> {
        let [selected, all] = self.selected;
        if edit == Edit::Remove && selected == all {
            let failure = Failure::new(FailureKind::BadInput, format!("the prompt selects all {all} Gaussians"));
            return Err(failure.hint("nothing would be left; choose a prompt that matches less").into());
        }
        player.edited(edit, &self.embeddings, self.row)?.context(NO_SEMANTICS)
    }
}

/// The number of Gaussians that the prompt `row` selects, and the total number, from the relevancy [N, P] of P prompts
/// to N Gaussians. If it selects none, the error names its strongest competitor, if it has any.
fn selected(relevancy: &[f32], names: &[&str], row: usize) -> Result<[usize; 2], Failure> {
    let gaussians = relevancy.chunks_exact(names.len());
    let (all, name) = (gaussians.len(), names[row]);
    let count = gaussians.clone().filter(|prompts| prompts[row] > SemanticMaps::RELEVANT).count();
    if count > 0 {
        return Ok([count, all]);
    }
    let best = gaussians.max_by(|a, b| a[row].total_cmp(&b[row])).unwrap_or_default();
    let others = best.iter().zip(names).filter(|(_, other)| **other != name);
    let Some((_, winner)) = others.max_by(|(a, _), (b, _)| a.total_cmp(b)) else {
        let failure = Failure::new(FailureKind::BadInput, format!("{name:?} selects none of {all} Gaussians"));
        return Err(failure.hint("name a prompt that describes a part of the scene"));
    };
    let message = format!(
        "{name:?} selects none of {all} Gaussians: it competes with {winner:?}, which is at least as relevant even where \
         {name:?} is most relevant"
    );
    let hint = format!("name {winner:?}, or a prompt with another meaning than all other prompts");
    Err(Failure::new(FailureKind::BadInput, message).hint(hint))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strongest_competitor_of_a_prompt_without_gaussians_is_named() {
        let names = ["arm", "robot", "sky"];
        let relevancy = [[0.6, 0.4, 0.0], [0.1, 0.2, 0.8], [0.7, 0.3, 0.1], [0.9, 0.1, 0.0]].concat();
        assert_eq!(selected(&relevancy, &names, 0).unwrap(), [3, 4]);
        let nothing = selected(&relevancy, &names, 1).unwrap_err();
        assert!(
            nothing.message.starts_with("\"robot\" selects none of 4 Gaussians: it competes with \"arm\""),
            "{nothing}"
        );
        let alone = selected(&[0.2, 0.5], &["robot"], 0).unwrap_err();
        assert_eq!(alone.message, "\"robot\" selects none of 2 Gaussians");
    }

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
