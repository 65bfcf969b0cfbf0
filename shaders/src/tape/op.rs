//! Differentiable operations: what a tape applies forwards and runs backwards.

use super::totals::add_all;
use super::{Real, Tensor};
use crate::gpu::Gpu;

/// A differentiable operation. `forward` and `backward` run on the CPU; [`Op::gpu`] offers kernels for a GPU, for both
/// directions. Inputs may lie in any memory: [`Tensor`] copies them to where they are read.
pub(crate) trait Op<T: Real>: Send {
    /// The name in profiles and messages.
    fn name(&self) -> &'static str;

    /// The outputs. `self` may keep values for the backward pass.
    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>>;

    /// The gradient of each input, of the input's shape; `None` is zero. Inputs with `needs` false may have `None`, because
    /// the tape ignores their gradients.
    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>>;

    /// Adds the gradients of [`Op::backward`] to `totals`, the gradients of the inputs so far (`None`: zero).
    ///
    /// An operation that touches little of a large input overrides this: adding in place saves a pass over the whole input.
    fn accumulate(&mut self, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        let terms = self.backward(pass);
        add_all(self.name(), totals, terms, pass.needs);
    }

    /// The kernels for a GPU; `None` if the operation runs on the CPU only.
    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        None
    }
}

/// An operation with kernels for a GPU. It runs backwards on the GPU if and only if it ran forwards there.
pub(crate) trait GpuOp<T: Real>: Op<T> {
    /// The outputs, as [`Op::forward`]; `None` if there are no kernels for these inputs: the operation then runs on the CPU
    /// in both directions.
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>>;

    /// The gradient of each input, as [`Op::backward`].
    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>>;

    /// Adds the gradients of [`GpuOp::backward_gpu`] to `totals`, as [`Op::accumulate`].
    fn accumulate_gpu(&mut self, gpu: Gpu, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        let terms = self.backward_gpu(gpu, pass);
        add_all(self.name(), totals, terms, pass.needs);
    }
}

/// The backward pass through one operation. The tape skips operations none of whose outputs has a gradient.
#[derive(Clone, Copy)]
pub(crate) struct Backward<'a, T: Real> {
    /// The inputs of the forward pass.
    pub inputs: &'a [&'a Tensor<T>],
    /// The outputs of the forward pass.
    pub outputs: &'a [&'a Tensor<T>],
    /// The gradient of each output; `None` is zero.
    pub(crate) output_grads: &'a [Option<&'a Tensor<T>>],
    /// Whether each input takes part in differentiation.
    pub needs: &'a [bool],
}

impl<'a, T: Real> Backward<'a, T> {
    /// The gradient of the output of an operation with one output.
    pub(crate) fn dy(&self) -> &'a Tensor<T> {
        let [dy] = exactly(self.output_grads);
        dy.expect("the tape skips operations without an output gradient")
    }

    /// The gradients that `accumulate` adds to zeros.
    pub(crate) fn summed_from_zero(&self, accumulate: impl FnOnce(&mut [Option<Tensor<T>>])) -> Vec<Option<Tensor<T>>> {
        let mut totals = vec![None; self.inputs.len()];
        accumulate(&mut totals);
        totals
    }
}

/// The elements of a slice of known length. Panics if the length differs.
pub(crate) fn exactly<R: Copy, const N: usize>(slice: &[R]) -> [R; N] {
    slice.try_into().unwrap_or_else(|_| panic!("{} inputs or outputs instead of {N}", slice.len()))
}
