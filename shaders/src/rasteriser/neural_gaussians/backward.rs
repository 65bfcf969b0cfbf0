//! The gradients of [`neural_gaussians`](super::neural_gaussians), input by input: every anchor sums over its own Gaussians.

use scene::gaussians::SH_C0;

use super::{Chosen, SHAPE, inside, log_sigmoid};
use crate::tape::{Real, Tensor};

/// The gradients of the inputs, `None` where the outputs that depend on them have no gradient.
pub(super) struct Gradients<'a, T: Real> {
    /// The spawned Gaussians.
    pub chosen: &'a Chosen,
    /// The inputs of the operation.
    pub inputs: &'a [&'a Tensor<T>],
    /// The gradient of each output of the operation; `None` is zero.
    pub(crate) output_grads: &'a [Option<&'a Tensor<T>>],
}

impl<T: Real> Gradients<'_, T> {
    pub(super) fn positions(&self) -> Option<Tensor<T>> {
        let by_position = self.output_grads[0]?;
        self.chosen.per_anchor(self.inputs[0], |_, gaussians, sum| {
            for gradient in gaussians.map(|gaussian| by_position.row(gaussian)) {
                (0..3).for_each(|axis| sum[axis] += gradient[axis]);
            }
        })
    }

    pub(super) fn log_scales(&self) -> Option<Tensor<T>> {
        let (by_position, by_log_scale) = (self.output_grads[0], self.output_grads[1]);
        by_position.or(by_log_scale)?;
        self.chosen.per_anchor(self.inputs[1], |anchor, gaussians, sum| {
            let (scale, offsets) = (self.inputs[1].row(anchor), self.inputs[2].row(anchor));
            for gaussian in gaussians {
                let offset = &offsets[3 * self.chosen.k(gaussian)..];
                for axis in 0..3 {
                    if let Some(gradient) = by_position {
                        sum[axis] += gradient.row(gaussian)[axis] * offset[axis] * scale[axis].exp();
                    }
                    if let Some(gradient) = by_log_scale {
                        sum[3 + axis] += gradient.row(gaussian)[axis];
                    }
                }
            }
        })
    }

    pub(super) fn offsets(&self) -> Option<Tensor<T>> {
        let by_position = self.output_grads[0]?;
        self.chosen.per_anchor(self.inputs[2], |anchor, gaussians, row| {
            let scale = self.inputs[1].row(anchor);
            for gaussian in gaussians {
                let (k, gradient) = (self.chosen.k(gaussian), by_position.row(gaussian));
                (0..3).for_each(|axis| row[3 * k + axis] = gradient[axis] * scale[axis].exp());
            }
        })
    }

    pub(super) fn opacities(&self) -> Option<Tensor<T>> {
        let by_logit = self.output_grads[3]?;
        self.chosen.per_anchor(self.inputs[3], |anchor, gaussians, row| {
            for gaussian in gaussians {
                let k = self.chosen.k(gaussian);
                let (opacity, is_free) = inside(self.inputs[3].row(anchor)[k]);
                let slope = if is_free { T::ONE / (opacity * (T::ONE - opacity)) } else { T::ZERO };
                row[k] = by_logit.row(gaussian)[0] * slope;
            }
        })
    }

    pub(super) fn shapes(&self) -> Option<Tensor<T>> {
        let (by_log_scale, by_rotation) = (self.output_grads[1], self.output_grads[2]);
        by_log_scale.or(by_rotation)?;
        self.chosen.per_anchor(self.inputs[4], |anchor, gaussians, row| {
            for gaussian in gaussians {
                let k = self.chosen.k(gaussian);
                let shape = &self.inputs[4].row(anchor)[SHAPE * k..];
                let row = &mut row[SHAPE * k..SHAPE * (k + 1)];
                if let Some(gradient) = by_log_scale {
                    // d ln sigmoid(c) = sigmoid(−c) dc.
                    (0..3).for_each(|axis| row[axis] = gradient.row(gaussian)[axis] * log_sigmoid(-shape[axis]).exp());
                }
                if let Some(gradient) = by_rotation {
                    row[3..].copy_from_slice(gradient.row(gaussian));
                }
            }
        })
    }

    pub(super) fn colors(&self) -> Option<Tensor<T>> {
        let by_harmonic = self.output_grads[4]?;
        let factor = T::from_f64(1.0 / f64::from(SH_C0));
        self.chosen.per_anchor(self.inputs[5], |_, gaussians, row| {
            for gaussian in gaussians {
                let (k, gradient) = (self.chosen.k(gaussian), by_harmonic.row(gaussian));
                (0..3).for_each(|channel| row[3 * k + channel] = gradient[channel] * factor);
            }
        })
    }
}
