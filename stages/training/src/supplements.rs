//! What training may know beyond images, poses and times; all of it is optional.
//!
//! A method reads only what its active effects need; whatever a recipe does not give is empty here.

use engine::Facts;
use image::RgbImage;
use scene::{Camera, DepthMap, FlowMap, LabelMap, NormalMap, PointCloud, VelocityMap, facts};
use shaders::tape::Tensor;

use crate::effects::{BACKGROUND, FEATURES, LAYERS, PARTICLES};

/// Everything that the optional inputs of a training gave, in memory.
#[derive(Clone, Debug, Default)]
pub struct Supplements {
    /// By index within the capture's views; empty where no priors were given.
    pub priors: Vec<ViewPriors>,
    /// Visual tokens and text embeddings.
    pub features: Option<FeatureTokens>,
    /// Particles that were drawn where things move.
    pub particles: Option<ParticleSeeds>,
    /// By index within the capture's views: the part of the image that moves (0: static); empty where none was given.
    pub moving: Vec<Option<LabelMap>>,
    /// By index within the capture's views: the image without what moves; empty where none was given.
    pub background: Vec<Option<BackgroundView>>,
}

/// Maps of one view, each of the view's size.
#[derive(Clone, Debug, Default)]
pub struct ViewPriors {
    /// View-space z in scene units.
    pub depth: Option<DepthMap>,
    /// Flow to the next instant.
    pub flow: Option<FlowPrior>,
    /// Surface normals.
    pub normals: Option<NormalMap>,
    /// Exact velocity of the surfaces; only synthetic captures know it.
    pub velocity: Option<VelocityMap>,
}

/// Optical flow of one view, and where it leads.
#[derive(Clone, Debug)]
pub struct FlowPrior {
    /// Displacement in pixels; NaN where there is none or where it failed the forward–backward check.
    pub map: FlowMap,
    /// The camera that sees the pixels where they arrive: the next view's, or this view's own where the flow was made
    /// for a camera that stands still.
    pub camera_to: Camera,
    /// When they arrive, in seconds.
    pub time_to_secs: f64,
    /// The view that shows them there, if any does.
    pub view_to: Option<usize>,
}

/// What the picture shows in words: tokens on a grid per view, and embeddings of prompts.
#[derive(Clone, Debug)]
pub struct FeatureTokens {
    /// By index within the capture's views: [rows, columns, F].
    pub visual: Vec<Option<Tensor<f32>>>,
    /// [P, F], one row per prompt.
    pub text: Tensor<f32>,
    /// The prompts.
    pub prompts: Vec<String>,
}

/// Particles at the canonical time, for methods that begin where things move (KineticGS equations 3 to 5).
#[derive(Clone, Debug)]
pub struct ParticleSeeds {
    /// World positions and colours.
    pub points: PointCloud,
    /// Share of the momentum energy, one per point.
    pub energies: Vec<f32>,
}

/// The static layer of one view.
#[derive(Clone, Debug)]
pub struct BackgroundView {
    /// Filled image.
    pub image: RgbImage,
    /// Depth of the filled image, where known (0 elsewhere).
    pub depth: Option<DepthMap>,
    /// Pixels that nothing could fill are nonzero.
    pub unfilled: LabelMap,
}

/// A training on images, poses and times alone.
pub static NOTHING: Supplements =
    Supplements { priors: Vec::new(), features: None, particles: None, moving: Vec::new(), background: Vec::new() };

impl Supplements {
    /// The priors of a view, where there are any.
    pub fn view(&self, index: usize) -> Option<&ViewPriors> {
        self.priors.get(index)
    }

    /// What priors there are; none where nothing was given.
    pub fn prior_facts(&self) -> Option<Facts> {
        let any = |has: fn(&ViewPriors) -> bool| self.priors.iter().any(has);
        let known = Facts::default()
            .with(facts::DEPTH, any(|view| view.depth.is_some()))
            .with(facts::FLOW, any(|view| view.flow.is_some()))
            .with(facts::NORMALS, any(|view| view.normals.is_some()))
            .with(facts::VELOCITY, any(|view| view.velocity.is_some()));
        (!self.priors.is_empty()).then_some(known)
    }

    /// The ports, besides that of priors, on which something was given.
    pub fn given(&self) -> Vec<&'static str> {
        let given = [
            (FEATURES, self.features.is_some()),
            (PARTICLES, self.particles.is_some()),
            (LAYERS, !self.moving.is_empty()),
            (BACKGROUND, !self.background.is_empty()),
        ];
        given.into_iter().filter(|(_, given)| *given).map(|(port, _)| port).collect()
    }

    /// The moving part of a view, where it is known.
    pub fn moving(&self, index: usize) -> Option<&LabelMap> {
        self.moving.get(index)?.as_ref()
    }
}
