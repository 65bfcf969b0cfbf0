use super::shape::{Factor, Shape};
use crate::rows::{RowMap, map_rows, reshape};
use crate::tape::{Real, Tape, Var};

/// F = R_q·diag(eˢ) [N, 3, 3] of logarithms of standard deviations [N, 3] and quaternions [N, 4]: for splats that are
/// drawn together with others whose factor is not of that form.
pub fn factors<T: Real>(tape: &mut Tape<T>, log_scales: Var, rotations: Var) -> Var {
    let count = tape.value(log_scales).rows();
    let rows = map_rows(tape, Factors, [log_scales, rotations]);
    reshape(tape, rows, [count, 3, 3])
}

struct Factors;

impl Factors {
    fn factor<T: Real>([log_scales, rotation]: [&[T]; 2]) -> Option<Factor<T>> {
        let shape = Shape::ScaleRotation {
            log_scales: [0, 1, 2].map(|axis| log_scales[axis]),
            rotation: [0, 1, 2, 3].map(|axis| rotation[axis]),
        };
        Factor::new(&shape)
    }
}

impl RowMap<2> for Factors {
    const NAME: &'static str = "factors";

    fn output_columns(&self, input_columns: [usize; 2]) -> usize {
        assert_eq!(input_columns, [3, 4], "factors: scales have three columns, quaternions four");
        9
    }

    fn value<T: Real>(&self, inputs: [&[T]; 2], y: &mut [T]) {
        match Self::factor(inputs) {
            Some(factor) => y.copy_from_slice(factor.matrix.as_flattened()),
            // Projection culls it, as it culls such scales.
            None => y.fill(T::from_f64(f64::INFINITY)),
        }
    }

    fn gradient<T: Real>(&self, inputs: [&[T]; 2], _y: &[T], dy: &[T], gradients: [&mut [T]; 2]) {
        let Some(factor) = Self::factor(inputs) else { return };
        let g_factor = [0, 3, 6].map(|first| [dy[first], dy[first + 1], dy[first + 2]]);
        if let Shape::ScaleRotation { log_scales, rotation } = factor.backward(&g_factor) {
            gradients[0].copy_from_slice(&log_scales);
            gradients[1].copy_from_slice(&rotation);
        }
    }
}
