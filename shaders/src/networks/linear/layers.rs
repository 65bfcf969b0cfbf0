//! Several layers at once.

use super::gpu::{self, Places};
use super::{Activation, Linear};
use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// One of several layers: x [N, I], weight [O, I], bias `[O]`.
#[derive(Clone, Copy, Debug)]
pub struct Layer {
    /// The input [N, I].
    pub x: Var,
    /// The weight matrix [O, I].
    pub weight: Var,
    /// The bias `[O]`.
    pub bias: Var,
}

/// The outputs of [`super::linear`] for several layers, which may share inputs. A GPU computes them together.
pub fn linears<T: Real>(tape: &mut Tape<T>, layers: &[Layer], activation: Activation) -> Vec<Var> {
    let mut inputs: Vec<Var> = Vec::new();
    // Inputs that several layers share are listed once.
    for layer in layers {
        if !inputs.contains(&layer.x) {
            inputs.push(layer.x);
        }
    }
    let mut op = Linears { activation, layers: Vec::new(), places: Vec::new() };
    for &Layer { x, weight, bias } in layers {
        op.layers.push(Linear::new(tape, x, weight, bias, activation));
        let x = inputs.iter().position(|&input| input == x).expect("every x is an input");
        op.places.push(Places { x, weight: inputs.len(), bias: inputs.len() + 1 });
        inputs.extend([weight, bias]);
    }
    tape.apply(op, &inputs)
}

struct Linears {
    activation: Activation,
    layers: Vec<Linear>,
    /// The indices of each layer's inputs among those of the operation.
    places: Vec<Places>,
}

impl<T: Real> Op<T> for Linears {
    fn name(&self) -> &'static str {
        "linear"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let layers = self.layers.iter_mut().zip(&self.places);
        layers.flat_map(|(layer, places)| layer.forward(&places.all().map(|place| inputs[place]))).collect()
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        pass.summed_from_zero(|totals| self.accumulate(pass, totals))
    }

    /// Layer by layer from the last one on, as if each were a separate operation.
    fn accumulate(&mut self, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        let Backward { inputs, outputs, output_grads, needs } = pass;
        for (index, (layer, places)) in self.layers.iter_mut().zip(&self.places).enumerate().rev() {
            if output_grads[index].is_none() {
                continue;
            }
            let (places, own) = (places.all(), index..index + 1);
            let mut of_layer = places.map(|place| totals[place].take());
            let of_pass = Backward {
                inputs: &places.map(|place| inputs[place]),
                outputs: &outputs[own.clone()],
                output_grads: &output_grads[own],
                needs: &places.map(|place| needs[place]),
            };
            layer.accumulate(of_pass, &mut of_layer);
            places.into_iter().zip(of_layer).for_each(|(place, total)| totals[place] = total);
        }
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Linears {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(gpu::forward(gpu, &self.places, self.activation, inputs))
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        pass.summed_from_zero(|totals| self.accumulate_gpu(gpu, pass, totals))
    }

    fn accumulate_gpu(&mut self, gpu: Gpu, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        gpu::LayersBackward { gpu, layers: &self.places, activation: self.activation, pass }.add_gradients(totals);
    }
}
