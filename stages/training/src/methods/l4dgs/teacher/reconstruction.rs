//! The teacher's training loss: every token is decoded to the image content at its place.

use shaders::arrays::rows::{columns, cosine_distance, squared_norm};
use shaders::arrays::totals::total;
use shaders::pointwise::{mul, sub};
use shaders::tape::{Real, Tape, Var};

use super::{COLOR_STATISTICS, MIN_NORM, Teacher};
use crate::model::Variables;

/// Weight of the angle between a decoded token and its target (Qin et al. 2024).
const ANGLE_WEIGHT: f64 = 1e-3;

/// Terms of the reconstruction loss: weights and scalars.
pub(crate) type WeightedLosses = Vec<(f64, Var)>;

impl Teacher<'_> {
    /// Σ w·(‖colours − decoded‖² + ‖token − decoded‖² + 10⁻³·(1 − cos(token, decoded))) for colour statistics [tokens, 6]
    /// and, if the frame has them, visual tokens [tokens, F]; w [tokens, 1].
    pub(crate) fn reconstruction<T: Real>(
        tape: &mut Tape<T>,
        model: &Variables,
        features: Var,
        statistics: Var,
        visual_tokens: Option<Var>,
        weights: Var,
    ) -> WeightedLosses {
        let decoded = Self::decode(tape, model, features);
        let decoded_colors = columns(tape, decoded, 0..COLOR_STATISTICS);
        let mut losses = vec![(1.0, squared_distance(tape, decoded_colors, statistics, weights))];
        if let Some(visual_tokens) = visual_tokens {
            let width = tape.value(decoded).row_len();
            let decoded_tokens = columns(tape, decoded, COLOR_STATISTICS..width);
            losses.push((1.0, squared_distance(tape, decoded_tokens, visual_tokens, weights)));
            let angles = cosine_distance(tape, decoded_tokens, visual_tokens, MIN_NORM);
            losses.push((ANGLE_WEIGHT, weighted(tape, angles, weights)));
        }
        losses
    }

    /// Decodes semantic features [M, features] to visual tokens [M, F]; `None` if the teacher was trained without them.
    pub(crate) fn meaning<T: Real>(tape: &mut Tape<T>, model: &Variables, features: Var) -> Option<Var> {
        if !Self::reads_visual_tokens(model) {
            return None;
        }
        let decoded = Self::decode(tape, model, features);
        let width = tape.value(decoded).row_len();
        Some(columns(tape, decoded, COLOR_STATISTICS..width))
    }
}

/// Σ wₙ‖aₙ − bₙ‖².
fn squared_distance<T: Real>(tape: &mut Tape<T>, a: Var, b: Var, weights: Var) -> Var {
    let difference = sub(tape, a, b);
    let squared = squared_norm(tape, difference);
    weighted(tape, squared, weights)
}

/// Σ wₙxₙ for x and w [N, 1].
fn weighted<T: Real>(tape: &mut Tape<T>, x: Var, weights: Var) -> Var {
    let terms = mul(tape, x, weights);
    total(tape, terms)
}
