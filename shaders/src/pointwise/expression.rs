use std::any::Any;

use crate::gpu::Gpu;
use crate::tape::chunks::{CHUNK, chunked};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// `kernel(inputs, constants, out)`: the value of every element.
pub type ValueKernel<T> = fn(&[&[T]], &[T], &mut [T]);

/// `kernel(inputs, constants, y, dy, out)`: the gradient of every element with respect to one input.
pub type GradientKernel<T> = fn(&[&[T]], &[T], &[T], &[T], &mut [T]);

/// An expression over the elements of equally shaped tensors, as written once in [`pointwise!`](crate::pointwise!).
pub struct Expression {
    /// The name of the operation and of its kernel.
    pub name: &'static str,
    /// The number of input tensors.
    pub inputs: usize,
    /// The number of scalar constants.
    pub constants: usize,
    /// `fn name(inputs, constants) -> f32` and, for every input i, `fn name_d_i(inputs, constants, y, dy) -> f32`.
    pub wgsl: &'static str,
    /// The value in f32.
    pub value_f32: ValueKernel<f32>,
    /// The value in f64.
    pub value_f64: ValueKernel<f64>,
    /// The gradient with respect to each input, in f32.
    pub gradients_f32: &'static [GradientKernel<f32>],
    /// The gradient with respect to each input, in f64.
    pub gradients_f64: &'static [GradientKernel<f64>],
}

impl Expression {
    /// Evaluates the expression on the tape; all inputs and the output have one shape.
    pub fn apply<T: Real>(&'static self, tape: &mut Tape<T>, inputs: &[Var], constants: &[f64]) -> Var {
        assert_eq!((inputs.len(), constants.len()), (self.inputs, self.constants), "{}: wrong arguments", self.name);
        let constants = constants.iter().map(|&constant| T::from_f64(constant)).collect();
        tape.apply_one(Pointwise { expression: self, constants }, inputs)
    }

    /// Whether the gradient of an input equals that of the output, as for a term of a sum; then it is not computed.
    pub(super) fn passes_on(&self, input: usize) -> bool {
        let gradient = self.wgsl.split("fn ").skip(2).nth(input).expect("a function for every input");
        gradient.lines().nth(1).is_some_and(|line| line.trim() == "return dy;")
    }

    fn value<T: Real>(&self) -> ValueKernel<T> {
        of_type(&self.value_f32, &self.value_f64)
    }

    fn gradient<T: Real>(&self, input: usize) -> GradientKernel<T> {
        of_type(&self.gradients_f32[input], &self.gradients_f64[input])
    }
}

/// The one of two values that has the type `K`.
fn of_type<A: 'static, B: 'static, K: Copy + 'static>(a: &A, b: &B) -> K {
    let found = (a as &dyn Any).downcast_ref::<K>().or_else(|| (b as &dyn Any).downcast_ref());
    *found.expect("a Real is f32 or f64")
}

pub(super) struct Pointwise<T> {
    pub(super) expression: &'static Expression,
    pub(super) constants: Vec<T>,
}

impl<T: Real> Pointwise<T> {
    /// The one shape of all inputs.
    pub(super) fn shape<'a>(&self, inputs: &[&'a Tensor<T>]) -> &'a [usize] {
        let shape = inputs[0].shape();
        assert!(inputs.iter().all(|input| input.shape() == shape), "{}: shapes differ", self.expression.name);
        shape
    }
}

impl<T: Real> Op<T> for Pointwise<T> {
    fn name(&self) -> &'static str {
        self.expression.name
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let shape = self.shape(inputs);
        let kernel = self.expression.value::<T>();
        let values = |first, out: &mut [T]| kernel(&parts(inputs, first, out.len()), &self.constants, out);
        let out = chunked(inputs[0].len(), CHUNK, values);
        vec![Tensor::from_vec(shape, out)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, needs, .. } = pass;
        let dy = pass.dy();
        let gradient = |input: usize| {
            if self.expression.passes_on(input) {
                return dy.clone();
            }
            let kernel = self.expression.gradient::<T>(input);
            let out = chunked(dy.len(), CHUNK, |first, out| {
                let range = first..first + out.len();
                let (y, dy) = (&outputs[0].as_slice()[range.clone()], &dy.as_slice()[range]);
                kernel(&parts(inputs, first, out.len()), &self.constants, y, dy, out);
            });
            Tensor::from_vec(dy.shape(), out)
        };
        (0..inputs.len()).map(|input| needs[input].then(|| gradient(input))).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Pointwise<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.value_on_gpu(gpu, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, outputs, needs, .. } = pass;
        let dy = pass.dy();
        self.gradients_on_gpu(gpu, inputs, outputs[0], dy, needs)
    }
}

/// Elements `first..first + len` of every tensor.
fn parts<'a, T: Real>(tensors: &[&'a Tensor<T>], first: usize, len: usize) -> Vec<&'a [T]> {
    tensors.iter().map(|tensor| &tensor.as_slice()[first..first + len]).collect()
}
