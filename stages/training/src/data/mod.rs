//! The data of a training: its views, the optional inputs, and the order in which views are drawn.

mod dataset;
mod reduction;
mod sampler;
mod supplements;
mod view_constants;

pub use dataset::Dataset;
pub(crate) use dataset::{LoadedView, SceneFacts, TrainingView, evenly_thinned, facts_of};
pub(crate) use reduction::{area_means, reduced_camera};
pub(crate) use sampler::{StepRandom, Streams, ViewSampler};
pub(crate) use supplements::mask_image;
pub use supplements::{BackgroundView, FeatureTokens, FlowPrior, NOTHING, Supplements, ViewPriors};
pub(crate) use view_constants::ViewConstants;
