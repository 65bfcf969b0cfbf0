use super::{RowMap, RowWgsl, map_rows};
use crate::tape::{Real, Tape, Var};

/// Positions [N, 3] in the box from `low` to `high` as [−1, 1]: (x − middle) / (half the size), along every axis.
///
/// The middle is subtracted first: far from the origin a product with the factor would cancel its last digits.
pub fn in_unit_box<T: Real>(tape: &mut Tape<T>, positions: Var, low: [T; 3], high: [T; 3]) -> Var {
    let half = T::from_f64(0.5);
    let axis = |axis: usize| [half * (low[axis] + high[axis]), T::ONE / (half * (high[axis] - low[axis]))];
    let numbers = [0, 1, 2].map(|of| axis(of).map(T::to_f64));
    map_rows(
        tape,
        InUnitBox { middle: numbers.map(|[middle, _]| middle), factor: numbers.map(|[_, factor]| factor) },
        [positions],
    )
}

struct InUnitBox {
    middle: [f64; 3],
    factor: [f64; 3],
}

impl RowMap<1> for InUnitBox {
    const NAME: &'static str = "in_unit_box";

    fn output_columns(&self, input_columns: [usize; 1]) -> usize {
        assert_eq!(input_columns, [3], "in_unit_box: positions have three coordinates");
        3
    }

    fn value<T: Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        for (axis, y) in y.iter_mut().enumerate() {
            *y = (x[axis] - T::from_f64(self.middle[axis])) * T::from_f64(self.factor[axis]);
        }
    }

    fn gradient<T: Real>(&self, _inputs: [&[T]; 1], _y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        dx.iter_mut().enumerate().for_each(|(axis, dx)| *dx = dy[axis] * T::from_f64(self.factor[axis]));
    }

    fn wgsl(&self, _input_columns: [usize; 1]) -> Option<RowWgsl> {
        let [middle, factor] = [self.middle, self.factor].map(|values| values.map(|value| value as f32));
        let pad = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
        Some(RowWgsl {
            value: "fn value(row: u32, column: u32) -> f32 {
    return (x0[row * 3u + column] - map.values[0][column]) * map.values[1][column];
}
",
            gradients: "fn gradient_0(row: u32, column: u32) -> f32 {
    return dy[row * 3u + column] * map.values[1][column];
}
",
            specialisation: Vec::new(),
            numbers: [pad(middle), pad(factor)].concat(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arrays::rows::validate_map;
    use crate::check::conformance::{Tolerance, compare};
    use crate::check::{self, noise};
    use crate::gpu::tests::test_gpu;
    use crate::tape::{Device, Tensor};

    const LOW: [f64; 3] = [-1.0, 0.0, 2.0];
    const HIGH: [f64; 3] = [1.0, 4.0, 2.5];

    #[test]
    fn the_box_maps_to_the_unit_cube_with_the_right_gradient() {
        let corners = Tensor::from_vec([3, 3], vec![-1.0, 0.0, 2.0, 1.0, 4.0, 2.5, 0.0, 2.0, 2.25]);
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let positions = tape.constant(corners.clone());
        let mapped = in_unit_box(&mut tape, positions, LOW, HIGH);
        assert_eq!(tape.value(mapped).as_slice(), [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        check::gradients(|tape, vars| in_unit_box(tape, vars[0], LOW, HIGH), &[corners], check::TOLERANCE).unwrap();
    }

    #[test]
    fn a_box_far_from_the_origin_keeps_what_its_coordinates_still_hold() {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let points = tape.constant(Tensor::from_vec([1, 3], vec![9999.5, 10_000.25, 10_001.0]));
        let mapped = in_unit_box(&mut tape, points, [9999.0; 3], [10_001.0; 3]);
        assert_eq!(tape.value(mapped).as_slice(), [-0.5, 0.25, 1.0]);
    }

    #[test]
    fn a_gpu_maps_to_the_same_cube() {
        validate_map(&InUnitBox { middle: [0.0; 3], factor: [1.0; 3] }, [3]);
        let Some(gpu) = test_gpu() else { return };
        for rows in [1, 300] {
            let positions = Tensor::from_vec([rows, 3], noise(3 * rows, 1)).cast::<f32>();
            let tolerance = Tolerance { value: 1e-6, gradient: 1e-6 };
            let map = |tape: &mut Tape<f32>, vars: &[Var]| {
                vec![in_unit_box(tape, vars[0], LOW.map(|x| x as f32), HIGH.map(|x| x as f32))]
            };
            compare(gpu, "the unit box", &[positions], tolerance, map).unwrap();
        }
    }
}
