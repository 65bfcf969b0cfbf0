//! The box of a scene. Networks read coordinates relative to it, so the origin and the unit of the world do not matter.

use shaders::arrays::rows::in_unit_box;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::model::{ModelState, Variables};

/// Minimum thickness of a box, as a share of its longest side, so that a planar cloud causes no division by zero.
const MIN_SIDE: f64 = 1e-3;
/// Minimum thickness of a box in steps of f32 at its farthest coordinate, so that the stored corners differ.
const MIN_STEPS: f64 = 8.0;
/// Half a side of a uniform distribution in median absolute deviations: half of the points lie within half of the side.
const HALF_SIDE_IN_DEVIATIONS: f64 = 2.0;

/// A box in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    /// Smallest corner.
    pub low: [f64; 3],
    /// Largest corner.
    pub high: [f64; 3],
}

impl Bounds {
    /// The smallest box around positions (at least one), with some thickness along every axis.
    pub(crate) fn enclosing(positions: &[[f32; 3]]) -> Self {
        let low = along(positions, |values| values.into_iter().fold(f64::INFINITY, f64::min));
        let high = along(positions, |values| values.into_iter().fold(f64::NEG_INFINITY, f64::max));
        let longest = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
        let thinnest = (MIN_SIDE * longest).max(min_thickness(&[low, high].concat()));
        let margin = |axis: usize| 0.5 * (thinnest - (high[axis] - low[axis])).max(0.0);
        Self {
            low: std::array::from_fn(|axis| low[axis] - margin(axis)),
            high: std::array::from_fn(|axis| high[axis] + margin(axis)),
        }
    }

    /// The cube that uniformly distributed positions (at least one) would fill. Outliers, frequent in clouds of
    /// structure from motion, do not enlarge it.
    pub(crate) fn typical_cube(positions: &[[f32; 3]]) -> Self {
        let center = along(positions, median);
        let deviations: Vec<[f32; 3]> = positions
            .iter()
            .map(|point| std::array::from_fn(|axis| (f64::from(point[axis]) - center[axis]).abs() as f32))
            .collect();
        let widest = along(&deviations, median).into_iter().fold(0.0, f64::max);
        // If most points coincide, the remaining ones determine the size.
        let half = match HALF_SIDE_IN_DEVIATIONS * widest {
            0.0 => along(&deviations, |values| values.into_iter().fold(0.0, f64::max)).into_iter().fold(0.0, f64::max),
            half => half,
        };
        let half = if half > 0.0 { half } else { 1.0 };
        let half = half.max(min_thickness(&center));
        Self { low: center.map(|value| value - half), high: center.map(|value| value + half) }
    }

    /// Adds the box to the model as `{name}.bounds` ([2, 3]; not trained).
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, name: &str) {
        let values = [self.low, self.high].concat().into_iter().map(T::from_f64).collect();
        state.insert(tensor_name(name), Tensor::from_vec([2, 3], values));
    }
}

/// The minimum thickness of a box with these coordinates.
fn min_thickness(coordinates: &[f64]) -> f64 {
    MIN_STEPS * f64::from(f32::EPSILON) * coordinates.iter().fold(1.0, |most: f64, value| most.max(value.abs()))
}

/// The tensor name of the box `name`.
pub(crate) fn tensor_name(name: &str) -> String {
    format!("{name}.bounds")
}

/// Maps world positions [N, 3] in the box `name` to [−1, 1].
pub(crate) fn inside<T: Real>(tape: &mut Tape<T>, model: &Variables, name: &str, positions: Var) -> Var {
    let bounds = tape.value(model.get(&tensor_name(name)));
    let side = |side: usize| bounds.as_slice().as_chunks::<3>().0[side];
    let [low, high] = [side(0), side(1)];
    in_unit_box(tape, positions, low, high)
}

/// Half the first side of the box `name`: the world length of a unit of [`inside`], for a cube.
pub(crate) fn half_side<T: Real>(tape: &Tape<T>, model: &Variables, name: &str) -> f64 {
    let bounds = tape.value(model.get(&tensor_name(name)));
    0.5 * (bounds.row(1)[0].to_f64() - bounds.row(0)[0].to_f64())
}

/// Applies a function to the values along each axis.
fn along(positions: &[[f32; 3]], reduce: impl Fn(Vec<f64>) -> f64) -> [f64; 3] {
    std::array::from_fn(|axis| reduce(positions.iter().map(|point| f64::from(point[axis])).collect()))
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_clouds_and_single_points_have_boxes_with_volume() {
        let flat = |at: f32| vec![[at, at, at], [at + 2.0, at + 1.0, at]];
        for positions in [flat(5.0), flat(3e4), vec![[3.0; 3]], vec![[3e8; 3]]] {
            for bounds in [Bounds::enclosing(&positions), Bounds::typical_cube(&positions)] {
                let mut stored = ModelState::<f32>::new();
                bounds.insert(&mut stored, "box");
                let corners = stored.get("box.bounds").unwrap();
                let [low, high] = [0, 1].map(|corner| corners.row(corner));
                assert!((0..3).all(|axis| high[axis] > low[axis]), "{low:?} {high:?}");
            }
        }
    }

    #[test]
    fn points_far_off_do_not_widen_the_typical_cube() {
        let mut positions: Vec<[f32; 3]> =
            (0..=100).map(|at| [10.0 + 0.02 * at as f32, 0.01 * at as f32, 0.0]).collect();
        let even = Bounds::typical_cube(&positions);
        assert!((even.low[0] - 10.0).abs() <= 0.03 && (even.high[0] - 12.0).abs() <= 0.03, "{even:?}");
        positions.extend([[1e4; 3]; 3]);
        let with_outliers = Bounds::typical_cube(&positions);
        assert!((with_outliers.high[0] - even.high[0]).abs() <= 0.1, "{with_outliers:?}");
        assert_eq!(Bounds::enclosing(&positions).high, [1e4; 3]);
    }
}
