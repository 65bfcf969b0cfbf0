//! Recipes: TOML files that say which stages to run over which axes.

mod nearest;

pub(crate) use nearest::nearest;
