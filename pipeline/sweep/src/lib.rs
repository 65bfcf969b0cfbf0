#![doc = include_str!("../README.md")]

mod analysis;
mod condition;
mod halving;
mod history;
mod sampler;
mod space;

pub use analysis::{Importance, best_over_cost, importance, pareto};
pub use halving::{Halving, Next, Reached, Trials};
pub use history::{Entry, History};
pub use sampler::{Sampler, Strategy};
pub use space::{AxisValues, ConditionError, Parameter, Space};
