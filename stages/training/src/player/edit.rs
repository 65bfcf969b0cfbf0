//! Edits of a trained model by language: the Gaussians that a prompt selects are recoloured, removed, or kept while all
//! others are removed.

use anyhow::ensure;
use scene::gaussians::SH_C0;
use shaders::rasteriser::{HIDDEN_LOGIT, SplatVars};
use shaders::tape::{Tape, Tensor};

use super::Player;
use super::language::RELEVANT;

/// What happens to the Gaussians that a prompt selects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Edit {
    /// They take a colour (red, green, blue in [0, 1]) on average; light and shade are kept.
    Recolor([f32; 3]),
    /// They are removed.
    Remove,
    /// All others are removed.
    Keep,
}

/// An edit and the Gaussians that it applies to.
#[derive(Clone, Debug)]
pub(super) struct ActiveEdit {
    edit: Edit,
    /// By splat.
    selected: Vec<bool>,
}

impl Player {
    /// The player of the edited model: every image and every export shows the edit. The prompt is a row of `prompts` [P, E].
    /// `None` for a model that cannot compare its features with prompts.
    pub fn edited(self, edit: Edit, prompts: &Tensor<f32>, prompt: usize) -> anyhow::Result<Option<Self>> {
        let Some(relevancy) = self.gaussian_relevancy(prompts)? else { return Ok(None) };
        let selected: Vec<bool> =
            relevancy.iter().skip(prompt).step_by(prompts.rows()).map(|&relevancy| relevancy > RELEVANT).collect();
        Ok(Some(Self { edit: Some(ActiveEdit { edit, selected }), ..self }))
    }
}

impl ActiveEdit {
    /// Applies the edit to the splats of a model.
    pub(super) fn apply(&self, tape: &mut Tape<f32>, splats: SplatVars) -> anyhow::Result<SplatVars> {
        let found = tape.value(splats.opacity_logits).rows();
        ensure!(found == self.selected.len(), "the edit is for {} Gaussians, not {found}", self.selected.len());
        match self.edit {
            Edit::Recolor(color) => {
                let mut sh = tape.value(splats.sh).clone();
                self.recolor(color, &mut sh, &opacities(tape.value(splats.opacity_logits)));
                Ok(SplatVars { sh: tape.constant(sh), ..splats })
            }
            Edit::Remove => Ok(self.hide(tape, splats, true)),
            Edit::Keep => Ok(self.hide(tape, splats, false)),
        }
    }

    /// Hides the selected splats, or all others.
    fn hide(&self, tape: &mut Tape<f32>, splats: SplatVars, hidden: bool) -> SplatVars {
        let mut logits = tape.value(splats.opacity_logits).clone();
        let chosen = logits.make_mut().iter_mut().zip(&self.selected).filter(|(_, selected)| **selected == hidden);
        chosen.for_each(|(logit, _)| *logit = HIDDEN_LOGIT as f32);
        SplatVars { opacity_logits: tape.constant(logits), ..splats }
    }

    /// Colour = `color` · own luminance / mean luminance of the selected splats, for harmonics [N, K, 3].
    fn recolor(&self, color: [f32; 3], sh: &mut Tensor<f32>, opacities: &[f32]) {
        let row_len = sh.row_len();
        let luminance = |row: &[f32]| 0.5 + SH_C0 * (row[0] + row[1] + row[2]) / 3.0;
        let (mut sum, mut weight) = (0.0, 0.0);
        for ((row, &selected), &opacity) in sh.as_slice().chunks_exact(row_len).zip(&self.selected).zip(opacities) {
            if selected {
                sum += opacity * luminance(row).max(0.0);
                weight += opacity;
            }
        }
        // Black objects have no shades to keep.
        const MIN_LUMINANCE: f32 = 0.02;
        let mean = (sum / weight.max(f32::MIN_POSITIVE)).max(MIN_LUMINANCE);
        for (row, _) in sh.make_mut().chunks_exact_mut(row_len).zip(&self.selected).filter(|(_, selected)| **selected) {
            let luminance = luminance(row);
            for (at, harmonic) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let grey = (harmonic[0] + harmonic[1] + harmonic[2]) / 3.0;
                *harmonic = color.map(|channel| match at {
                    0 => (channel * luminance / mean - 0.5) / SH_C0,
                    _ => channel * grey / mean,
                });
            }
        }
    }
}

fn opacities(logits: &Tensor<f32>) -> Vec<f32> {
    logits.as_slice().iter().map(|logit| 1.0 / (1.0 + (-logit).exp())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Harmonics [3, 1, 3] of three splats with these colours.
    fn harmonics(colors: [[f32; 3]; 3]) -> Tensor<f32> {
        Tensor::from_vec([3, 1, 3], colors.concat().iter().map(|value| (value - 0.5) / SH_C0).collect())
    }

    #[test]
    fn recoloured_splats_have_the_colour_on_average_and_keep_their_shades() {
        let mut sh = harmonics([[0.4, 0.2, 0.0], [0.0, 0.2, 0.1], [0.9, 0.9, 0.9]]);
        let edit = ActiveEdit { edit: Edit::Remove, selected: vec![true, true, false] };
        edit.recolor([0.3, 0.6, 0.0], &mut sh, &[1.0, 1.0, 1.0]);
        let colors: Vec<f32> = sh.as_slice().iter().map(|value| 0.5 + SH_C0 * value).collect();
        // The first is twice as bright as the second; their mean is the colour.
        let expected = [0.4, 0.8, 0.0, 0.2, 0.4, 0.0, 0.9, 0.9, 0.9];
        assert!(colors.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-5), "{colors:?}");
    }
}
