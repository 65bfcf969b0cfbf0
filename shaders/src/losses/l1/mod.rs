//! The mean absolute difference of two images (L1), alone and combined with their structural similarity.

mod gpu;
#[cfg(test)]
mod tests;

use crate::gpu::Gpu;
use crate::losses::ssim::{Window, ssim};
use crate::pointwise;
use crate::tape::chunks::{CHUNK, chunked, sum};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

pointwise! {
    /// y = (1 − λ)·l1 + λ·(1 − ssim)
    fn l1_dssim_mix(l1, similarity) with(lambda) -> y {
        return (1.0 - lambda) * l1 + lambda * (1.0 - similarity);
    }
    gradients(dy) {
        l1: { return (1.0 - lambda) * dy; }
        similarity: { return -lambda * dy; }
    }
}

/// Mean |render − target| over all elements, shape `[1]`, summed in f64 on the CPU and pairwise in f32 on a GPU. The gradient is
/// 0 where both are equal; the target receives none.
pub fn l1<T: Real>(tape: &mut Tape<T>, render: Var, target: Var) -> Var {
    assert_eq!(tape.value(render).shape(), tape.value(target).shape(), "l1: the images differ in shape");
    tape.apply_one(L1, &[render, target])
}

struct L1;

impl<T: Real> Op<T> for L1 {
    fn name(&self) -> &'static str {
        "l1"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let (render, target) = (inputs[0].as_slice(), inputs[1].as_slice());
        let total = sum(render.len(), |index| (render[index] - target[index]).abs().to_f64());
        vec![Tensor::scalar(T::from_f64(total / render.len() as f64))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        let dy = pass.dy();
        let (render, target) = (inputs[0].as_slice(), inputs[1].as_slice());
        let share = dy.as_slice()[0] / T::from_f64(render.len() as f64);
        let gradient = chunked(render.len(), CHUNK, |first, gradient| {
            let pairs = render[first..].iter().zip(&target[first..]);
            gradient.iter_mut().zip(pairs).for_each(|(gradient, (&a, &b))| {
                // Two selections, which become vector instructions; a chain of branches does not.
                let above = if a > b { share } else { T::ZERO };
                let below = if a < b { share } else { T::ZERO };
                *gradient = above - below;
            });
        });
        vec![Some(Tensor::from_vec(inputs[0].shape(), gradient)), None]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for L1 {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::l1(gpu, inputs[0], inputs[1])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        vec![Some(gpu::l1_gradient(gpu, inputs[0], inputs[1], pass.dy())), None]
    }
}

/// (1 − λ)·L1 + λ·(1 − SSIM), shape `[1]`, for images [H, W, channels] (Kerbl et al. 2023); λ = 0 does not evaluate SSIM.
pub fn l1_dssim<T: Real>(tape: &mut Tape<T>, render: Var, target: Var, lambda: f64) -> Var {
    let l1 = l1(tape, render, target);
    if lambda == 0.0 {
        return l1;
    }
    let similarity = ssim(tape, render, target, Window::ZeroPadded);
    l1_dssim_mix(tape, l1, similarity, lambda)
}
