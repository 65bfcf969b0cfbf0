//! The box of a scene. Networks read coordinates relative to it, so the origin and the unit of the world do not matter.

use scene::inner_box;
use scene::statistics::median;
use shaders::arrays::rows::in_unit_box;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::model::{ModelState, Variables};

/// Minimum thickness of a box, as a share of its longest side, so that a planar cloud causes no division by zero.
const MIN_SIDE: f64 = 1e-3;
/// Minimum thickness of a box in steps of f32 at its farthest coordinate, so that the stored corners differ.
const MIN_STEPS: f64 = 8.0;
/// Factor by which a side of the box around all points may exceed that of the box without outliers.
const MAX_EXCESS: f64 = 3.0;
/// Margin around a box without outliers, as a share of its longest side: surfaces extend beyond the points on them.
const MARGIN: f64 = 0.1;
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
    /// The smallest box around positions (at least one), with a minimum thickness along every axis. It is cut along
    /// axes on which outliers would make it too large, because the texels of a field are spread evenly over it.
    pub(crate) fn around(positions: &[[f32; 3]]) -> Self {
        let low = along(positions, |values| values.into_iter().fold(f64::INFINITY, f64::min));
        let high = along(positions, |values| values.into_iter().fold(f64::NEG_INFINITY, f64::max));
        let [low, high] = without_outliers([low, high], inner_box(positions.iter().map(|point| point.map(f64::from))));
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
        let middle = |values: Vec<f64>| median(values.into_iter()).expect("at least one position");
        let center = along(positions, middle);
        let deviations: Vec<[f32; 3]> = positions
            .iter()
            .map(|point| std::array::from_fn(|axis| (f64::from(point[axis]) - center[axis]).abs() as f32))
            .collect();
        let widest = along(&deviations, middle).into_iter().fold(0.0, f64::max);
        // If most points coincide, the remaining ones determine the size.
        let half = match HALF_SIDE_IN_DEVIATIONS * widest {
            0.0 => along(&deviations, |values| values.into_iter().fold(0.0, f64::max)).into_iter().fold(0.0, f64::max),
            half => half,
        };
        let half = if half > 0.0 { half } else { 1.0 };
        let half = half.max(min_thickness(&center));
        Self { low: center.map(|value| value - half), high: center.map(|value| value + half) }
    }

    /// The smallest box around both.
    pub(crate) fn joined(&self, other: &Self) -> Self {
        Self {
            low: std::array::from_fn(|axis| self.low[axis].min(other.low[axis])),
            high: std::array::from_fn(|axis| self.high[axis].max(other.high[axis])),
        }
    }

    /// The box of this name in a model.
    pub(crate) fn stored<T: Real>(state: &ModelState<T>, name: &str) -> anyhow::Result<Self> {
        let corners = state.get(&tensor_name(name))?;
        let corner = |row: usize| std::array::from_fn(|axis| corners.row(row)[axis].to_f64());
        Ok(Self { low: corner(0), high: corner(1) })
    }

    /// Adds the box to the model as `{name}.bounds` ([2, 3]; not trained).
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, name: &str) {
        let values = [self.low, self.high].concat().into_iter().map(T::from_f64).collect();
        state.insert(tensor_name(name), Tensor::from_vec([2, 3], values));
    }
}

/// The box `whole` around all points, cut along some axes to `inner`, the box without outliers, plus a margin. An axis
/// is cut if `whole` is more than [`MAX_EXCESS`] times as long as `inner` on it, and longer than the longest side of
/// `inner`: a few points above a flat floor are not outliers.
fn without_outliers([low, high]: [[f64; 3]; 2], [inner_low, inner_high]: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
    let side = |axis: usize| inner_high[axis] - inner_low[axis];
    let longest = (0..3).map(side).fold(0.0, f64::max);
    // If most points coincide, the remaining ones determine the size.
    let is_cut = |axis: usize| longest > 0.0 && high[axis] - low[axis] > longest.max(MAX_EXCESS * side(axis));
    let margin = MARGIN * longest;
    let cut = |axis: usize, end: f64, limited: f64| if is_cut(axis) { limited } else { end };
    [
        std::array::from_fn(|axis| cut(axis, low[axis], low[axis].max(inner_low[axis] - margin))),
        std::array::from_fn(|axis| cut(axis, high[axis], high[axis].min(inner_high[axis] + margin))),
    ]
}

/// The minimum thickness of a box with these coordinates, relative to the largest: small scenes have thin boxes.
fn min_thickness(coordinates: &[f64]) -> f64 {
    let largest = coordinates.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    MIN_STEPS * f64::from(f32::EPSILON) * if largest > 0.0 { largest } else { 1.0 }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_clouds_and_single_points_have_boxes_with_volume() {
        let flat = |at: f32| vec![[at, at, at], [at + 2.0, at + 1.0, at]];
        for positions in [flat(5.0), flat(3e4), vec![[3.0; 3]], vec![[3e8; 3]], vec![[1e-9; 3]], vec![[0.0; 3]]] {
            for bounds in [Bounds::around(&positions), Bounds::typical_cube(&positions)] {
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
    }

    /// A cuboid of 1000 points with these sides.
    fn cuboid(sides: [f32; 3]) -> Vec<[f32; 3]> {
        let at = |index: usize| [index % 10, index / 10 % 10, index / 100].map(|step| step as f32 / 9.0);
        (0..1000).map(|index| std::array::from_fn(|axis| sides[axis] * at(index)[axis])).collect()
    }

    #[test]
    fn a_few_points_far_off_do_not_enlarge_the_box() {
        let even = cuboid([1.0, 2.0, 4.0]);
        assert_eq!(Bounds::around(&even), Bounds { low: [0.0; 3], high: [1.0, 2.0, 4.0] });
        for far in [100.0, 1e4, 1e30] {
            let mut positions = even.clone();
            positions.extend([[far; 3], [-far, 0.0, 0.0]]);
            let Bounds { low, high } = Bounds::around(&positions);
            for axis in 0..3 {
                let side = [1.0, 2.0, 4.0][axis];
                assert!((-0.4 - 1e-6..=0.0).contains(&low[axis]) && high[axis] >= side, "{low:?} {high:?}");
                assert!(high[axis] <= side + 0.4 + 1e-6, "{low:?} {high:?}");
            }
        }
    }

    #[test]
    fn points_that_are_not_far_off_stay_in_the_box() {
        // The only points above a flat floor, and points less than three sides away.
        for (sides, lone) in [([2.0, 2.0, 0.0], [1.0, 1.0, 0.5]), ([1.0, 2.0, 4.0], [2.5, -2.0, 9.0])] {
            let mut positions = cuboid(sides);
            positions.push(lone);
            let Bounds { low, high } = Bounds::around(&positions);
            let holds = |axis: usize| low[axis] <= f64::from(lone[axis]) && f64::from(lone[axis]) <= high[axis];
            assert!((0..3).all(holds), "{low:?} {high:?} without {lone:?}");
        }
    }

    #[test]
    fn boxes_do_not_depend_on_the_unit_of_length() {
        for sides in [[1.0, 2.0, 4.0], [1.0, 1.0, 0.0]] {
            let expected = Bounds::around(&cuboid(sides));
            let small = 2.0_f32.powi(-40);
            let found = Bounds::around(&cuboid(sides.map(|side| small * side)));
            let scaled = |corner: [f64; 3]| corner.map(|value| f64::from(small) * value);
            assert_eq!(found, Bounds { low: scaled(expected.low), high: scaled(expected.high) });
        }
    }
}
