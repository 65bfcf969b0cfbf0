//! Loads the artifacts on the optional ports.

use anyhow::Context as _;
use depth_flow_import::Priors;
use engine::{JobContext, Port};
use feature_import::Features;
use inpaint_import::Background;
use layer_split::Layers;
use momentum_sampling::Particles;
use rayon::prelude::*;
use scene::{Capture, Split};
use shaders::tape::Tensor;

use crate::artifact::Model;
use crate::data::{BackgroundView, FeatureTokens, FlowPrior, Supplements, ViewPriors};
use crate::effects::{BACKGROUND, FEATURES, LAYERS, PARTICLES, PRIORS};
use crate::planning::START;

/// The ports besides `capture`; the effects decide which of them are read.
pub(super) fn optional_ports() -> Vec<Port> {
    vec![
        Port::optional::<Priors>(PRIORS),
        Port::optional::<Features>(FEATURES),
        Port::optional::<Particles>(PARTICLES).relaying_measurements(),
        Port::optional::<Layers>(LAYERS),
        Port::optional::<Background>(BACKGROUND),
        Port::choice::<Model>(START).relaying_measurements(),
    ]
}

/// The artifacts on the optional ports.
pub(super) struct OptionalInputs {
    priors: Option<Priors>,
    features: Option<Features>,
    particles: Option<Particles>,
    layers: Option<Layers>,
    background: Option<Background>,
}

impl OptionalInputs {
    /// Opens the optional inputs that the recipe wires and the effects need.
    pub(crate) fn open(context: &JobContext) -> anyhow::Result<Self> {
        Ok(Self {
            priors: context.optional_input(PRIORS)?,
            features: context.optional_input(FEATURES)?,
            particles: context.optional_input(PARTICLES)?,
            layers: context.optional_input(LAYERS)?,
            background: context.optional_input(BACKGROUND)?,
        })
    }

    /// Whether particles are wired and read.
    pub(crate) fn has_particles(&self) -> bool {
        self.particles.is_some()
    }

    /// Reads the inputs of the training views of `capture`. Views of other splits stay empty, so no method can learn
    /// from them.
    pub(crate) fn load(&self, capture: &Capture) -> anyhow::Result<Supplements> {
        let mut supplements = Supplements::default();
        if let Some(priors) = &self.priors {
            priors.check_against(capture)?;
            supplements.depth_is_static = priors.depth_is_static();
            supplements.priors = of_training_views(capture, |view| view_priors(priors, view))?;
        }
        if let Some(features) = &self.features {
            features.check_against(capture)?;
            supplements.features = Some(feature_tokens(features, capture)?);
        }
        if let Some(particles) = &self.particles {
            supplements.particles = Some(particles.load()?);
        }
        if let Some(layers) = &self.layers {
            layers.check_against(capture)?;
            supplements.moving = of_training_views(capture, |view| Ok(layers.load_moving(view)?))?;
        }
        if let Some(background) = &self.background {
            background.check_against(capture)?;
            supplements.background = of_training_views(capture, |view| background_view(background, view))?;
        }
        Ok(supplements)
    }
}

/// Calls `load` for each training view; results are indexed like the capture's views.
fn of_training_views<T: Default + Send>(
    capture: &Capture,
    load: impl Fn(usize) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    let of_view = |(index, view): (usize, &scene::View)| match view.split {
        Split::Train => load(index).with_context(|| format!("view {}", view.name)),
        Split::Val | Split::Test => Ok(T::default()),
    };
    capture.views.par_iter().enumerate().map(of_view).collect()
}

fn view_priors(priors: &Priors, view: usize) -> anyhow::Result<ViewPriors> {
    let flow = priors.load_flow(view)?.map(|flow| {
        let depth_flow_import::FlowPrior { map, camera_to, time_to_secs, view_to } = flow;
        FlowPrior { map, camera_to, time_to_secs, view_to }
    });
    Ok(ViewPriors {
        depth: priors.load_depth(view)?,
        flow,
        normals: priors.load_normals(view)?,
        velocity: priors.load_velocity(view)?,
    })
}

fn feature_tokens(features: &Features, capture: &Capture) -> anyhow::Result<FeatureTokens> {
    let tokens = |view| {
        let grid = features.load_tokens(view)?;
        Ok(grid.map(|grid| Tensor::from_vec([grid.rows, grid.columns, features.dimension], grid.values)))
    };
    Ok(FeatureTokens {
        visual: of_training_views(capture, tokens)?,
        text: Tensor::from_vec([features.prompts.len(), features.dimension], features.load_text()?),
        prompts: features.prompts.clone(),
    })
}

fn background_view(background: &Background, view: usize) -> anyhow::Result<Option<BackgroundView>> {
    let convert = |filled: inpaint_import::FilledView| {
        let inpaint_import::FilledView { image, depth, unfilled } = filled;
        BackgroundView { image, depth, unfilled }
    };
    Ok(background.load_view(view)?.map(convert))
}
