//! Recipes: TOML files that define which stages run over which axes, resolved into a [`Plan`](crate::Plan).
//!
//! ```toml
//! extends = ["common/benchmark.toml"]   # relative to this file, or a built-in recipe: "builtin:benchmark"; tables
//!                                       # merge, arrays replace, [[set]] accumulates; a node with another stage
//!                                       # loses its inherited params and rules
//! name = "dnerf-preview"                # default: the file's stem
//! [axes]                                # their order is the order of names and table columns
//! scene = ["bouncingballs", "lego"]
//! method = "all"                        # all values that the stage lists; or { except = ["vcgs"] }: all but some
//! seed = [0, 1]                         # strings or numbers: scale = [0.5, 1] is an axis of any parameter
//! [nodes.capture]
//! stage = "sfm-import"
//! over = ["scene"]                      # one job per value
//! params = { source = "dnerf/{scene}" } # "{seed}" alone keeps the value's type; "{{x}}" is a literal {x}
//! [nodes.train]
//! stage = "training"
//! over = ["scene", "method", "seed"]
//! # only = { scene = "lego" }           # jobs only for these values of axes in `over`
//! # only_with = { method = "mcgs" }     # no jobs, and none of the nodes that need them, unless the axis has the value
//! # like = { node = "other", seed = 0 } # starts from the parameters and rules of another node's jobs
//! inputs = { capture = "capture" }      # port = node; shared axes agree, others fan in on ports for many
//! params = { method = "{method}", seed = "{seed}" }
//! [[set]]                               # later rules win; -s on the command line overrides them all
//! when = { scene = "lego", method = "static3dgs" }
//! nodes.train.params.iterations.train = 500
//! [sweep]                               # a search over parameters: `pipeline run` tries values, and changes no key
//! trials = 40
//! parameters = { "nodes.train.params.schedule_scale" = "log(0.01, 1)" }
//! ```

mod all;
mod draft;
mod errors;
mod expand;
mod hints;
mod link;
mod load;
mod places;
mod raw;
mod resolve;
mod tree;
mod wire;

#[cfg(test)]
pub(crate) mod tests;

pub use errors::{RecipeError, RecipeErrors};
pub use load::{Overrides, StageOverride};
pub use resolve::{axis_values, name, resolve, resolve_with};
