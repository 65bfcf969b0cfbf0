//! The kernels of layers: one matrix product for each direction, of several layers at once, and of rows in windows where the
//! arrays do not fit.

use super::Activation;
use super::product::{self, EACH, EACH_ARRAYS, Output, Product, SUM, SUM_ARRAYS};
use crate::gpu::grouped::Grouped;
use crate::gpu::{Binding, Gpu, GpuArray, Kernel, in_windows};
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
    fn product<'a>(self, count: usize, [inputs, outputs]: [usize; 2], arrays: [Binding<'a>; 3]) -> Product<'a> {
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
    let output = |layer: &Places| {
        let shape = [inputs[layer.x].rows(), inputs[layer.weight].rows()];
        Tensor::from_gpu(shape, GpuArray::new(gpu, shape[0] * shape[1]))
    };
    let results: Vec<Tensor<T>> = layers.iter().map(output).collect();
    let (mut products, mut outputs) = (Vec::new(), Vec::new());
    for (layer, result) in layers.iter().zip(&results) {
        let [x, weight, bias] = layer.all().map(|place| Binding::Read(inputs[place].on_gpu(gpu)));
        let arrays = [x, weight.all(), bias.all(), Binding::Write(result.on_gpu(gpu))];
        in_windows(gpu, result.rows(), &arrays, |count, arrays| {
            let &[x, weight, bias, y] = arrays else { unreachable!("four arrays") };
            products.push(Direction::Forward.product(count, sizes(inputs[layer.weight]), [x, weight, bias]));
            outputs.push((y, false));
        });
    }
    product::each(gpu, &LAYERS, &Direction::Forward.specialisation(activation), &products, &outputs);
    results
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
        let adds: Vec<bool> = xs.iter().map(|&x| self.prepare(totals, x)).collect();
        let (mut products, mut alone) = (Vec::new(), Vec::new());
        for (x, adds) in xs.into_iter().zip(adds) {
            let of_x: Vec<&Live<T>> = live.iter().filter(|layer| layer.places.x == x).collect();
            let mut arrays: Vec<Binding> =
                of_x.iter().flat_map(|layer| self.operands(Direction::Inputs, layer)).collect();
            arrays.push(Binding::Write(self.total(totals, x)));
            in_windows(self.gpu, self.inputs[x].rows(), &arrays, |count, arrays| {
                let (&y, operands) = arrays.split_last().expect("the total");
                let operands = operands.as_chunks().0.iter().copied();
                let layers = of_x.iter().map(|layer| self.sizes(layer)).zip(operands);
                let product = |(sizes, operands)| Direction::Inputs.product(count, sizes, operands);
                let of_window: Vec<Product> = layers.map(product).collect();
                if of_x.len() > 1 {
                    return product::sum(self.gpu, &OVER_LAYERS, &specialisation, &of_window, (y, adds));
                }
                products.extend(of_window);
                alone.push((y, adds));
            });
        }
        product::each(self.gpu, &LAYERS, &specialisation, &products, &alone);
    }

    /// dW and db: window by window, each of which adds to those before.
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
        let windows: Vec<_> = live.iter().map(|layer| self.windows_of_rows(layer)).collect();
        for window in 0..windows.iter().map(Vec::len).max().unwrap_or(0) {
            let (mut products, mut outputs) = (Vec::new(), Vec::<[Output; 2]>::new());
            for ((layer, windows), adds) in live.iter().zip(&windows).zip(&adds) {
                let Some(&(count, arrays)) = windows.get(window) else { continue };
                products.push(Direction::Weights.product(count, self.sizes(layer), arrays));
                let output = |place, adds| (Binding::Write(total(place)), adds || window > 0);
                outputs.push([output(layer.places.weight, adds[0]), output(layer.places.bias, adds[1])]);
            }
            let specialisation = Direction::Weights.specialisation(self.activation);
            product::with_sums(self.gpu, &LAYERS, &specialisation, &products, &outputs);
        }
    }

    /// The windows of the rows of a layer: their number, and the operands of dW.
    fn windows_of_rows(&self, layer: &Live<'a, T>) -> Vec<(usize, [Binding<'a>; 3])> {
        let mut windows = Vec::new();
        in_windows(self.gpu, layer.dy.rows(), &self.operands(Direction::Weights, layer), |count, arrays| {
            windows.push((count, arrays.try_into().expect("three operands")));
        });
        windows
    }

    /// The operands of a layer, of which the first is dz: dy where y is positive.
    fn operands(&self, direction: Direction, layer: &Live<'a, T>) -> [Binding<'a>; 3] {
        let [x, weight] = [layer.places.x, layer.places.weight].map(|place| self.inputs[place].on_gpu(self.gpu));
        let other = match direction {
            Direction::Weights => Binding::Read(x),
            _ => Binding::Read(weight).all(),
        };
        let [dy, y] = [layer.dy, layer.y].map(|tensor| Binding::Read(tensor.on_gpu(self.gpu)));
        [dy, other, y]
    }

    fn sizes(&self, layer: &Live<'a, T>) -> [usize; 2] {
        sizes(self.inputs[layer.places.weight])
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
