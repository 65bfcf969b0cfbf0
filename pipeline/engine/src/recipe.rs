//! Recipes: TOML files that say which stages to run over which axes, resolved into a [`Plan`].
//!
//! ```toml
//! extends = ["common/benchmark.toml"]   # relative to this file; tables merge, arrays replace, [[set]] adds up
//! name = "dnerf-preview"                # default: the file's stem
//! [axes]                                # their order is the order of names and table columns
//! scene = ["bouncingballs", "lego"]
//! seed = [0, 1]
//! [nodes.capture]
//! stage = "sfm-import"
//! over = ["scene"]                      # one job per value
//! params = { source = "dnerf/{scene}" } # "{seed}" alone keeps the value's type; "{{x}}" is a literal {x}
//! [nodes.train]
//! stage = "training"
//! over = ["scene", "seed"]
//! # like = { node = "other", seed = 0 } # starts from the parameters, rules included, of other jobs of its stage
//! inputs = { capture = "capture" }      # port = node; shared axes agree, others fan in on ports for many
//! params = { seed = "{seed}" }
//! [[set]]                               # later rules win; -s on the command line wins over all
//! when = { scene = "lego" }
//! nodes.train.params.iterations = 500
//! ```

mod errors;
mod expand;
mod link;
mod load;
mod nearest;
mod places;
mod raw;
mod resolve;
mod tree;
mod wire;

#[cfg(test)]
pub(crate) mod tests;

pub use errors::{RecipeError, RecipeErrors};
pub use load::{Overrides, StageOverride};
pub(crate) use nearest::nearest;
pub use resolve::{resolve, resolve_with};
