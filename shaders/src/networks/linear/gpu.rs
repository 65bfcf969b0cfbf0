//! The kernels of layers: one matrix product for each direction, of several layers at once.

use super::Activation;
use super::product::{self, EACH_ARRAYS, Output, Product, SUM_ARRAYS};
use crate::gpu::grouped::Grouped;
use crate::gpu::{Binding, Gpu, GpuArray, Kernel};
use crate::tape::{Backward, Real, Tensor, total_on_gpu};

const LAYERS: Grouped =
    Grouped { kernel: Kernel { name: "linear", text: include_str!("linear.wgsl") }, shared: 0, arrays: EACH_ARRAYS };
/// The gradient of an input that several layers share.
const OVER_LAYERS: Grouped = Grouped {
    kernel: Kernel { name: "linear, over layers", text: include_str!("linear_over_layers.wgsl") },
    shared: 1,
    arrays: SUM_ARRAYS,
};

/// The three matrix products of a layer.
#[derive(Clone, Copy)]
enum Direction {
    /// y = f(x·Wᵀ + b).
    Forward,
    /// dx = dz·W.
    Inputs,
    /// dW = dzᵀ·x with db, the sums of the rows of dzᵀ.
    Weights,
}

impl Direction {
    fn specialisation(self, activation: Activation) -> [(&'static str, u32); 6] {
        let relu = u32::from(activation == Activation::Relu);
        let [a_by_term, b_by_term, bias, relu, mask, sums] = match self {
            Self::Forward => [1, 1, 1, relu, 0, 0],
            Self::Inputs => [1, 0, 0, 0, relu, 0],
            Self::Weights => [0, 0, 0, 0, relu, 1],
        };
        [
            ("A_BY_TERM", a_by_term),
            ("B_BY_TERM", b_by_term),
            ("BIAS", bias),
            ("RELU", relu),
            ("MASK", mask),
            ("SUMS", sums),
        ]
    }

    /// The product of a layer for `count` rows of x.
    fn product<'a>(self, count: usize, [inputs, outputs]: [usize; 2], arrays: [Binding<'a>; 3]) -> Product<'a> {
        let ([rows, columns, terms], strides) = match self {
            Self::Forward => ([count, outputs, inputs], [inputs, 1, 1, inputs]),
            Self::Inputs => ([count, inputs, outputs], [outputs, 1, inputs, 1]),
            Self::Weights => ([outputs, inputs, count], [1, outputs, inputs, 1]),
        };
        Product { rows, columns, terms, strides, arrays }
    }
}

/// The specialisation of a launch with items of both [`Direction::Inputs`] and [`Direction::Weights`].
fn of_both(activation: Activation) -> [(&'static str, u32); 6] {
    Direction::Inputs.specialisation(activation).map(|(name, value)| match name {
        "A_BY_TERM" | "SUMS" => (name, 2),
        _ => (name, value),
    })
}

/// The indices of a layer's inputs among those of the operation.
#[derive(Clone, Copy)]
pub(super) struct Places {
    pub x: usize,
    pub weight: usize,
    pub bias: usize,
}

impl Places {
    pub(super) fn all(self) -> [usize; 3] {
        [self.x, self.weight, self.bias]
    }
}

/// Inputs and outputs per row.
fn sizes<T: Real>(weight: &Tensor<T>) -> [usize; 2] {
    [weight.row_len(), weight.rows()]
}

/// The outputs of all layers.
pub(super) fn forward<T: Real>(
    gpu: Gpu,
    layers: &[Places],
    activation: Activation,
    inputs: &[&Tensor<T>],
) -> Vec<Tensor<T>> {
    let output = |layer: &Places| {
        let shape = [inputs[layer.x].rows(), inputs[layer.weight].rows()];
        Tensor::from_gpu(shape, GpuArray::new(gpu, shape[0] * shape[1]))
    };
    let results: Vec<Tensor<T>> = layers.iter().map(output).collect();
    let (mut products, mut outputs) = (Vec::new(), Vec::new());
    for (layer, result) in layers.iter().zip(&results) {
        let [x, weight, bias] = layer.all().map(|place| Binding::Read(inputs[place].on_gpu(gpu)));
        products.push(Direction::Forward.product(result.rows(), sizes(inputs[layer.weight]), [x, weight, bias]));
        outputs.push((Binding::Write(result.on_gpu(gpu)), false));
    }
    product::each(gpu, &LAYERS, &Direction::Forward.specialisation(activation), &products, &outputs);
    results
}

/// The inputs of the backward pass of layers.
pub(crate) struct LayersBackward<'a, T: Real> {
    pub gpu: Gpu,
    pub layers: &'a [Places],
    pub activation: Activation,
    pub pass: Backward<'a, T>,
}

/// A layer whose output has a gradient.
struct Live<'a, T: Real> {
    places: Places,
    y: &'a Tensor<T>,
    dy: &'a Tensor<T>,
}

impl<'a, T: Real> LayersBackward<'a, T> {
    /// Adds the gradients of the inputs that need one to their totals.
    pub(crate) fn add_gradients(&self, totals: &mut [Option<Tensor<T>>]) {
        let layers = self.layers.iter().zip(self.pass.outputs).zip(self.pass.output_grads);
        let live = |((&places, &y), dy): ((&Places, &&'a Tensor<T>), &Option<&'a Tensor<T>>)| {
            dy.map(|dy| Live { places, y, dy })
        };
        let live: Vec<Live<'a, T>> = layers.filter_map(live).collect();
        let mut xs: Vec<usize> = live.iter().map(|layer| layer.places.x).filter(|&x| self.pass.needs[x]).collect();
        xs.sort_unstable();
        xs.dedup();
        let xs: Vec<(usize, bool)> = xs.into_iter().map(|x| (x, self.prepare(totals, x))).collect();
        let needed = |layer: &&Live<T>| self.pass.needs[layer.places.weight] || self.pass.needs[layer.places.bias];
        let with_weights: Vec<&Live<'a, T>> = live.iter().filter(needed).collect();
        // Unneeded gradients are computed as well, and dropped.
        let mut unneeded: Vec<Option<Tensor<T>>> = vec![None; totals.len()];
        let mut adds = Vec::new();
        for layer in &with_weights {
            adds.push([layer.places.weight, layer.places.bias].map(|place| match self.pass.needs[place] {
                true => self.prepare(totals, place),
                false => self.prepare(&mut unneeded, place),
            }));
        }
        let (totals, unneeded) = (&*totals, &unneeded[..]);
        let (products, outputs) = self.products_of_inputs(&live, &xs, totals);
        if with_weights.is_empty() {
            let specialisation = Direction::Inputs.specialisation(self.activation);
            return product::each(self.gpu, &LAYERS, &specialisation, &products, &outputs);
        }
        let (of_weights, outputs_of_weights) = self.products_of_weights(&with_weights, &adds, [totals, unneeded]);
        let (alone, with_sums) = ((&products[..], &outputs[..]), (&of_weights[..], &outputs_of_weights[..]));
        product::each_with_sums(self.gpu, &LAYERS, &of_both(self.activation), alone, with_sums);
    }

    /// dx of every input, written or accumulated: gradients of inputs that several layers share are computed here, the products
    /// of the others are returned.
    fn products_of_inputs<'b>(
        &'b self,
        live: &[Live<'a, T>],
        xs: &[(usize, bool)],
        totals: &'b [Option<Tensor<T>>],
    ) -> (Vec<Product<'b>>, Vec<Output<'b>>) {
        let specialisation = Direction::Inputs.specialisation(self.activation);
        let (mut products, mut outputs) = (Vec::new(), Vec::new());
        for &(x, adds) in xs {
            let of_x = live.iter().filter(|layer| layer.places.x == x);
            let of_x: Vec<Product> = of_x.map(|layer| self.product(Direction::Inputs, layer)).collect();
            let output = (Binding::Write(self.total(totals, x)), adds);
            if of_x.len() > 1 {
                product::sum(self.gpu, &OVER_LAYERS, &specialisation, &of_x, output);
            } else {
                products.extend(of_x);
                outputs.push(output);
            }
        }
        (products, outputs)
    }

    /// dW and db of every layer, written or accumulated.
    fn products_of_weights<'b>(
        &'b self,
        live: &[&Live<'a, T>],
        adds: &[[bool; 2]],
        [totals, unneeded]: [&'b [Option<Tensor<T>>]; 2],
    ) -> (Vec<Product<'b>>, Vec<[Output<'b>; 2]>) {
        let output = |place: usize, adds| {
            let totals = if self.pass.needs[place] { totals } else { unneeded };
            (Binding::Write(self.total(totals, place)), adds)
        };
        let products = live.iter().map(|layer| self.product(Direction::Weights, layer)).collect();
        let outputs = live
            .iter()
            .zip(adds)
            .map(|(layer, adds)| [output(layer.places.weight, adds[0]), output(layer.places.bias, adds[1])]);
        (products, outputs.collect())
    }

    /// The product of a layer with A = dz, i.e. dy where y is positive.
    fn product(&self, direction: Direction, layer: &Live<'a, T>) -> Product<'a> {
        let [x, weight] = [layer.places.x, layer.places.weight].map(|place| self.pass.inputs[place]);
        let other = if let Direction::Weights = direction { x } else { weight };
        let arrays = [layer.dy, other, layer.y].map(|tensor| Binding::Read(tensor.on_gpu(self.gpu)));
        direction.product(layer.dy.rows(), sizes(weight), arrays)
    }

    /// Makes the total of an input writable for kernels; returns whether they accumulate into it.
    fn prepare(&self, totals: &mut [Option<Tensor<T>>], place: usize) -> bool {
        total_on_gpu(self.gpu, &mut totals[place], self.pass.inputs[place].shape()).1
    }

    fn total<'b>(&self, totals: &'b [Option<Tensor<T>>], place: usize) -> &'b GpuArray {
        totals[place].as_ref().expect("it was prepared").on_gpu(self.gpu)
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid_in_every_direction() {
    use super::product::assert_valid_product;
    for direction in [Direction::Forward, Direction::Inputs, Direction::Weights] {
        for activation in [Activation::Identity, Activation::Relu] {
            assert_valid_product(&LAYERS, &direction.specialisation(activation));
            assert_valid_product(&LAYERS, &of_both(activation));
        }
    }
    assert_valid_product(&OVER_LAYERS, &Direction::Inputs.specialisation(Activation::Relu));
}
