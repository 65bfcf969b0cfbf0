//! A tape over coarse differentiable operations: it records the applied operations and runs them in reverse.
//!
//! The tape is independent of what an operation computes. A kernel is an `Op`; a model is a function that takes a tape
//! and variables and returns variables. Everything is generic over [`Real`]: code that trains in `f32` is checked in `f64`
//! against central differences (see [`crate::check`]).

mod backward;
pub mod chunks;
mod op;
mod pair_sums;
mod profile;
mod readback;
mod real;
pub(crate) mod simd;
mod tensor;
#[cfg(test)]
mod tests;
mod totals;
mod upstream;

use std::time::Instant;

pub use backward::Gradients;
use backward::Node;
pub(crate) use op::exactly;
pub(crate) use op::{Backward, GpuOp, Op};
pub(crate) use pair_sums::sums_on_gpu;
pub use profile::{Cost, OpCost, Profile};
pub(crate) use readback::DeferredCount;
pub use readback::{PendingReadback, Readback, StartedReadback};
pub use real::Real;
pub use tensor::{Device, Tensor, first_elements};
pub(crate) use totals::total_on_gpu;
pub(crate) use upstream::upstream;

/// A value on a tape.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Var(usize);

struct Value<T: Real> {
    tensor: Tensor<T>,
    needs_gradient: bool,
}

/// The record of a computation: leaves, constants and the operations applied to them.
pub struct Tape<T: Real> {
    device: Device,
    values: Vec<Value<T>>,
    nodes: Vec<Node<T>>,
    profile: Profile,
    /// Counts on a GPU that have not been read back.
    deferred: Vec<DeferredCount>,
    /// Intersections that the buffers of a render on a GPU hold; `None`: each render reads back its number first.
    capacity: Option<usize>,
    /// The values detached so far.
    detached: Vec<Tensor<T>>,
    /// The values that an earlier tape detached, which replace those of this tape.
    replayed: Option<Vec<Tensor<T>>>,
}

impl<T: Real> Tape<T> {
    /// An empty tape. Panics for f64 on a GPU, which computes in f32.
    pub fn new(device: Device) -> Self {
        assert!(device == Device::Cpu || T::NAME == "f32", "a GPU computes in f32, not in {}", T::NAME);
        let (values, nodes, profile) = (Vec::new(), Vec::new(), Profile::default());
        Self {
            device,
            values,
            nodes,
            profile,
            deferred: Vec::new(),
            capacity: None,
            detached: Vec::new(),
            replayed: None,
        }
    }

    /// This tape with a fixed capacity: its renders on a GPU allocate buffers for this many intersections and never wait
    /// for their number. A render with more of them is invalid, which [`Readback::overflowed`] reports.
    pub fn with_capacity(self, intersections: usize) -> Self {
        Self { capacity: Some(intersections), ..self }
    }

    /// An empty tape on the same device and with the same capacity, for computations outside differentiation whose values
    /// need not live until the backward pass.
    pub fn child(&self) -> Self {
        Self { capacity: self.capacity, ..Self::new(self.device) }
    }

    /// Takes over the events and the deferred counts of a child tape, e.g. an overflow of its renders.
    pub fn absorb(&mut self, child: Self) {
        child.profile.events.iter().for_each(|(what, times)| self.profile.count(what, *times));
        self.deferred.extend(child.deferred);
    }

    /// Later renders on a GPU read back the number of their intersections before they allocate.
    pub fn clear_capacity(&mut self) {
        self.capacity = None;
    }

    pub(crate) fn capacity(&self) -> Option<usize> {
        self.capacity
    }

    /// Keeps a count on the GPU until a readback.
    pub(crate) fn defer(&mut self, count: DeferredCount) {
        self.deferred.push(count);
    }

    /// Reads back the deferred counts so far, adds them to the profile's events and returns them.
    pub fn read_back(&mut self) -> Readback {
        let pending = PendingReadback::of(self, Vec::new());
        let readback = PendingReadback::read([&pending]).remove(0);
        readback.events.iter().for_each(|(what, count)| self.profile.count(what, *count));
        readback
    }

    /// A tape for central differences of what an earlier tape computed: where that tape detached a value, this
    /// one uses the earlier value ([`Tape::detached`]). Its differences then equal the gradients of the earlier tape, which
    /// treat detached values as constants.
    pub fn replaying(device: Device, detached: &[Tensor<T>]) -> Self {
        Self { replayed: Some(detached.to_vec()), ..Self::new(device) }
    }

    /// The device on which operations run.
    pub fn device(&self) -> Device {
        self.device
    }

    /// A value with a gradient.
    pub fn leaf(&mut self, tensor: Tensor<T>) -> Var {
        self.push(tensor, true)
    }

    /// A value that is not differentiated.
    pub fn constant(&mut self, tensor: Tensor<T>) -> Var {
        self.push(tensor, false)
    }

    /// A constant with the value of `var`: no gradient flows through it.
    pub fn detach(&mut self, var: Var) -> Var {
        let tensor = self.value(var).clone();
        self.detach_value(tensor)
    }

    /// Detaches a tensor that was computed from this tape's values outside the tape.
    pub fn detach_value(&mut self, tensor: Tensor<T>) -> Var {
        let tensor = match &self.replayed {
            None => tensor,
            Some(earlier) => {
                let earlier = earlier.get(self.detached.len()).expect("the earlier tape cut off as many values");
                assert_eq!(earlier.shape(), tensor.shape(), "the earlier tape cut off another value here");
                earlier.clone()
            }
        };
        self.detached.push(tensor.clone());
        self.constant(tensor)
    }

    /// All detached values, in order.
    pub fn detached(&self) -> &[Tensor<T>] {
        &self.detached
    }

    /// The value of a variable.
    pub fn value(&self, var: Var) -> &Tensor<T> {
        &self.values[var.0].tensor
    }

    /// Whether a gradient flows to this value.
    pub(crate) fn needs_gradient(&self, var: Var) -> bool {
        self.values[var.0].needs_gradient
    }

    /// Seconds and calls per operation name so far, and counts of events. Events that a GPU counts are included only
    /// after [`Tape::read_back`].
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Adds to the count of a named event, which the results report.
    pub fn count(&mut self, what: &'static str, times: u64) {
        self.profile.count(what, times);
    }

    /// Runs an operation now and records it for the backward pass if any input needs a gradient.
    pub(crate) fn apply(&mut self, op: impl Op<T> + 'static, inputs: &[Var]) -> Vec<Var> {
        self.apply_boxed(Box::new(op), inputs)
    }

    /// Implements [`Self::apply`] on a trait object, so that it is compiled once instead of once per operation.
    fn apply_boxed(&mut self, mut op: Box<dyn Op<T>>, inputs: &[Var]) -> Vec<Var> {
        let tensors: Vec<&Tensor<T>> = inputs.iter().map(|&var| self.value(var)).collect();
        let start = Instant::now();
        let on_gpu = self.device.gpu().and_then(|gpu| Some((gpu, op.gpu()?.forward_gpu(gpu, &tensors)?)));
        let (gpu, outputs) = match on_gpu {
            Some((gpu, outputs)) => (Some(gpu), outputs),
            None => (None, op.forward(&tensors)),
        };
        self.profile.entry(op.name()).forward.add(start.elapsed());

        let needs_gradient = inputs.iter().any(|&var| self.needs_gradient(var));
        let first = self.values.len();
        let vars: Vec<Var> = outputs.into_iter().map(|tensor| self.push(tensor, needs_gradient)).collect();
        if needs_gradient {
            let outputs = first..self.values.len();
            self.nodes.push(Node { op, gpu, inputs: inputs.to_vec(), outputs });
        }
        vars
    }

    /// Runs and records an operation with exactly one output.
    pub(crate) fn apply_one(&mut self, op: impl Op<T> + 'static, inputs: &[Var]) -> Var {
        let name = op.name();
        let vars = self.apply(op, inputs);
        assert_eq!(vars.len(), 1, "{name}: expected one output");
        vars[0]
    }

    /// Gradients of Σ ⟨seed, value⟩ over the given (variable, seed of the same shape) pairs.
    ///
    /// Operations run in reverse order of creation and contributions add up in that order: the result does not depend on
    /// scheduling.
    pub fn backward(&mut self, seeds: &[(Var, Tensor<T>)]) -> Gradients<T> {
        let mut gradients = Gradients { tensors: vec![None; self.values.len()] };
        for (var, seed) in seeds {
            gradients.accumulate("seed", *var, self.value(*var), seed.clone());
        }
        for node in self.nodes.iter_mut().rev() {
            node.backward(&self.values, &mut gradients, &mut self.profile);
        }
        gradients
    }

    /// The first operation, in order of execution, with an output that is not finite: where a NaN arose.
    pub fn first_non_finite_op(&self) -> Option<&'static str> {
        let is_bad = |node: &&Node<T>| !self.values[node.outputs.clone()].iter().all(|value| value.tensor.is_finite());
        self.nodes.iter().find(is_bad).map(|node| node.op.name())
    }

    fn push(&mut self, tensor: Tensor<T>, needs_gradient: bool) -> Var {
        self.values.push(Value { tensor, needs_gradient });
        Var(self.values.len() - 1)
    }
}
