//! The static mask: Gaussians that reach no moving pixel in any training view skip the motion model.

use shaders::arrays::rows::{RowIndex, concat_rows, gather};
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{HIDDEN_LOGIT, ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::bases::canonical::scales_and_rotations;
use crate::bases::gaussians::GAUSSIANS;
use crate::bases::seeds;
use crate::effects::{Effect, Need};
use crate::method::{Moment, Start, Step};
use crate::model::{ModelState, Variables};
use crate::shared::Shared;

/// The effect, offered by every method whose motion model moves Gaussians one by one.
pub(crate) const SKIP_STILL: Effect = Effect::new(
    "skip-still",
    "Gaussians that reach no moving pixel in any training view skip the motion model",
    &[Need::LayersAtStart, Need::Effect("motion")],
)
.off_by_default();

/// The reach of a Gaussian in standard deviations, √(2·ln 255): beyond it, an opaque one contributes less than 1/255.
const REACH: f64 = 3.33;

/// Flags [N, 1] of the Gaussians that may move (1) or are static (0). They are not trained, and density control copies
/// them to the children of a Gaussian.
pub(crate) const MAY_MOVE: &str = "gaussians.may_move";

/// Adds the flags if the effect is on. A Gaussian may move if it reaches a moving pixel in any training view. Views
/// without a known moving part are ignored; if it is unknown in all views, all Gaussians may move. The effect
/// `seed-from-masks` adds the seeds; with both effects, only the seeds may move.
pub(crate) fn insert<T: Real>(state: &mut ModelState<T>, shared: &Shared, start: &Start<'_>) -> anyhow::Result<()> {
    if shared.has_seeds() {
        let rests = shared.effects.has(SKIP_STILL.name);
        let count = state.get("gaussians.positions")?.rows();
        state.insert(MAY_MOVE, Tensor::full([count, 1], if rests { T::ZERO } else { T::ONE }));
        return seeds::insert(state, shared, start, MAY_MOVE);
    }
    if !shared.effects.has(SKIP_STILL.name) {
        return Ok(());
    }
    let vectors = |attribute: &str| -> anyhow::Result<Vec<[f64; 3]>> {
        let tensor = state.get(&format!("{GAUSSIANS}.{attribute}"))?;
        Ok((0..tensor.rows()).map(|row| [0, 1, 2].map(|axis| tensor.row(row)[axis].to_f64())).collect())
    };
    let positions = vectors("positions")?;
    let radii: Vec<f64> = vectors("log_scales")?
        .iter()
        .map(|scales| REACH * scales.iter().copied().fold(f64::NEG_INFINITY, f64::max).exp())
        .collect();
    let nothing_known = start.supplements.moving.iter().all(Option::is_none);
    let mut may_move = vec![nothing_known; positions.len()];
    for view in &start.dataset.train {
        let Some(moving) = start.supplements.moving(view.index) else { continue };
        let counts = RunningCounts::new(&moving.labels, moving.width as usize);
        for (at, flag) in may_move.iter_mut().enumerate().filter(|(_, flag)| !**flag) {
            *flag = footprint(&view.camera, positions[at], radii[at]).is_some_and(|square| counts.any_in(square));
        }
    }
    let values = may_move.iter().map(|&flag| T::from_f64(f64::from(u8::from(flag)))).collect();
    state.insert(MAY_MOVE, Tensor::from_vec([positions.len(), 1], values));
    Ok(())
}

/// Counts the Gaussians that skip the motion model, once per view of a step.
pub(crate) fn count_skipped<T: Real>(step: &mut Step<'_, T>) {
    let Some(flags) = step.model.find(MAY_MOVE) else { return };
    let flags = step.tape.value(flags);
    let still = flags.as_slice().iter().filter(|&&flag| flag == T::ZERO).count();
    let (views, all) = (step.views.len(), flags.rows());
    step.count_skipped("motion of static Gaussians", views * still, views * all);
}

/// Moves the canonical Gaussians that may move by `motion`, which receives their rows (`None`: all). Seeds have moved
/// with their velocities before; those of other times are hidden.
pub(crate) fn move_some<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    moment: &Moment<'_>,
    canonical: SplatVars,
    motion: impl FnOnce(&mut Tape<T>, SplatVars, Option<&RowIndex>) -> SplatVars,
) -> SplatVars {
    let Some(flags) = model.find(MAY_MOVE) else { return motion(tape, canonical, None) };
    let seeds = seeds::shown(tape, model, moment);
    let is_absent = |row: usize| seeds.as_ref().is_some_and(|seeds| seeds.is_absent(row));
    let flags = tape.value(flags).as_slice();
    let all = flags.len();
    let moves = |row: &usize| flags[*row] > T::ZERO && !is_absent(*row);
    let rows: Vec<u32> = (0..all).filter(moves).map(|row| row as u32).collect();
    let absent: Vec<u32> = (0..all).filter(|&row| is_absent(row)).map(|row| row as u32).collect();
    let canonical = hidden(tape, canonical, &absent);
    if rows.is_empty() {
        return canonical;
    }
    let merged = replaced_by(&rows, all);
    let rows = RowIndex::new(rows, all);

    let some = map(canonical, |var| gather(tape, var, &rows));
    let mut present = some;
    if let Some(seeds) = seeds {
        [present.positions, present.opacity_logits] =
            seeds.moved(tape, model, &rows, [some.positions, some.opacity_logits]);
    }
    let moved = motion(tape, present, Some(&rows));
    let mut attributes = attributes(moved).into_iter().zip(attributes(some));
    map(canonical, |var| match attributes.next().expect("as many attributes") {
        (moved, before) if moved == before => var,
        (moved, _) => {
            let both = concat_rows(tape, &[var, moved]);
            gather(tape, both, &merged)
        }
    })
}

/// The index of each of `all` rows in all rows followed by new values of `rows`.
fn replaced_by(rows: &[u32], all: usize) -> RowIndex {
    let mut place: Vec<u32> = (0..all as u32).collect();
    rows.iter().enumerate().for_each(|(at, &row)| place[row as usize] = (all + at) as u32);
    RowIndex::new(place, all + rows.len())
}

/// Splats of which some rows are hidden.
fn hidden<T: Real>(tape: &mut Tape<T>, splats: SplatVars, rows: &[u32]) -> SplatVars {
    if rows.is_empty() {
        return splats;
    }
    let nothing = tape.constant(Tensor::full([rows.len(), 1], T::from_f64(HIDDEN_LOGIT)));
    let index = replaced_by(rows, tape.value(splats.opacity_logits).rows());
    let both = concat_rows(tape, &[splats.opacity_logits, nothing]);
    SplatVars { opacity_logits: gather(tape, both, &index), ..splats }
}

/// Every attribute, in the order of [`map`].
fn attributes(splats: SplatVars) -> [Var; 5] {
    let (log_scales, rotations) = scales_and_rotations(&splats);
    [splats.positions, log_scales, rotations, splats.opacity_logits, splats.sh]
}

/// Splats with every attribute mapped.
fn map(splats: SplatVars, f: impl FnMut(Var) -> Var) -> SplatVars {
    let [positions, log_scales, rotations, opacity_logits, sh] = attributes(splats).map(f);
    SplatVars { positions, shape: ShapeVars::ScaleRotation { log_scales, rotations }, opacity_logits, sh }
}

/// The bounding box [x₀, x₁, y₀, y₁] (inclusive, px) of a ball in the image; `None` for a ball behind the camera.
fn footprint(camera: &PinholeCamera, center_world: [f64; 3], radius: f64) -> Option<[f64; 4]> {
    let ([u, v, z], [focal_x, focal_y]) = (camera.project(center_world), camera.focal);
    let (reach_x, reach_y) = (focal_x * radius / z, focal_y * radius / z);
    (z > 0.0).then_some([u - reach_x, u + reach_x, v - reach_y, v + reach_y])
}

/// A summed-area table of the nonzero pixels of a map, which counts those of any rectangle in constant time.
struct RunningCounts {
    width: usize,
    height: usize,
    /// Counts [height + 1, width + 1].
    counts: Vec<u32>,
}

impl RunningCounts {
    fn new(labels: &[u8], width: usize) -> Self {
        let height = labels.len() / width.max(1);
        let mut counts = vec![0; (width + 1) * (height + 1)];
        for y in 0..height {
            let mut in_row = 0;
            for x in 0..width {
                in_row += u32::from(labels[y * width + x] != 0);
                counts[(y + 1) * (width + 1) + x + 1] = counts[y * (width + 1) + x + 1] + in_row;
            }
        }
        Self { width, height, counts }
    }

    /// Whether any pixel of a footprint is nonzero.
    fn any_in(&self, [x0, x1, y0, y1]: [f64; 4]) -> bool {
        if !(x1 >= 0.0 && y1 >= 0.0 && x0 < self.width as f64 && y0 < self.height as f64) {
            return false;
        }
        // Pixel i covers [i, i + 1); casts of values outside the integer range saturate.
        let (x0, y0) = (x0 as usize, y0 as usize);
        let (x1, y1) = ((x1 as usize).min(self.width - 1) + 1, (y1 as usize).min(self.height - 1) + 1);
        let at = |x: usize, y: usize| self.counts[y * (self.width + 1) + x];
        at(x1, y1) + at(x0, y0) > at(x0, y1) + at(x1, y0)
    }
}

#[cfg(test)]
mod tests {
    use scene::{LabelMap, PointCloud};
    use shaders::check::noise;
    use shaders::pointwise::scale;
    use shaders::tape::Device;

    use super::*;
    use crate::bases::gaussians::insert_gaussians;
    use crate::data::{Dataset, Supplements};
    use crate::scene_tests::{TestScene, moment};

    #[test]
    fn gaussians_may_move_where_some_view_shows_motion() {
        let dir = tempfile::tempdir().unwrap();
        let dataset = Dataset::load(TestScene { size: 16, ..TestScene::default() }.write(dir.path()), 1).unwrap();
        let points = PointCloud::random_in([[-0.3; 3], [0.3; 3]], 40, 1);
        let moving_with = |labels: Option<Vec<u8>>| {
            let first = dataset.train[0].index;
            let mut supplements = Supplements { moving: vec![None; first + 1], ..Supplements::default() };
            supplements.moving[first] = labels.map(|labels| LabelMap { width: 16, height: 16, labels });
            let mut state = ModelState::<f64>::new();
            insert_gaussians(&mut state, GAUSSIANS, &points, 0, &dataset.scene);
            state.insert("gaussians.log_scales", Tensor::full([40, 3], 0.001_f64.ln()));
            insert(&mut state, &Shared::default(), &Start { dataset: &dataset, supplements: &supplements }).unwrap();
            state.get(MAY_MOVE).unwrap().as_slice().iter().filter(|&&flag| flag == 1.0).count()
        };
        let left_half = (0..256).map(|pixel| u8::from(pixel % 16 < 8)).collect();
        let some = moving_with(Some(left_half));
        assert!(some > 0 && some < 40, "{some}");
        assert_eq!([moving_with(Some(vec![0; 256])), moving_with(Some(vec![1; 256])), moving_with(None)], [0, 40, 40]);
    }

    fn canonical(tape: &mut Tape<f64>) -> SplatVars {
        let mut leaf = |columns: usize, seed| tape.leaf(Tensor::from_vec([5, columns], noise(5 * columns, seed)));
        let (log_scales, rotations) = (leaf(3, 2), leaf(4, 3));
        SplatVars {
            positions: leaf(3, 1),
            shape: ShapeVars::ScaleRotation { log_scales, rotations },
            opacity_logits: leaf(1, 4),
            sh: leaf(3, 5),
        }
    }

    fn flagged(tape: &mut Tape<f64>, flags: [f64; 5]) -> Variables {
        let flags = tape.constant(Tensor::from_vec([5, 1], flags.to_vec()));
        Variables::new([(MAY_MOVE.into(), flags)].into())
    }

    #[test]
    fn only_unmasked_gaussians_move_and_all_get_gradients() {
        let mut tape = Tape::new(Device::Cpu);
        let before = canonical(&mut tape);
        let model = flagged(&mut tape, [0.0, 1.0, 0.0, 1.0, 1.0]);
        let after = move_some(&mut tape, &model, &moment(0.5, "all"), before, |tape, some, rows| {
            assert_eq!(rows.unwrap().row_of_item(), [1, 3, 4]);
            assert_eq!(tape.value(some.positions).rows(), 3);
            SplatVars { positions: scale(tape, some.positions, 10.0), ..some }
        });
        assert_eq!((after.opacity_logits, after.sh), (before.opacity_logits, before.sh), "unchanged, so not copied");
        for row in 0..5 {
            let factor = [1.0, 10.0, 1.0, 10.0, 10.0][row];
            let expected: Vec<f64> = tape.value(before.positions).row(row).iter().map(|x| factor * x).collect();
            assert_eq!(tape.value(after.positions).row(row), expected);
        }
        let seed = Tensor::full([5, 3], 1.0);
        let gradient = tape.backward(&[(after.positions, seed)]).take(before.positions).unwrap();
        assert_eq!(gradient.as_slice().chunks(3).map(|row| row[0]).collect::<Vec<_>>(), [1.0, 10.0, 1.0, 10.0, 10.0]);
    }

    #[test]
    fn a_fully_static_scene_skips_the_motion_model() {
        let mut tape = Tape::new(Device::Cpu);
        let before = canonical(&mut tape);
        let model = flagged(&mut tape, [0.0; 5]);
        let after = move_some(&mut tape, &model, &moment(0.5, "all"), before, |_, _, _| panic!("nothing moves"));
        assert_eq!(after.positions, before.positions);
        let unknown = Variables::new(std::collections::BTreeMap::new());
        let all = move_some(&mut tape, &unknown, &moment(0.5, "all"), before, |_, all, rows| {
            assert!(rows.is_none());
            all
        });
        assert_eq!(all.positions, before.positions);
    }

    #[test]
    fn a_rectangle_holds_a_pixel_or_not() {
        let mut labels = vec![0; 12];
        labels[6] = 7; // (2, 1) of 4×3
        let counts = RunningCounts::new(&labels, 4);
        for (square, any) in [
            ([2.0, 2.9, 1.0, 1.9], true),
            ([-5.0, 50.0, -5.0, f64::INFINITY], true),
            ([3.0, 3.5, 0.0, 2.0], false),
            ([0.0, 1.99, 0.0, 2.0], false),
            ([4.0, 9.0, 0.0, 2.0], false),
            ([f64::NAN, f64::NAN, 0.0, 2.0], false),
        ] {
            assert_eq!(counts.any_in(square), any, "{square:?}");
        }
    }
}
