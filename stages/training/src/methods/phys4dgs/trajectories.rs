//! Gaussians followed over a few frames.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use scene::LabelMap;
use shaders::pointwise::sub;
use shaders::rows::{RowIndex, gather};
use shaders::splat::Rendered;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::bases::gaussians::GAUSSIANS;
use crate::bases::hexplane::{HexplaneGaussians, MovedPoints};
use crate::method::{SceneFacts, Step};

/// A Gaussian that moves less than this share of the scene's extent within the frames that are looked at stands still.
pub const STANDS_STILL: f64 = 1e-4;

/// Up to this share of a frame, two instants are one, and an instant after the end is the end.
const SAME_INSTANT: f64 = 1e-3;

/// The length that motion within a frame is measured in: what moves by the scene's extent while the capture lasts moves by
/// one unit per frame. It does not depend on how the model moves: divided by its own motion, losses of differences would
/// pull the harder the less moves, and end all motion.
pub fn motion_unit(scene: &SceneFacts) -> f64 {
    scene.extent * frame_of(scene)
}

/// M Gaussians at a time and a few frames after it.
pub struct Trajectories {
    /// M, at least 1.
    pub count: usize,
    /// [M, 3]: where the Gaussians are in the canonical space.
    canonical: Var,
    /// In [0, 1], one frame apart.
    times: Vec<f64>,
    /// The Gaussians at these times.
    pub points: Vec<MovedPoints>,
}

/// One frame in normalised time; infinite for a single instant.
pub fn frame_of(scene: &SceneFacts) -> f64 {
    scene.time_map.frame_secs / (scene.time_map.end_secs - scene.time_map.start_secs)
}

impl Trajectories {
    /// Follows the Gaussians in `rows` from `time` over at most `frames_ahead` frames that lie within the capture.
    ///
    /// Those that stand still are left out and counted; `None` if nothing is left to compare.
    pub fn follow<T: Real>(
        step: &mut Step<'_, T>,
        base: &HexplaneGaussians,
        rows: Vec<u32>,
        time: f64,
        frames_ahead: usize,
    ) -> Option<Self> {
        let frame = frame_of(step.scene);
        let within = ((1.0 - time) / frame + SAME_INSTANT).max(0.0) as usize;
        let times: Vec<f64> = (0..=frames_ahead.min(within)).map(|at| (time + at as f64 * frame).min(1.0)).collect();
        if rows.is_empty() || times.len() < 2 {
            return None;
        }
        let (sampled, positions) = (rows.len(), step.model.get(&format!("{GAUSSIANS}.positions")));
        let index = RowIndex::new(rows, step.tape.value(positions).rows());
        let canonical = gather(step.tape, positions, &index);
        let points: Vec<MovedPoints> =
            times.iter().map(|&time| base.move_points(step.tape, step.model, step.scene, canonical, time)).collect();
        let moving = moving_rows(step.tape, &points, STANDS_STILL * step.scene.extent);
        step.count_skipped("physical losses of Gaussians that stand still", sampled - moving.len(), sampled);
        if moving.is_empty() {
            return None;
        }
        let count = moving.len();
        let index = RowIndex::new(moving, sampled);
        let mut of_moving = |var: Var| gather(step.tape, var, &index);
        let canonical = of_moving(canonical);
        let points: Vec<MovedPoints> = points
            .iter()
            .map(|at| MovedPoints { positions: of_moving(at.positions), hidden: of_moving(at.hidden) })
            .collect();
        Some(Self { count, canonical, times, points })
    }

    /// xₖ₊₁ − xₖ [M, 3], for k = 0, 1, …: velocities in scene units per frame.
    pub fn displacements<T: Real>(&self, tape: &mut Tape<T>) -> Vec<Var> {
        let positions: Vec<Var> = self.points.iter().map(|at| at.positions).collect();
        differences(tape, &positions)
    }

    /// Positions [M, 3] at any time, evaluated unless that is one of the instants.
    pub fn positions_at<T: Real>(&self, step: &mut Step<'_, T>, base: &HexplaneGaussians, time: f64) -> Var {
        let same = SAME_INSTANT * frame_of(step.scene);
        match self.times.iter().position(|instant| (instant - time).abs() <= same) {
            Some(at) => self.points[at].positions,
            None => base.move_points(step.tape, step.model, step.scene, self.canonical, time).positions,
        }
    }
}

/// xₖ₊₁ − xₖ.
pub fn differences<T: Real>(tape: &mut Tape<T>, values: &[Var]) -> Vec<Var> {
    values.windows(2).map(|pair| sub(tape, pair[1], pair[0])).collect()
}

/// Gaussians that may belong to what moves: where the moving part of the view is known, those whose centre it covers;
/// else all.
pub fn foreground<T: Real>(tape: &Tape<T>, rendered: &Rendered, moving: Option<&LabelMap>) -> Vec<u32> {
    let means_px = tape.value(rendered.means2d).as_slice().as_chunks::<2>().0;
    let count = means_px.len() as u32;
    let Some(moving) = moving else { return (0..count).collect() };
    let visible = rendered.visible();
    let is_covered = |&row: &u32| {
        let [x, y] = means_px[row as usize].map(|coordinate| coordinate.to_f64().floor());
        let within = x >= 0.0 && y >= 0.0 && x < f64::from(moving.width) && y < f64::from(moving.height);
        visible[row as usize] && within && moving.labels[y as usize * moving.width as usize + x as usize] != 0
    };
    (0..count).filter(is_covered).collect()
}

/// A share of the rows, at least one and at most `most`, drawn without replacement; in ascending order.
pub fn sample(mut rows: Vec<u32>, share: f64, most: usize, random: &mut ChaCha8Rng) -> Vec<u32> {
    let count = ((share * rows.len() as f64).ceil() as usize).min(most).min(rows.len());
    for at in 0..count {
        let chosen = random.random_range(at..rows.len());
        rows.swap(at, chosen);
    }
    rows.truncate(count);
    rows.sort_unstable();
    rows
}

/// Rows that are at least `threshold` away from where they start, at one of the later instants.
fn moving_rows<T: Real>(tape: &Tape<T>, points: &[MovedPoints], threshold: f64) -> Vec<u32> {
    let positions: Vec<&Tensor<T>> = points.iter().map(|at| tape.value(at.positions)).collect();
    let moves = |row: &u32| {
        let first = positions[0].row(*row as usize);
        // Written so that a NaN counts as moving and is found where it arose.
        positions[1..].iter().any(|later| !(squared_distance(first, later.row(*row as usize)) < threshold * threshold))
    };
    (0..positions[0].rows() as u32).filter(moves).collect()
}

fn squared_distance<T: Real>(a: &[T], b: &[T]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| (a - b).to_f64().powi(2)).sum()
}
