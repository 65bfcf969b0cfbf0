//! The lifetimes and positions of seeds: they fade linearly from their own training view to its neighbours, so that
//! between two frames the seeds of both are cross-faded at the places to which their velocities carry them.
//!
//! [`SEED_LIVES`] is [N, 5] per Gaussian: the second last and the last training time before its birth, its birth, and the
//! next two training times, all normalised; zeros for a Gaussian that is not a seed. It is not trained.

use shaders::arrays::rows::{RowIndex, columns, gather, scale_rows};
use shaders::pointwise;
use shaders::pointwise::add;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::method::{Moment, SEED_LIVES, is_seed};
use crate::model::Variables;

/// [N, 6]: world velocities before and after birth, scene units per unit of normalised time.
pub(crate) const SEED_VELOCITIES: &str = "gaussians.seed_velocities";

/// The time that replaces that of a missing neighbour: so far away that nothing fades towards it.
const NEVER: f64 = 1e3;
/// The share of its opacity that a Gaussian in space and time has halfway to a neighbouring training time. With 0.5, a
/// quarter of the background would show through two opaque Gaussians, and half of it where the velocity of one is
/// wrong.
const MIDDLE_SHARE: f64 = 0.9;
/// Times nearer than this are equal, although one of them was stored with less precision.
const SAME_TIME: f64 = 1e-5;

/// The birth of a seed among the training times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lifetime {
    /// [second last, last, birth, next, second next], normalised times.
    pub times: [f64; 5],
}

impl Lifetime {
    /// The lifetime of seeds of the views at an index of the distinct times of all views with seeds, in order.
    pub(super) fn among(times: &[f64], at: usize) -> Self {
        let time = |offset: isize| {
            let found = at.checked_add_signed(offset).and_then(|at| times.get(at));
            found.copied().unwrap_or(NEVER * offset.signum() as f64)
        };
        Self { times: [-2, -1, 0, 1, 2].map(time) }
    }

    /// Normalised time of birth.
    pub(crate) fn birth(&self) -> f64 {
        self.times[2]
    }

    /// The standard deviation in time of a Gaussian with [`MIDDLE_SHARE`] of its opacity in the middle of the longer of the two
    /// gaps to its neighbours; that of the whole clip for the only view of a video.
    pub(crate) fn deviation(&self) -> f64 {
        let [_, last, birth, next, _] = self.times;
        let gaps = [birth - last, next - birth].into_iter().filter(|&gap| gap <= 1.0);
        let longest = gaps.fold(0.0, f64::max);
        0.5 * if longest > 0.0 { longest } else { 1.0 } / (-2.0 * MIDDLE_SHARE.ln()).sqrt()
    }

    /// The share of its opacity at a time, as if the training view at the time `left_out` did not exist.
    pub(super) fn share(&self, time: f64, left_out: Option<f64>) -> f64 {
        let [second_last, last, birth, next, second_next] = self.times;
        let is_left_out = |other: f64| left_out.is_some_and(|time| (other - time).abs() <= SAME_TIME);
        if is_left_out(birth) {
            return 0.0;
        }
        let last = if is_left_out(last) { second_last } else { last };
        let next = if is_left_out(next) { second_next } else { next };
        let faded = if time < birth { (birth - time) / (birth - last) } else { (time - birth) / (next - birth) };
        if faded <= 1.0 - SAME_TIME { 1.0 - faded } else { 0.0 }
    }
}

/// The Gaussians that are shown at a moment, by row of the model.
pub(crate) struct Shown {
    /// Normalised time since birth; 0 for Gaussians that are not seeds.
    ages: Vec<f64>,
    /// Share of the opacity, in [0, 1]; 1 for Gaussians that are not seeds.
    shares: Vec<f64>,
}

/// The seeds that are shown at a moment; `None` for a model without seeds.
pub(crate) fn shown<T: Real>(tape: &Tape<T>, model: &Variables, moment: &Moment<'_>) -> Option<Shown> {
    let share = |life: Option<Lifetime>| life.map_or(1.0, |life| life.share(moment.time, moment.left_out));
    let lives = tape.value(model.find(SEED_LIVES)?);
    Some(Shown { ages: ages(lives, moment.time), shares: lifetimes(lives).map(share).collect() })
}

/// Positions [M, 3] of these rows of the model at birth, carried to a normalised time by the velocities of seeds. Other
/// Gaussians are static.
pub(crate) fn carried<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    rows: &RowIndex,
    positions: Var,
    time: f64,
) -> Var {
    let Some(lives) = model.find(SEED_LIVES) else { return positions };
    let ages = ages(tape.value(lives), time);
    carried_by_ages(tape, model, rows, positions, &ages)
}

/// The lifetimes of all Gaussians; `None` for those that are not seeds.
fn lifetimes<T: Real>(lives: &Tensor<T>) -> impl Iterator<Item = Option<Lifetime>> {
    let rows = lives.as_slice().as_chunks::<5>().0.iter();
    rows.map(|row| is_seed(row).then(|| Lifetime { times: row.map(T::to_f64) }))
}

/// The rows of seeds that are born at a time.
pub(crate) fn born_at<T: Real>(lives: &Tensor<T>, time: f64) -> impl Iterator<Item = usize> {
    let is_born = move |life: Lifetime| (life.birth() - time).abs() <= SAME_TIME;
    lifetimes(lives).enumerate().filter(move |(_, life)| life.is_some_and(is_born)).map(|(row, _)| row)
}

/// Normalised time since birth of all Gaussians at a time; 0 for those that are not seeds.
fn ages<T: Real>(lives: &Tensor<T>, time: f64) -> Vec<f64> {
    lifetimes(lives).map(|life| life.map_or(0.0, |life| time - life.birth())).collect()
}

/// [`carried`], with the ages of all N Gaussians.
fn carried_by_ages<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    rows: &RowIndex,
    positions: Var,
    ages: &[f64],
) -> Var {
    let velocities = gather(tape, model.get(SEED_VELOCITIES), rows);
    let [before, after] = [f64::min, f64::max].map(|bounded| ages.iter().map(|&age| bounded(age, 0.0)).collect());
    let mut moved = positions;
    for (first, ages) in [(0, before), (3, after)] {
        let velocity = columns(tape, velocities, first..first + 3);
        let ages = of_rows(tape, rows, ages);
        let shift = scale_rows(tape, velocity, ages);
        moved = add(tape, moved, shift);
    }
    moved
}

/// The values [M, 1] of these rows, given those of all Gaussians.
fn of_rows<T: Real>(tape: &mut Tape<T>, rows: &RowIndex, values: Vec<f64>) -> Var {
    let values: Vec<T> = values.into_iter().map(T::from_f64).collect();
    let values = tape.constant(Tensor::from_vec([values.len(), 1], values));
    gather(tape, values, rows)
}

impl Shown {
    /// Whether a row is a seed of other times.
    pub(crate) fn is_absent(&self, row: usize) -> bool {
        self.shares[row] == 0.0
    }

    /// The positions [M, 3] of these rows, carried from birth to the moment, and their opacity logits [M, 1] then.
    pub(crate) fn moved<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        rows: &RowIndex,
        [positions, logits]: [Var; 2],
    ) -> [Var; 2] {
        let moved = carried_by_ages(tape, model, rows, positions, &self.ages);
        let shares = of_rows(tape, rows, self.shares.clone());
        [moved, faded(tape, logits, shares)]
    }
}

pointwise! {
    /// y = logit(share · sigmoid(x)) for a share in (0, 1].
    pub(super) fn faded(x, share) -> y {
        // With e = e^−|x|: y = ln(share) − ln(1 − share + e^−x), in the form that does not overflow.
        let small = exp(-abs(x));
        let odds = select(1.0 + (1.0 - share) * small, (1.0 - share) + small, x >= 0.0);
        return log(share) - log(odds) + select(x, 0.0, x >= 0.0);
    }
    gradients(dy) {
        x: {
            let small = exp(-abs(x));
            let odds = select(1.0 + (1.0 - share) * small, (1.0 - share) + small, x >= 0.0);
            return dy * select(1.0, small, x >= 0.0) / odds;
        }
        share: {
            let small = exp(-abs(x));
            let odds = select(1.0 + (1.0 - share) * small, (1.0 - share) + small, x >= 0.0);
            return dy * (1.0 / share + select(small, 1.0, x >= 0.0) / odds);
        }
    }
}
