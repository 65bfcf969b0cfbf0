//! The points that are in view of a camera.

use super::{PinholeCamera, PointsInImage, project_points};
use crate::arrays::rows::{RowMap, RowWgsl, map_rows};
use crate::tape::{Real, Tape, Var};

/// The least view depth of a point in front of a camera, scene units: any positive number.
const NEAREST: f64 = f32::MIN_POSITIVE as f64;

/// [N, 1]: 1 for points [N, 3] in front of the camera that project into its image, otherwise 0; without a gradient.
pub fn in_view<T: Real>(tape: &mut Tape<T>, points_world: Var, camera: &PinholeCamera) -> Var {
    let PointsInImage { pixels, .. } = project_points(tape, points_world, camera, NEAREST);
    map_rows(tape, InImage { size_px: [camera.width, camera.height] }, [pixels])
}

/// Whether pixel positions [N, 2] are within an image.
struct InImage {
    size_px: [usize; 2],
}

impl RowMap<1> for InImage {
    const NAME: &'static str = "in_image";

    fn output_columns(&self, input_columns: [usize; 1]) -> usize {
        assert_eq!(input_columns, [2], "in_image: a position has two coordinates");
        1
    }

    fn value<T: Real>(&self, [pixel]: [&[T]; 1], y: &mut [T]) {
        let is_within = |axis: usize| pixel[axis] >= T::ZERO && pixel[axis] < T::from_f64(self.size_px[axis] as f64);
        y[0] = if is_within(0) && is_within(1) { T::ONE } else { T::ZERO };
    }

    fn gradient<T: Real>(&self, _inputs: [&[T]; 1], _y: &[T], _dy: &[T], _gradients: [&mut [T]; 1]) {}

    fn wgsl(&self, _input_columns: [usize; 1]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: "fn value(row: u32, column: u32) -> f32 {
    let pixel = vec2<f32>(x0[2u * row], x0[2u * row + 1u]);
    return select(0.0, 1.0, all(pixel >= vec2<f32>(0.0)) && all(pixel < map.values[0].xy));
}
",
            gradients: "fn gradient_0(row: u32, column: u32) -> f32 {
    return 0.0;
}
",
            specialisation: Vec::new(),
            numbers: self.size_px.map(|size| size as f32).to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arrays::rows::validate_map;
    use crate::check::conformance::{Disagreement, Tolerance, compare};
    use crate::check::{agree, noise};
    use crate::gpu::tests::test_gpu;
    use crate::tape::{Device, Tensor};

    /// Looks along z from z = −5, half as far to the side as ahead.
    fn camera() -> PinholeCamera {
        PinholeCamera {
            width: 20,
            height: 10,
            focal: [20.0, 10.0],
            center: [10.0, 5.0],
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0, 0.0, 5.0],
        }
    }

    #[test]
    fn a_camera_looks_at_what_is_ahead_and_within_its_image() {
        let cases = [
            ([0.0, 0.0, 0.0], 1.0),
            ([2.49, 2.49, 0.0], 1.0),
            ([2.5, 0.0, 0.0], 0.0),
            ([-2.5, 0.0, 0.0], 1.0),
            ([-2.51, 0.0, 0.0], 0.0),
            ([0.0, 2.5, 0.0], 0.0),
            ([0.0, 0.0, -5.0], 0.0),
            ([0.0, 0.0, -20.0], 0.0),
            ([f64::NAN, 0.0, 0.0], 0.0),
        ];
        let points = Tensor::from_vec([cases.len(), 3], cases.iter().flat_map(|(point, _)| *point).collect());
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let points = tape.leaf(points);
        let seen = in_view(&mut tape, points, &camera());
        let expected: Vec<f64> = cases.iter().map(|(_, seen)| *seen).collect();
        assert_eq!((tape.value(seen).shape(), tape.value(seen).as_slice()), (&[cases.len(), 1][..], &expected[..]));
        let gradient = tape.backward(&[(seen, Tensor::full([cases.len(), 1], 1.0))]).take(points).unwrap();
        agree(&gradient, &Tensor::<f64>::zeros([cases.len(), 3]), 0.0).unwrap();
    }

    fn compare_views(count: usize) -> Result<usize, Disagreement> {
        let Some(gpu) = test_gpu() else { return Ok(0) };
        let points = Tensor::from_vec([count, 3], noise(3 * count, 3).iter().map(|x| 8.0 * x).collect());
        let look = |tape: &mut Tape<f32>, vars: &[Var]| vec![in_view(tape, vars[0], &camera())];
        compare(gpu, "points in view", &[points.cast()], Tolerance { value: 0.0, gradient: 0.0 }, look)
    }

    #[test]
    fn a_gpu_looks_at_the_same_points() {
        validate_map(&InImage { size_px: [20, 10] }, [2]);
        for count in [0, 1, 255, 300] {
            compare_views(count).unwrap_or_else(|error| panic!("{error}"));
        }
    }
}
