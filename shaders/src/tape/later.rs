//! What a computation says of itself, to be looked at later, so that nobody waits for a GPU in the meantime.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Real, Tape, Tensor};
use crate::gpu::{GpuArray, Length};

/// What a GPU counts.
pub enum Later {
    /// How often each of these happened.
    Events { names: Vec<&'static str>, counts: Arc<GpuArray> },
    /// How many intersections a render has, for which there was so much room.
    Intersections { length: Arc<Length>, room: usize },
}

impl Later {
    fn array(&self) -> &GpuArray {
        match self {
            Self::Events { counts, .. } => counts,
            Self::Intersections { length, .. } => length.array(),
        }
    }

    fn tell(&self, numbers: &[u32], found: &mut Found) {
        match self {
            Self::Events { names, .. } => {
                let happened = names.iter().zip(numbers).filter(|(_, count)| **count > 0);
                happened.for_each(|(name, count)| *found.events.entry(name).or_default() += u64::from(*count));
            }
            Self::Intersections { room, .. } => {
                let wanted = numbers[1] as usize;
                found.intersections = found.intersections.max(wanted);
                found.fits &= wanted <= *room;
            }
        }
    }
}

/// Figures of one step, wherever they are.
pub struct Figures {
    later: Vec<Later>,
    tensors: Vec<Tensor<f32>>,
}

/// What they turned out to be.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// How often something happened.
    pub events: BTreeMap<&'static str, u64>,
    /// The most intersections of a render.
    pub intersections: usize,
    /// Whether there was room for them: else nothing of the step is worth anything.
    pub fits: bool,
    /// The elements of each tensor.
    pub values: Vec<Vec<f32>>,
}

impl Figures {
    /// What a tape has still to say, and tensors.
    pub fn of<T: Real>(tape: &mut Tape<T>, tensors: Vec<Tensor<f32>>) -> Self {
        Self { later: std::mem::take(&mut tape.later), tensors }
    }

    /// Adds a tensor to look at.
    pub fn push(&mut self, tensor: Tensor<f32>) {
        self.tensors.push(tensor);
    }

    /// Everything, with one readback for what is on a GPU.
    pub fn read<'f>(all: impl IntoIterator<Item = &'f Self>) -> Vec<Found> {
        let all: Vec<&Self> = all.into_iter().collect();
        let arrays: Vec<&GpuArray> = all.iter().flat_map(|figures| figures.arrays()).collect();
        let mut read = GpuArray::read_all(&arrays).into_iter();
        all.iter().map(|figures| figures.found(&mut read)).collect()
    }

    /// In the order in which [`Figures::found`] takes them.
    fn arrays(&self) -> impl Iterator<Item = &GpuArray> {
        self.later.iter().map(Later::array).chain(self.tensors.iter().filter_map(Tensor::only_on_gpu))
    }

    fn found(&self, read: &mut impl Iterator<Item = Vec<u32>>) -> Found {
        let mut next = || read.next().expect("one of each array");
        let mut found = Found { fits: true, ..Found::default() };
        self.later.iter().for_each(|later| later.tell(&next(), &mut found));
        let values = |tensor: &Tensor<f32>| match tensor.only_on_gpu() {
            Some(_) => next().into_iter().map(f32::from_bits).collect(),
            None => tensor.as_slice().to_vec(),
        };
        found.values = self.tensors.iter().map(values).collect();
        found
    }
}
