//! The kernels of layers: one matrix product for each direction, of several layers at once.

use super::Activation;
use super::product::{self, EACH, EACH_ARRAYS, Product, SUM, SUM_ARRAYS};
use crate::gpu::grouped::Grouped;
use crate::gpu::{Gpu, GpuArray, Kernel};
use crate::tape::{Real, Tensor, total_on_gpu};

const OPERANDS: &str = include_str!("operands.wgsl");
const LAYERS: Grouped =
    Grouped { kernel: Kernel { name: "linear", text: &[EACH[0], EACH[1], OPERANDS] }, shared: 0, arrays: EACH_ARRAYS };
/// The gradient of an input that several layers share.
const OVER_LAYERS: Grouped = Grouped {
    kernel: Kernel { name: "linear, over layers", text: &[SUM[0], SUM[1], OPERANDS] },
    shared: 1,
    arrays: SUM_ARRAYS,
};

/// What is special about each of the three products.
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
    fn product<'a>(self, count: usize, [inputs, outputs]: [usize; 2], arrays: [&'a GpuArray; 3]) -> Product<'a> {
        let ([rows, columns, terms], strides) = match self {
            Self::Forward => ([count, outputs, inputs], [inputs, 1, 1, inputs]),
            Self::Inputs => ([count, inputs, outputs], [outputs, 1, inputs, 1]),
            Self::Weights => ([outputs, inputs, count], [1, outputs, inputs, 1]),
        };
        Product { rows, columns, terms, strides, arrays }
    }
}

/// Which inputs of an operation are those of a layer.
#[derive(Clone, Copy)]
pub struct Places {
    pub x: usize,
    pub weight: usize,
    pub bias: usize,
}

impl Places {
    pub fn all(self) -> [usize; 3] {
        [self.x, self.weight, self.bias]
    }
}

/// Inputs and outputs per row.
fn sizes<T: Real>(weight: &Tensor<T>) -> [usize; 2] {
    [weight.row_len(), weight.rows()]
}

/// The outputs of all layers.
pub fn forward<T: Real>(gpu: Gpu, layers: &[Places], activation: Activation, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
    let product = |layer: &Places| {
        let arrays = layer.all().map(|place| inputs[place].on_gpu(gpu));
        Direction::Forward.product(inputs[layer.x].rows(), sizes(inputs[layer.weight]), arrays)
    };
    let products: Vec<Product> = layers.iter().map(product).collect();
    let output = |product: &Product| {
        let shape = [product.rows, product.columns];
        Tensor::from_gpu(shape, GpuArray::new(gpu, product.rows * product.columns))
    };
    let outputs: Vec<Tensor<T>> = products.iter().map(output).collect();
    let arrays: Vec<_> = outputs.iter().map(|output| (output.on_gpu(gpu), false)).collect();
    product::each(gpu, &LAYERS, &Direction::Forward.specialisation(activation), &products, &arrays);
    outputs
}

/// What the backward pass of layers is given.
pub struct Backward<'a, T: Real> {
    pub gpu: Gpu,
    pub layers: &'a [Places],
    pub activation: Activation,
    pub inputs: &'a [&'a Tensor<T>],
    pub outputs: &'a [&'a Tensor<T>],
    pub output_grads: &'a [Option<&'a Tensor<T>>],
    pub needs: &'a [bool],
}

/// A layer to whose output a gradient arrived.
struct Live<'a, T: Real> {
    places: Places,
    y: &'a Tensor<T>,
    dy: &'a Tensor<T>,
}

impl<'a, T: Real> Backward<'a, T> {
    /// Adds the gradients of the inputs that need one to their totals.
    pub fn add_gradients(&self, totals: &mut [Option<Tensor<T>>]) {
        let layers = self.layers.iter().zip(self.outputs).zip(self.output_grads);
        let live = |((&places, &y), dy): ((&Places, &&'a Tensor<T>), &Option<&'a Tensor<T>>)| {
            dy.map(|dy| Live { places, y, dy })
        };
        let live: Vec<Live<'a, T>> = layers.filter_map(live).collect();
        self.add_to_inputs(&live, totals);
        self.add_to_weights(&live, totals);
    }

    /// dx: inputs of one layer in one launch, those that several share in one each.
    fn add_to_inputs(&self, live: &[Live<'a, T>], totals: &mut [Option<Tensor<T>>]) {
        let specialisation = Direction::Inputs.specialisation(self.activation);
        let mut xs: Vec<usize> = live.iter().map(|layer| layer.places.x).filter(|&x| self.needs[x]).collect();
        xs.sort_unstable();
        xs.dedup();
        let product = |layer: &Live<'a, T>| self.product(Direction::Inputs, layer);
        let (mut products, mut alone) = (Vec::new(), Vec::new());
        for x in xs {
            let mut of_x: Vec<Product> = live.iter().filter(|layer| layer.places.x == x).map(product).collect();
            let adds = self.prepare(totals, x);
            if of_x.len() == 1 {
                products.append(&mut of_x);
                alone.push((x, adds));
            } else {
                let y = (self.total(totals, x), adds);
                product::sum(self.gpu, &OVER_LAYERS, &specialisation, &of_x, y);
            }
        }
        let outputs: Vec<_> = alone.into_iter().map(|(x, adds)| (self.total(totals, x), adds)).collect();
        product::each(self.gpu, &LAYERS, &specialisation, &products, &outputs);
    }

    /// dW and db.
    fn add_to_weights(&self, live: &[Live<'a, T>], totals: &mut [Option<Tensor<T>>]) {
        let needed = |layer: &&Live<T>| self.needs[layer.places.weight] || self.needs[layer.places.bias];
        let live: Vec<&Live<'a, T>> = live.iter().filter(needed).collect();
        // What nobody needs is computed as well, and dropped.
        let mut unneeded: Vec<Option<Tensor<T>>> = vec![None; totals.len()];
        let mut adds = Vec::new();
        for layer in &live {
            adds.push([layer.places.weight, layer.places.bias].map(|place| match self.needs[place] {
                true => self.prepare(totals, place),
                false => self.prepare(&mut unneeded, place),
            }));
        }
        let total = |place: usize| self.total(if self.needs[place] { totals } else { &unneeded }, place);
        let output = |(layer, adds): (&&Live<T>, [bool; 2])| {
            [(total(layer.places.weight), adds[0]), (total(layer.places.bias), adds[1])]
        };
        let outputs: Vec<_> = live.iter().zip(adds).map(output).collect();
        let products: Vec<Product> = live.iter().map(|layer| self.product(Direction::Weights, layer)).collect();
        let specialisation = Direction::Weights.specialisation(self.activation);
        product::with_sums(self.gpu, &LAYERS, &specialisation, &products, &outputs);
    }

    /// The product of a layer whose first operand is dz: dy where y is positive.
    fn product(&self, direction: Direction, layer: &Live<'a, T>) -> Product<'a> {
        let [x, weight] = [layer.places.x, layer.places.weight].map(|place| self.inputs[place]);
        let other = if matches!(direction, Direction::Weights) { x } else { weight };
        let arrays = [layer.dy, other, layer.y].map(|tensor| tensor.on_gpu(self.gpu));
        direction.product(x.rows(), sizes(weight), arrays)
    }

    /// Makes the total of an input one that kernels can write, and tells whether they add to it.
    fn prepare(&self, totals: &mut [Option<Tensor<T>>], place: usize) -> bool {
        total_on_gpu(self.gpu, &mut totals[place], self.inputs[place].shape()).1
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
        }
    }
    assert_valid_product(&OVER_LAYERS, &Direction::Inputs.specialisation(Activation::Relu));
}
