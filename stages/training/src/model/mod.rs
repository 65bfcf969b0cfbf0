//! Models in memory: their tensors by name, and the optimizer that trains them.

mod optimizer;
mod state;

pub(crate) use optimizer::Optimizer;
pub(crate) use state::{ModelState, Variables, belongs};
