//! The optional inputs of a training, beyond images, poses and times.
//!
//! A method reads only the inputs that its active effects need. An input that the recipe does not wire is empty here.

use engine::Facts;
use image::RgbImage;
use scene::{Camera, DepthMap, FlowMap, LabelMap, NormalMap, PointCloud, VelocityMap, facts};
use shaders::tape::{Real, Tensor};

use crate::effects::{BACKGROUND, FEATURES, LAYERS, PARTICLES};

/// The optional inputs of a training, in memory.
#[derive(Clone, Debug, Default)]
pub struct Supplements {
    /// Priors by index within the capture's views; empty without priors.
    pub priors: Vec<ViewPriors>,
    /// Whether the depth in `priors` is that of the static scene even in moving regions, because it comes from the
    /// points of the capture.
    pub depth_is_static: bool,
    /// Visual tokens and text embeddings.
    pub features: Option<FeatureTokens>,
    /// World positions and colours of particles on moving surfaces, at the canonical time (KineticGS equations 3 to 5).
    pub particles: Option<PointCloud>,
    /// Moving part of each image (0: static), by index within the capture's views; empty without layers.
    pub moving: Vec<Option<LabelMap>>,
    /// Static background of each image, by index within the capture's views; empty without backgrounds.
    pub background: Vec<Option<BackgroundView>>,
}

/// Maps of one view, each of the view's size.
#[derive(Clone, Debug, Default)]
pub struct ViewPriors {
    /// View-space z in scene units.
    pub depth: Option<DepthMap>,
    /// Flow to the next time.
    pub flow: Option<FlowPrior>,
    /// Surface normals.
    pub normals: Option<NormalMap>,
    /// Exact velocity of the surfaces, from synthetic captures only.
    pub velocity: Option<VelocityMap>,
}

/// Optical flow of one view, and its target.
#[derive(Clone, Debug)]
pub struct FlowPrior {
    /// Displacement in pixels; NaN where it is unknown or failed the forward–backward check.
    pub map: FlowMap,
    /// The camera at the target: the next view's, or this view's own for flow of a camera that stands still.
    pub camera_to: Camera,
    /// The time at the target, seconds.
    pub time_to_secs: f64,
    /// The view at the target, if there is one.
    pub view_to: Option<usize>,
}

/// Semantic inputs: visual tokens on a grid per view, and embeddings of prompts.
#[derive(Clone, Debug)]
pub struct FeatureTokens {
    /// Tokens [rows, columns, F] by index within the capture's views.
    pub visual: Vec<Option<Tensor<f32>>>,
    /// Embeddings [P, F], one row per prompt.
    pub text: Tensor<f32>,
    /// The P prompts.
    pub prompts: Vec<String>,
}

/// The static layer of one view.
#[derive(Clone, Debug)]
pub struct BackgroundView {
    /// Filled image.
    pub image: RgbImage,
    /// Depth of the filled image; 0 where it is unknown.
    pub depth: Option<DepthMap>,
    /// Nonzero for pixels that could not be filled.
    pub unfilled: LabelMap,
}

/// No optional inputs: a training on images, poses and times alone.
pub static NOTHING: Supplements = Supplements {
    priors: Vec::new(),
    depth_is_static: false,
    features: None,
    particles: None,
    moving: Vec::new(),
    background: Vec::new(),
};

impl Supplements {
    /// The priors of a view, if there are any.
    pub(crate) fn view(&self, index: usize) -> Option<&ViewPriors> {
        self.priors.get(index)
    }

    /// Static facts of the priors; `None` without priors.
    pub(crate) fn prior_facts(&self) -> Option<Facts> {
        let any = |has: fn(&ViewPriors) -> bool| self.priors.iter().any(has);
        let known = Facts::default()
            .with(facts::DEPTH, any(|view| view.depth.is_some()))
            .with(facts::FLOW, any(|view| view.flow.is_some()))
            .with(facts::NORMALS, any(|view| view.normals.is_some()))
            .with(facts::VELOCITY, any(|view| view.velocity.is_some()));
        (!self.priors.is_empty()).then_some(known)
    }

    /// The ports that have an input, apart from `priors`.
    pub(crate) fn given(&self) -> Vec<&'static str> {
        let given = [
            (FEATURES, self.features.is_some()),
            (PARTICLES, self.particles.is_some()),
            (LAYERS, !self.moving.is_empty()),
            (BACKGROUND, !self.background.is_empty()),
        ];
        given.into_iter().filter(|(_, given)| *given).map(|(port, _)| port).collect()
    }

    /// The moving part of a view, if it is known.
    pub(crate) fn moving(&self, index: usize) -> Option<&LabelMap> {
        self.moving.get(index)?.as_ref()
    }
}

/// A mask as an image [H, W, 1]: 1 where a label is set and 0 elsewhere.
pub(crate) fn mask_image<T: Real>(moving: &LabelMap) -> Tensor<T> {
    let weights = moving.labels.iter().map(|&label| if label == 0 { T::ZERO } else { T::ONE }).collect();
    Tensor::from_vec([moving.height as usize, moving.width as usize, 1], weights)
}
