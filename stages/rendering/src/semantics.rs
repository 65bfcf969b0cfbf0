//! Rendered semantics: semantic features, and the relevancy of the prompts that the model was trained with.

use scene::View;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Tensor;
use training::Player;

use crate::artifact::SemanticMaps;

/// Renders the semantics of a view; `None` if the model has no semantic features.
pub(crate) fn semantics(player: &Player, view: &View) -> anyhow::Result<Option<SemanticMaps>> {
    let camera = PinholeCamera::from(&view.camera);
    let Some(image) = player.render_semantics(view.time_secs, &camera)? else { return Ok(None) };
    let relevancy = match player.prompts() {
        Some(prompts) => player.image_relevancy(&image, &prompts)?,
        None => None,
    };
    let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    let relevancy = relevancy.as_ref().map_or_else(Vec::new, planes);
    Ok(Some(SemanticMaps {
        width,
        height,
        alpha: image.alpha.as_slice().to_vec(),
        features: planes(&image.features),
        relevancy,
    }))
}

/// Splits [H, W, C] into C planes.
fn planes(image: &Tensor<f32>) -> Vec<Vec<f32>> {
    let channels = image.shape()[2];
    (0..channels).map(|channel| image.as_slice().iter().skip(channel).step_by(channels).copied().collect()).collect()
}
