//! A filmed model, with the selection of a prompt.

use std::path::Path;

use anyhow::Context as _;
use image::{Rgb, RgbImage};
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Device, Tensor};
use training::Player;

use super::shots::Shot;
use crate::artifact::SemanticMaps;
use crate::inputs::open_model;
use crate::prompts::{NO_SEMANTICS, Prompt, Selection, Show};
use crate::quantize::to_image;

/// Brightness of a pixel that is irrelevant to the prompt.
const DIMMED: f32 = 0.2;

/// A filmed model.
pub(super) struct Subject {
    player: Player,
    /// The prompt whose pixels are shown, and how.
    shown: Option<(Prompt, Show)>,
    /// What the prompt selects, as a line; empty without one.
    pub(super) selects: String,
}

impl Subject {
    /// Opens a model, edited if the selection says so.
    pub(super) fn open(model_dir: &Path, selection: Option<&Selection<'_>>, device: Device) -> anyhow::Result<Self> {
        let model = open_model(model_dir)?;
        let player = Player::new(&model)?.on(device);
        let Some(selection) = selection else { return Ok(Self { player, shown: None, selects: String::new() }) };
        let prompt = Prompt::of(selection, &player, &model)?;
        let selects = prompt.line(selection.prompt);
        match selection.show {
            Show::Edit(edit) => Ok(Self { player: prompt.edit(player, edit)?, shown: None, selects }),
            show => Ok(Self { player, shown: Some((prompt, show)), selects }),
        }
    }

    /// Renders one frame.
    pub(super) fn image(&self, shot: &Shot) -> anyhow::Result<RgbImage> {
        let camera = PinholeCamera::from(&shot.camera);
        let Some((prompt, show)) = &self.shown else {
            return Ok(to_image(&self.player.render(shot.time_secs, &camera)?));
        };
        let relevancy = relevancy(&self.player, shot.time_secs, &camera, prompt)?;
        if *show == Show::Mask {
            return Ok(mask(&relevancy, camera.width as u32, camera.height as u32));
        }
        let mut color = self.player.render(shot.time_secs, &camera)?;
        dim(&mut color, &relevancy);
        Ok(to_image(&color))
    }
}

/// [H·W] in [0, 1]: how relevant a prompt is to each pixel.
fn relevancy(player: &Player, time_secs: f64, camera: &PinholeCamera, prompt: &Prompt) -> anyhow::Result<Vec<f32>> {
    let all = player.prompt_relevancy(time_secs, camera, &prompt.embeddings)?;
    let all = all.context(NO_SEMANTICS)?;
    Ok(all.as_slice().iter().skip(prompt.row).step_by(prompt.embeddings.rows()).copied().collect())
}

/// White where the prompt is relevant, otherwise black.
fn mask(relevancy: &[f32], width: u32, height: u32) -> RgbImage {
    let level = |at: usize| if relevancy[at] > SemanticMaps::RELEVANT { u8::MAX } else { 0 };
    RgbImage::from_fn(width, height, |x, y| Rgb([level((y * width + x) as usize); 3]))
}

/// Darkens an image [H, W, 3] where the relevancy is low.
fn dim(color: &mut Tensor<f32>, relevancy: &[f32]) {
    let pixels = color.make_mut().as_chunks_mut::<3>().0;
    for (pixel, &relevancy) in pixels.iter_mut().zip(relevancy) {
        let brightness = DIMMED + (1.0 - DIMMED) * relevancy;
        pixel.iter_mut().for_each(|channel| *channel *= brightness);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn irrelevant_pixels_are_dimmed() {
        let mut image = Tensor::full([1, 2, 3], 1.0);
        dim(&mut image, &[1.0, 0.0]);
        assert_eq!(image.as_slice(), [1.0, 1.0, 1.0, DIMMED, DIMMED, DIMMED]);
    }

    #[test]
    fn masks_are_white_where_the_prompt_is_relevant() {
        let mask = mask(&[0.0, 0.9, 0.5, 0.6], 2, 2);
        assert_eq!(mask.as_raw().chunks(3).map(|pixel| pixel[0]).collect::<Vec<_>>(), [0, 255, 0, 255]);
    }
}
