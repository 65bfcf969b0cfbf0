use super::shape::{Factor, Shape};
use crate::arrays::rows::{RowMap, RowWgsl, concat_rows, map_rows, reshape};
use crate::rasteriser::splats::{ShapeVars, SplatVars};
use crate::tape::{Real, Tape, Var};

/// The splats of `first`, followed by those of `second`. Shapes of different kinds become factors.
pub fn joined<T: Real>(tape: &mut Tape<T>, first: &SplatVars, second: &SplatVars) -> SplatVars {
    let shape = match [first.shape, second.shape] {
        [
            ShapeVars::ScaleRotation { log_scales, rotations },
            ShapeVars::ScaleRotation { log_scales: next_log_scales, rotations: next_rotations },
        ] => ShapeVars::ScaleRotation {
            log_scales: concat_rows(tape, &[log_scales, next_log_scales]),
            rotations: concat_rows(tape, &[rotations, next_rotations]),
        },
        shapes => {
            let both = shapes.map(|shape| match shape {
                ShapeVars::ScaleRotation { log_scales, rotations } => factors(tape, log_scales, rotations),
                ShapeVars::Factor(factors) => factors,
            });
            ShapeVars::Factor(concat_rows(tape, &both))
        }
    };
    let mut both = |of: fn(&SplatVars) -> Var| concat_rows(tape, &[of(first), of(second)]);
    SplatVars {
        positions: both(|splats| splats.positions),
        shape,
        opacity_logits: both(|splats| splats.opacity_logits),
        sh: both(|splats| splats.sh),
    }
}

/// F = R_q·diag(eˢ) [N, 3, 3] of logarithms of standard deviations [N, 3] and quaternions [N, 4]: for splats that are
/// rendered together with splats whose factor has another form.
pub(super) fn factors<T: Real>(tape: &mut Tape<T>, log_scales: Var, rotations: Var) -> Var {
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

    fn wgsl(&self, _input_columns: [usize; 2]) -> Option<RowWgsl> {
        Some(RowWgsl {
            value: include_str!("factors_value.wgsl"),
            gradients: include_str!("factors_bwd.wgsl"),
            specialisation: Vec::new(),
            numbers: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arrays::rows::validate_map;
    use crate::check::conformance::{Tolerance, compare, run};
    use crate::check::noise;
    use crate::gpu::tests::test_gpu;
    use crate::pointwise::scale;
    use crate::tape::{Device, Tensor};

    const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };

    /// Scales and quaternions; the first quaternion is zero.
    fn inputs(count: usize) -> [Tensor<f32>; 2] {
        let tensor = |columns: usize, seed| Tensor::from_vec([count, columns], noise(columns * count, seed)).cast();
        let mut rotations: Tensor<f32> = tensor(4, 2);
        rotations.make_mut().iter_mut().take(4).for_each(|value| *value = 0.0);
        [tensor(3, 1), rotations]
    }

    fn apply(tape: &mut Tape<f32>, vars: &[Var]) -> Vec<Var> {
        vec![factors(tape, vars[0], vars[1])]
    }

    #[test]
    fn a_gpu_makes_the_factors_that_the_cpu_makes() {
        validate_map(&Factors, [3, 4]);
        let Some(gpu) = test_gpu() else { return };
        for count in [0, 1, 57, 300] {
            compare(gpu, &format!("{count} factors"), &inputs(count), TOLERANCE, apply).unwrap();
        }
        // A thousandth more on the GPU than on the CPU.
        let other = |tape: &mut Tape<f32>, vars: &[Var]| {
            let share = if tape.device() == Device::Cpu { 1.0 } else { 1.001 };
            let log_scales = scale(tape, vars[0], share);
            vec![factors(tape, log_scales, vars[1])]
        };
        assert!(compare(gpu, "other factors", &inputs(50), TOLERANCE, other).is_err());
    }

    #[test]
    fn scales_out_of_proportion_are_infinite_without_a_gradient_on_both_devices() {
        let Some(gpu) = test_gpu() else { return };
        let mut inputs = inputs(3);
        inputs[0].make_mut()[4] = 40.0;
        inputs[0].make_mut()[7] = f32::NEG_INFINITY;
        for device in [Device::Cpu, Device::Gpu(gpu)] {
            let found = run(device, &inputs, apply);
            let finite = |tensor: &Tensor<f32>, row: usize| tensor.row(row).iter().all(|value| value.is_finite());
            assert_eq!([0, 1, 2].map(|row| finite(&found[0].1, row)), [true, false, true], "{device:?}");
            assert!(found[1].1.is_finite() && found[1].1.row(1) == [0.0; 3], "{device:?}");
        }
    }
}
