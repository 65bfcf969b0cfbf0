//! The box of a scene without the outliers of its points.

/// Share of the points on either side of a box that may be outliers.
const OUTLIERS: f64 = 0.005;

/// The box around the points (at least one) without the 0.5 % with the least and the 0.5 % with the greatest coordinate
/// along each axis: its least and greatest corner. Fewer than 200 points have no outliers.
pub fn inner_box(points_world: impl Iterator<Item = [f64; 3]> + Clone) -> [[f64; 3]; 2] {
    let sides: [[f64; 2]; 3] = std::array::from_fn(|axis| {
        let mut values: Vec<f64> = points_world.clone().map(|point| point[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        let skipped = (OUTLIERS * values.len() as f64) as usize;
        [values[skipped], values[values.len() - 1 - skipped]]
    });
    [0, 1].map(|corner| sides.map(|side| side[corner]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_point_in_two_hundred_is_left_out_on_each_side() {
        let line = |count: usize| (0..count).map(|at| [at as f64, -(at as f64), 3.0]);
        assert_eq!(inner_box(line(199)), [[0.0, -198.0, 3.0], [198.0, 0.0, 3.0]]);
        assert_eq!(inner_box(line(400)), [[2.0, -397.0, 3.0], [397.0, -2.0, 3.0]]);
        assert_eq!(inner_box(line(1)), [[0.0, 0.0, 3.0]; 2]);
    }
}
