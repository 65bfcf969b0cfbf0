//! A loss of a step.

use shaders::tape::{Real, Tape, Tensor, Var};

/// One loss of a step: a scalar on the tape and its weight in the sum.
#[derive(Clone, Debug)]
pub(crate) struct NamedLoss {
    /// The name; losses of one name are summed.
    pub name: &'static str,
    pub(super) weight: f64,
    pub(super) value: Var,
}

impl NamedLoss {
    /// The variable and its seed for a backward pass: the derivative of the objective with respect to it.
    pub(crate) fn seed<T: Real>(&self, tape: &Tape<T>) -> (Var, Tensor<T>) {
        (self.value, Tensor::full(tape.value(self.value).shape(), T::from_f64(self.weight)))
    }
}
