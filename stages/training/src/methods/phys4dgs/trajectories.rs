//! Trajectories of Gaussians over a few frames.

use scene::LabelMap;
use shaders::arrays::rows::{RowIndex, gather, reshape, squared_norm};
use shaders::arrays::sample::SampledRows;
use shaders::arrays::totals::total;
use shaders::pointwise;
use shaders::pointwise::{mul, scale, shift, sub};
use shaders::rasteriser::Rendered;
use shaders::rasteriser::screen::covered;
use shaders::tape::{Device, Real, Tape, Tensor, Var};

use crate::bases::gaussians::GAUSSIANS;
use crate::bases::hexplane::{HexplaneGaussians, MovedPoints};
use crate::bases::seeds;
use crate::data::SceneFacts;
use crate::method::Step;

/// A Gaussian that moves less than this share of the scene's extent within the evaluated frames is static.
pub(crate) const STATIC_THRESHOLD: f64 = 1e-4;

/// Instants less than this share of a frame apart count as equal; an instant this close after the end is clamped to the
/// end.
pub(crate) const SAME_INSTANT: f64 = 1e-3;

pointwise! {
    /// y = value where x < limit, otherwise 0 (also for NaN).
    pub(crate) fn where_below(x, value) with(limit) -> y {
        return select(0.0, value, x < limit);
    }
    gradients(dy) {
        x: { return 0.0; }
        value: { return select(0.0, dy, x < limit); }
    }
}

/// The displacement per frame of an object that crosses the scene's extent in the duration of the capture: the unit of
/// motion in the losses. It is independent of the model's motion. Losses normalised by that motion would penalise small
/// motion more and suppress all motion.
pub(crate) fn motion_unit(scene: &SceneFacts) -> f64 {
    scene.extent * frame_of(scene)
}

/// M Gaussians at a time and a few frames after it.
pub(crate) struct Trajectories {
    /// [M]: 1 for a compared Gaussian, 0 for a static one and for padding rows of the sample.
    pub weights: Var,
    /// The M rows of the model.
    rows: RowIndex,
    /// [M, 3]: canonical positions.
    canonical: Var,
    /// The evaluated times in [0, 1], one frame apart.
    pub times: Vec<f64>,
    /// The moved Gaussians at each of these times.
    pub points: Vec<MovedPoints>,
}

/// Duration of a frame in normalised time; infinite for a single instant.
pub(crate) fn frame_of(scene: &SceneFacts) -> f64 {
    scene.time_map.frame_secs / (scene.time_map.end_secs - scene.time_map.start_secs)
}

impl Trajectories {
    /// Evaluates the `sampled` Gaussians at `time` and at most `frames_ahead` later frames within the capture.
    ///
    /// Static Gaussians get weight 0 unless `keeps_static`: the gradient of an observation can set them in motion.
    /// `None` if there is no later frame, no sampled row or, on the CPU, no Gaussian that moves.
    pub(crate) fn follow<T: Real>(
        step: &mut Step<'_, T>,
        base: &HexplaneGaussians,
        sampled: &SampledRows<T>,
        time: f64,
        frames_ahead: usize,
        keeps_static: bool,
    ) -> Option<Self> {
        let frame = frame_of(step.scene);
        let within = ((1.0 - time) / frame + SAME_INSTANT).max(0.0) as usize;
        let times: Vec<f64> = (0..=frames_ahead.min(within)).map(|at| (time + at as f64 * frame).min(1.0)).collect();
        if sampled.rows.is_empty() || times.len() < 2 {
            return None;
        }
        let positions = step.model.get(&format!("{GAUSSIANS}.positions"));
        let canonical = gather(step.tape, positions, &sampled.rows);
        let rows = sampled.rows.clone();
        let points: Vec<MovedPoints> = times.iter().map(|&time| moved(step, base, &rows, canonical, time)).collect();
        if keeps_static {
            let weights = step.tape.constant(sampled.weights.clone());
            return Some(Self { weights, rows, canonical, times, points });
        }
        let threshold = STATIC_THRESHOLD * step.scene.extent;
        let [moving, kept] = moving(step.tape, &points, &sampled.weights, threshold);
        let kept = step.tape.constant(kept);
        step.count_skipped_deferred("physical losses of static Gaussians", kept, sampled.rows.len());
        let weights = step.tape.constant(moving);
        let followed = Self { weights, rows, canonical, times, points };
        match step.tape.device() {
            Device::Cpu => followed.compacted(step.tape),
            Device::Gpu(_) => Some(followed),
        }
    }

    /// Keeps only the rows with a positive weight, which saves all further work on the others; `None` if no row is
    /// left. CPU only, because on a GPU the selection would require a readback.
    fn compacted<T: Real>(self, tape: &mut Tape<T>) -> Option<Self> {
        let weights = tape.value(self.weights).as_slice();
        let kept: Vec<u32> = (0..weights.len() as u32).filter(|&item| weights[item as usize] > T::ZERO).collect();
        if kept.is_empty() {
            return None;
        }
        let of_model = self.rows.row_of_item();
        let rows = RowIndex::new(kept.iter().map(|&item| of_model[item as usize]).collect(), self.rows.rows());
        let index = RowIndex::new(kept, weights.len());
        let mut of_these = |var: Var| gather(tape, var, &index);
        let points = self
            .points
            .iter()
            .map(|at| MovedPoints { positions: of_these(at.positions), hidden: of_these(at.hidden) })
            .collect();
        let [weights, canonical] = [self.weights, self.canonical].map(of_these);
        Some(Self { weights, rows, canonical, times: self.times, points })
    }

    /// Differences xₖ₊₁ − xₖ of positions [M, 3] for k = 0, 1, …: velocities in scene units per frame.
    pub(crate) fn displacements<T: Real>(&self, tape: &mut Tape<T>) -> Vec<Var> {
        let positions: Vec<Var> = self.points.iter().map(|at| at.positions).collect();
        differences(tape, &positions)
    }

    /// Positions [M, 3] at any time; evaluates the field unless the time is one of the instants.
    pub(crate) fn positions_at<T: Real>(&self, step: &mut Step<'_, T>, base: &HexplaneGaussians, time: f64) -> Var {
        let same = SAME_INSTANT * frame_of(step.scene);
        match self.times.iter().position(|instant| (instant - time).abs() <= same) {
            Some(at) => self.points[at].positions,
            None => moved(step, base, &self.rows, self.canonical, time).positions,
        }
    }
}

/// Canonical positions [M, 3] of these rows of the model, moved to a time: seeds by their velocities, then all by the
/// field.
fn moved<T: Real>(
    step: &mut Step<'_, T>,
    base: &HexplaneGaussians,
    rows: &RowIndex,
    canonical: Var,
    time: f64,
) -> MovedPoints {
    let carried = seeds::carried(step.tape, step.model, rows, canonical, time);
    base.move_points(step.tape, step.model, step.scene, carried, time)
}

/// Differences xₖ₊₁ − xₖ of consecutive values.
pub(crate) fn differences<T: Real>(tape: &mut Tape<T>, values: &[Var]) -> Vec<Var> {
    values.windows(2).map(|pair| sub(tape, pair[1], pair[0])).collect()
}

/// [N] mask of compared Gaussians: those that may move (all without flags) and have their centre in the view's moving
/// region (anywhere if that region is unknown).
pub(crate) fn foreground<T: Real>(
    tape: &Tape<T>,
    rendered: &Rendered,
    moving: Option<&LabelMap>,
    may_move: Option<Var>,
) -> Tensor<T> {
    let count = rendered.splats(tape);
    let within = match moving {
        Some(moving) => covered(tape, rendered, moving),
        None => Tensor::full([count], T::ONE),
    };
    let Some(flags) = may_move else { return within };
    let mut child = tape.child();
    let [within, flags] = [within, tape.value(flags).clone()].map(|tensor| child.constant(tensor));
    let flags = reshape(&mut child, flags, [count]);
    let both = mul(&mut child, within, flags);
    child.value(both).clone()
}

/// The weights [M] of rows that move at least `threshold` away from their start at a later instant, 0 for static rows;
/// and the number [1] of rows that are not static.
fn moving<T: Real>(tape: &Tape<T>, points: &[MovedPoints], weights: &Tensor<T>, threshold: f64) -> [Tensor<T>; 2] {
    let mut child = tape.child();
    let weights = child.constant(weights.clone());
    let positions: Vec<Var> = points.iter().map(|at| child.constant(tape.value(at.positions).clone())).collect();
    let rows = child.value(weights).len();
    let mut still = weights;
    for &later in &positions[1..] {
        let displacement = sub(&mut child, later, positions[0]);
        let squared = squared_norm(&mut child, displacement);
        let squared = reshape(&mut child, squared, [rows]);
        still = where_below(&mut child, squared, still, threshold * threshold);
    }
    let moving = sub(&mut child, weights, still);
    let still = total(&mut child, still);
    let others = scale(&mut child, still, -1.0);
    let others = shift(&mut child, others, rows as f64);
    [moving, others].map(|var| child.value(var).clone())
}
