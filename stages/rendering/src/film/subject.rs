//! A filmed model, with the region of a prompt highlighted.

use std::path::Path;

use anyhow::Context as _;
use engine::{Failure, FailureKind};
use image::RgbImage;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Device, Tensor};
use training::{Model, Player};

use super::shots::Shot;
use crate::inputs::open_model;
use crate::quantize::to_image;

/// Brightness of a pixel that is irrelevant to the prompt.
const DIMMED: f32 = 0.2;

/// A model that is filmed.
pub(super) struct Subject {
    player: Player,
    /// The index of the film's prompt among the model's prompts.
    prompt: Option<usize>,
}

impl Subject {
    /// Opens a model; `prompt` must be one of the prompts that it was trained with.
    pub(super) fn open(model_dir: &Path, prompt: Option<&str>, device: Device) -> anyhow::Result<Self> {
        let model = open_model(model_dir)?;
        let player = Player::new(&model)?.on(device);
        let prompt = prompt.map(|prompt| prompt_index(&player, &model, prompt)).transpose()?;
        Ok(Self { player, prompt })
    }

    /// Renders one frame.
    pub(super) fn image(&self, shot: &Shot) -> anyhow::Result<RgbImage> {
        let camera = PinholeCamera::from(&shot.camera);
        let mut color = self.player.render(shot.time_secs, &camera)?;
        if let Some(prompt) = self.prompt {
            dim(&mut color, &relevancy(&self.player, shot.time_secs, &camera, prompt)?);
        }
        Ok(to_image(&color))
    }
}

/// The index of a prompt among those that the model was trained with.
fn prompt_index(player: &Player, model: &Model, prompt: &str) -> anyhow::Result<usize> {
    let names = player.prompt_names();
    if names.is_empty() || player.prompts().is_none() {
        let message = format!("this model of {} was trained without prompts", model.header.method);
        let hint = "train l4dgs with features (effects language and semantics)";
        return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
    }
    let found = names.iter().position(|name| name == prompt);
    Ok(found.ok_or_else(|| {
        let hint = format!("it was trained with {}", names.join(", "));
        Failure::new(FailureKind::BadInput, format!("the model does not know the prompt {prompt:?}")).hint(hint)
    })?)
}

/// [H·W] in [0, 1]: how relevant a prompt is to each pixel.
fn relevancy(player: &Player, time_secs: f64, camera: &PinholeCamera, prompt: usize) -> anyhow::Result<Vec<f32>> {
    let prompts = player.prompts().context("the model has no prompts")?;
    let all = player.prompt_relevancy(time_secs, camera, &prompts)?.context("the model has no semantic features")?;
    Ok(all.as_slice().iter().skip(prompt).step_by(prompts.rows()).copied().collect())
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
}
