//! Readback of a step's results on a GPU, deferred so that the step itself never waits for the GPU.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Real, Tape, Tensor};
use crate::gpu::{GpuArray, Length, ReadingArrays};

/// A count in a GPU's memory that has not been read back yet.
pub(crate) enum DeferredCount {
    /// How often each of these events happened.
    Events { names: Vec<&'static str>, counts: Arc<GpuArray> },
    /// The number of intersections of one render, and the capacity of its buffers.
    Intersections { length: Arc<Length>, capacity: usize },
}

impl DeferredCount {
    fn array(&self) -> &GpuArray {
        match self {
            Self::Events { counts, .. } => counts,
            Self::Intersections { length, .. } => length.array(),
        }
    }

    /// Adds the numbers of its array to a readback.
    fn add_to(&self, readback: &mut Readback, numbers: &[u32]) {
        match self {
            Self::Events { names, .. } => {
                let happened = names.iter().zip(numbers).filter(|(_, count)| **count > 0);
                happened.for_each(|(name, count)| *readback.events.entry(name).or_default() += u64::from(*count));
            }
            Self::Intersections { capacity, .. } => {
                let wanted = numbers[1] as usize;
                readback.intersections = readback.intersections.max(wanted);
                readback.overflowed |= wanted > *capacity;
            }
        }
    }
}

/// The deferred counts of one step and the tensors that its report needs, on the host or on a GPU.
pub struct PendingReadback {
    counts: Vec<DeferredCount>,
    tensors: Vec<Tensor<f32>>,
}

/// The values of a [`PendingReadback`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Readback {
    /// How often each event happened.
    pub events: BTreeMap<&'static str, u64>,
    /// The largest number of intersections of any render.
    pub intersections: usize,
    /// Whether a render had more intersections than its capacity. If so, every result of the step is invalid.
    pub overflowed: bool,
    /// The elements of each tensor.
    pub values: Vec<Vec<f32>>,
}

impl PendingReadback {
    /// Takes the deferred counts out of a tape, and combines them with `tensors`.
    pub fn of<T: Real>(tape: &mut Tape<T>, tensors: Vec<Tensor<f32>>) -> Self {
        Self { counts: std::mem::take(&mut tape.deferred), tensors }
    }

    /// Adds a tensor.
    pub fn push(&mut self, tensor: Tensor<f32>) {
        self.tensors.push(tensor);
    }

    /// Reads back the values of several steps, in order. One readback fetches everything that is on a GPU.
    pub fn read<'p>(pending: impl IntoIterator<Item = &'p Self>) -> Vec<Readback> {
        let pending: Vec<&Self> = pending.into_iter().collect();
        let arrays: Vec<&GpuArray> = pending.iter().flat_map(|pending| pending.arrays()).collect();
        let mut read = GpuArray::read_all(&arrays).into_iter();
        pending.iter().map(|pending| pending.readback(&mut read)).collect()
    }

    /// Submits everything recorded on a GPU, and the copy of these values to the host.
    pub fn start(self) -> StartedReadback {
        let reading = GpuArray::start_reading(&self.arrays().collect::<Vec<_>>());
        StartedReadback { pending: self, reading }
    }

    /// The arrays to copy from the GPU, in the order in which [`PendingReadback::readback`] consumes them.
    fn arrays(&self) -> impl Iterator<Item = &GpuArray> {
        self.counts.iter().map(DeferredCount::array).chain(self.tensors.iter().filter_map(Tensor::only_on_gpu))
    }

    fn readback(&self, read: &mut impl Iterator<Item = Vec<u32>>) -> Readback {
        let mut next = || read.next().expect("one vector per array");
        let mut readback = Readback::default();
        self.counts.iter().for_each(|count| count.add_to(&mut readback, &next()));
        let values = |tensor: &Tensor<f32>| match tensor.only_on_gpu() {
            Some(_) => next().into_iter().map(f32::from_bits).collect(),
            None => tensor.as_slice().to_vec(),
        };
        readback.values = self.tensors.iter().map(values).collect();
        readback
    }
}

/// Values that are being copied to the host.
pub struct StartedReadback {
    pending: PendingReadback,
    reading: ReadingArrays,
}

impl StartedReadback {
    /// Blocks until the copy has completed, so that [`StartedReadback::finish`] returns without waiting.
    pub fn wait(&self) {
        self.reading.wait();
    }

    /// The values, after [`StartedReadback::wait`].
    pub fn finish(self) -> Readback {
        self.pending.readback(&mut self.reading.finish().into_iter())
    }
}
