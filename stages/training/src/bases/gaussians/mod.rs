//! Gaussians in the parametrisation of Kerbl et al. 2023: tensors, initial values, learning rates and density control.
//!
//! | tensor | shape | stored as |
//! |---|---|---|
//! | `positions` | [N, 3] | scene units |
//! | `log_scales` | [N, 3] | logarithm of the standard deviation |
//! | `rotations` | [N, 4] | quaternion (w, x, y, z), normalised where used |
//! | `opacity_logits` | [N, 1] | before the logistic function |
//! | `sh_dc`, `sh_rest` | [N, 1, 3], [N, (degree + 1)² − 1, 3] | spherical harmonics |

mod density;
mod growth_budget;
mod harmonics;
mod initial;
mod principal_axes;
mod statistics;
#[cfg(test)]
mod tests;

pub(crate) use density::AdaptiveDensity;
pub(crate) use harmonics::{active_harmonics, leading_harmonics};
pub(crate) use initial::{insert_gaussians, insert_initial, logit, nearest_scales};
pub(crate) use statistics::{GRADIENT_SUM, RADIUS_PX, SEEN_COUNT, Statistics};

use principal_axes::principal_axes;
use scene::Gaussians;
use shaders::rasteriser::{HIDDEN_LOGIT, ShapeVars, SplatVars};
use shaders::tape::{Real, Tape};

use crate::data::SceneFacts;
use crate::model::Variables;
use crate::schedule::LogLinear;
use crate::shared::LearningRates;

/// The population of Gaussians of most methods.
pub(crate) const GAUSSIANS: &str = "gaussians";

/// The learning rate of an attribute of a population of Gaussians; `None` for other tensors. The rate of positions is a
/// share of the scene's extent.
pub(crate) fn learning_rate(
    rates: &LearningRates,
    population: &str,
    tensor: &str,
    scene: &SceneFacts,
) -> Option<LogLinear> {
    let attribute = tensor.strip_prefix(population)?.strip_prefix('.')?;
    match attribute {
        "positions" => Some(rates.position.scaled(scene.extent)),
        "log_scales" => Some(LogLinear::constant(rates.scale)),
        "rotations" => Some(LogLinear::constant(rates.rotation)),
        "opacity_logits" => Some(LogLinear::constant(rates.opacity)),
        // One frame after a seed's birth, a step of this rate displaces it about as much as a step of its position.
        "seed_velocities" => Some(rates.position.scaled(scene.extent * scene.training_intervals())),
        "sh_dc" => Some(LogLinear::constant(rates.sh_dc)),
        "sh_rest" => Some(LogLinear::constant(rates.sh_rest)),
        _ => None,
    }
}

/// A stored population, without motion.
pub(crate) fn static_splats<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    population: &str,
    sh_degree: usize,
) -> SplatVars {
    let var = |attribute: &str| model.get(&format!("{population}.{attribute}"));
    SplatVars {
        positions: var("positions"),
        shape: ShapeVars::ScaleRotation { log_scales: var("log_scales"), rotations: var("rotations") },
        opacity_logits: var("opacity_logits"),
        sh: match sh_degree {
            0 => var("sh_dc"),
            degree => active_harmonics(tape, var("sh_dc"), var("sh_rest"), degree),
        },
    }
}

/// The values of the visible splats on a tape, for files.
pub(crate) fn baked(tape: &Tape<f32>, splats: &SplatVars, sh_degree: usize) -> Gaussians {
    let there = present(tape, splats);
    let rows = |var| -> Vec<&[f32]> {
        let tensor = tape.value(var);
        there.iter().map(|&row| tensor.row(row as usize)).collect()
    };
    let (log_scales, rotations) = match splats.shape {
        ShapeVars::ScaleRotation { log_scales, rotations } => (rows(log_scales).concat(), rows(rotations).concat()),
        ShapeVars::Factor(factors) => {
            let axes = rows(factors).into_iter().map(principal_axes);
            let (log_scales, rotations): (Vec<_>, Vec<_>) = axes.unzip();
            (log_scales.concat(), rotations.concat())
        }
    };
    Gaussians {
        positions: rows(splats.positions).concat(),
        log_scales,
        rotations,
        opacity_logits: rows(splats.opacity_logits).concat(),
        sh: rows(splats.sh).concat(),
        sh_degree,
    }
}

/// The rows of the splats that are not hidden ([`HIDDEN_LOGIT`]).
pub(crate) fn present(tape: &Tape<f32>, splats: &SplatVars) -> Vec<u32> {
    let logits = tape.value(splats.opacity_logits).as_slice();
    let is_there = |row: &u32| logits[*row as usize] != HIDDEN_LOGIT as f32;
    (0..logits.len() as u32).filter(is_there).collect()
}
