//! The backward pass: every operation adds to the gradients of its inputs.

use std::ops::Range;
use std::time::Instant;

use super::op::{Backward, Op};
use super::totals::add_to;
use super::{Profile, Real, Tensor, Value, Var};
use crate::gpu::Gpu;

/// An operation that was applied.
pub(super) struct Node<T: Real> {
    pub op: Box<dyn Op<T>>,
    /// The GPU on which it ran forwards; `None`: the CPU.
    pub gpu: Option<Gpu>,
    pub inputs: Vec<Var>,
    pub outputs: Range<usize>,
}

impl<T: Real> Node<T> {
    /// Adds this node's contribution to the gradients of its inputs; skipped if no gradient reached its outputs.
    pub(super) fn backward(&mut self, values: &[Value<T>], gradients: &mut Gradients<T>, profile: &mut Profile) {
        // Inputs were created before outputs.
        let (of_inputs, of_outputs) = gradients.tensors.split_at_mut(self.outputs.start);
        let output_grads: Vec<_> = of_outputs[..self.outputs.len()].iter().map(Option::as_ref).collect();
        if output_grads.iter().all(Option::is_none) {
            return;
        }
        let inputs: Vec<_> = self.inputs.iter().map(|var| &values[var.0].tensor).collect();
        let outputs: Vec<_> = values[self.outputs.clone()].iter().map(|value| &value.tensor).collect();
        let needs: Vec<bool> = self.inputs.iter().map(|var| values[var.0].needs_gradient).collect();
        // Moved out so that the operation can add in place; an input that occurs twice is given once.
        let mut totals: Vec<_> = self.inputs.iter().map(|var| of_inputs[var.0].take()).collect();

        let start = Instant::now();
        let pass = Backward { inputs: &inputs, outputs: &outputs, output_grads: &output_grads, needs: &needs };
        match (self.gpu, self.op.gpu()) {
            (Some(gpu), Some(on_gpu)) => on_gpu.accumulate_gpu(gpu, pass, &mut totals),
            _ => self.op.accumulate(pass, &mut totals),
        }
        profile.entry(self.op.name()).backward.add(start.elapsed());

        for (&var, total) in self.inputs.iter().zip(totals) {
            if let Some(total) = total {
                gradients.accumulate(self.op.name(), var, &values[var.0].tensor, total);
            }
        }
    }
}

/// The result of a backward pass.
pub struct Gradients<T: Real> {
    pub(super) tensors: Vec<Option<Tensor<T>>>,
}

impl<T: Real> Gradients<T> {
    /// The gradient of a leaf or of an intermediate value; `None` if none reached it (it is zero).
    pub fn get(&self, var: Var) -> Option<&Tensor<T>> {
        self.tensors[var.0].as_ref()
    }

    /// Removes and returns the gradient of a variable; `None` if it has none.
    pub fn take(&mut self, var: Var) -> Option<Tensor<T>> {
        self.tensors[var.0].take()
    }

    pub(super) fn accumulate(&mut self, source: &str, var: Var, value: &Tensor<T>, gradient: Tensor<T>) {
        assert_eq!(gradient.shape(), value.shape(), "{source}: gradient and value differ in shape");
        add_to(&mut self.tensors[var.0], gradient);
    }
}
