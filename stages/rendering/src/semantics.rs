//! What a render means: semantic features, and where the prompts are that the model was trained with.

use scene::View;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Tensor;
use training::Player;

use crate::SemanticMaps;

/// Renders what a view means; none where the model has no semantic features.
pub fn semantics(player: &Player, view: &View) -> anyhow::Result<Option<SemanticMaps>> {
    let camera = PinholeCamera::from(&view.camera);
    let Some(image) = player.render_semantics(view.time_secs, &camera)? else { return Ok(None) };
    let relevancy = match player.prompts() {
        Some(prompts) => player.prompt_relevancy(view.time_secs, &camera, &prompts)?,
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

/// [H, W, C] as C planes.
fn planes(image: &Tensor<f32>) -> Vec<Vec<f32>> {
    let channels = image.shape()[2];
    (0..channels).map(|channel| image.as_slice().iter().skip(channel).step_by(channels).copied().collect()).collect()
}
