//! Semantic features of Gaussians and their relation to prompts.

use shaders::tape::{Real, Tape, Var};

use crate::data::Supplements;
use crate::model::Variables;

/// The interface of methods with semantic features.
pub(crate) trait Language<T: Real>: Send + Sync {
    /// The semantic features [N, features] of the Gaussians, if the model has any.
    fn semantics(&self, model: &Variables) -> Option<Var>;

    /// The embeddings [P, E] of the prompts that the model was trained with, if any.
    fn prompts(&self, model: &Variables) -> Option<Var>;

    /// The names of these prompts, given the optional inputs of the training; none if it reads no prompts.
    fn prompt_names(&self, supplements: &Supplements) -> Vec<String>;

    /// Maps semantic features [M, features] into the space of the prompts [M, E]; `None` for a model that cannot decode
    /// its features.
    fn meaning(&self, tape: &mut Tape<T>, model: &Variables, features: Var) -> Option<Var>;
}
