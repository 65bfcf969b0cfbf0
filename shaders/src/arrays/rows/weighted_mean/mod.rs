//! A loss: the weighted mean of squared differences.

mod gpu;

use crate::gpu::Gpu;
use crate::tape::chunks::{CHUNK, chunked, sum};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var, exactly};
use gpu::WeightedMeanOnGpu;

/// Σₙ wₙ‖aₙ − bₙ‖² / (K·Σₙ wₙ), shape `[1]`, for a, b [N, K] and weights w ≥ 0 `[N]` or [N, 1]; 0 where all weights are 0.
///
/// Differentiable in a, b and w; summed in f64 on the CPU and in f32 on a GPU.
pub fn weighted_mean_squared_difference<T: Real>(tape: &mut Tape<T>, a: Var, b: Var, weights: Var) -> Var {
    let [of_a, of_b, of_weights] = [a, b, weights].map(|var| tape.value(var));
    assert_eq!(of_a.shape(), of_b.shape(), "weighted_mean_squared_difference: shapes differ");
    assert_eq!(of_weights.len(), of_a.rows(), "weighted_mean_squared_difference: one weight per row");
    tape.apply_one(WeightedMean { weight_sum: 0.0, on_gpu: None }, &[a, b, weights])
}

struct WeightedMean {
    weight_sum: f64,
    on_gpu: Option<WeightedMeanOnGpu>,
}

impl WeightedMean {
    /// 1 / (K·Σ w), or 0 where nothing weighs anything; a NaN stays a NaN.
    fn factor(&self, columns: usize) -> f64 {
        if self.weight_sum == 0.0 { 0.0 } else { 1.0 / (columns as f64 * self.weight_sum) }
    }
}

impl<T: Real> Op<T> for WeightedMean {
    fn name(&self) -> &'static str {
        "weighted_mean_squared_difference"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [a, b, weights] = exactly(inputs);
        let weights = weights.as_slice();
        self.weight_sum = sum(weights.len(), |row| weights[row].to_f64());
        let total = sum(weights.len(), |row| weights[row].to_f64() * squared_distance(a.row(row), b.row(row)));
        vec![Tensor::scalar(T::from_f64(self.factor(a.row_len()) * total))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, needs, .. } = pass;
        let ([a, b, weights], dy) = (exactly(inputs), pass.dy());
        let columns = a.row_len();
        let factor = self.factor(columns) * dy.as_slice()[0].to_f64();
        let by_values = |sign: f64| {
            let (a, b, weights, factor) =
                (a.as_slice(), b.as_slice(), weights.as_slice(), T::from_f64(2.0 * sign * factor));
            let gradient = chunked(a.len(), CHUNK, |first, gradient| {
                for (element, gradient) in (first..).zip(gradient) {
                    *gradient = factor * weights[element / columns] * (a[element] - b[element]);
                }
            });
            Tensor::from_vec(inputs[0].shape(), gradient)
        };
        let by_weights = || {
            let mean = columns as f64 * outputs[0].as_slice()[0].to_f64();
            let gradient = |row| T::from_f64(factor * (squared_distance(a.row(row), b.row(row)) - mean));
            Tensor::from_vec(weights.shape(), (0..weights.len()).map(gradient).collect())
        };
        vec![needs[0].then(|| by_values(1.0)), needs[1].then(|| by_values(-1.0)), needs[2].then(by_weights)]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for WeightedMean {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        let (of_gpu, mean) = WeightedMeanOnGpu::new(gpu, inputs);
        self.on_gpu = Some(of_gpu);
        Some(vec![mean])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, .. } = pass;
        let dy = pass.dy();
        self.on_gpu.as_ref().expect("the forward pass kept it").gradients(gpu, inputs, outputs[0], dy).map(Some).into()
    }
}

fn squared_distance<T: Real>(a: &[T], b: &[T]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| (a - b).to_f64().powi(2)).sum()
}
