use std::sync::Arc;

use rayon::prelude::*;

use super::Real;
use super::chunks::CHUNK;

/// Where values live and operations run.
#[derive(Copy, Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Device {
    #[default]
    Cpu,
}

#[derive(Clone, Debug)]
enum Storage<T> {
    Cpu(Arc<Vec<T>>),
}

/// A dense row-major array; cloning shares the data, writing copies it if it is shared.
#[derive(Clone, Debug)]
pub struct Tensor<T: Real> {
    shape: Vec<usize>,
    storage: Storage<T>,
}

impl<T: Real> Tensor<T> {
    /// Takes `data` of `shape.iter().product()` elements.
    pub fn from_vec(shape: impl Into<Vec<usize>>, data: Vec<T>) -> Self {
        let shape = shape.into();
        assert_eq!(shape.iter().product::<usize>(), data.len(), "tensor of shape {shape:?}: wrong number of elements");
        Self { shape, storage: Storage::Cpu(Arc::new(data)) }
    }

    pub fn zeros(shape: impl Into<Vec<usize>>) -> Self {
        Self::full(shape, T::ZERO)
    }

    pub fn full(shape: impl Into<Vec<usize>>, value: T) -> Self {
        let shape = shape.into();
        let len = shape.iter().product();
        Self::from_vec(shape, vec![value; len])
    }

    /// A tensor of shape `[1]`.
    pub fn scalar(value: T) -> Self {
        Self::from_vec([1], vec![value])
    }

    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The number of elements.
    pub fn len(&self) -> usize {
        self.as_slice().len()
    }

    pub fn is_empty(&self) -> bool {
        self.as_slice().is_empty()
    }

    /// The first dimension; 1 for a tensor without dimensions.
    pub fn rows(&self) -> usize {
        self.shape.first().copied().unwrap_or(1)
    }

    /// The number of elements per row: the product of all dimensions but the first.
    pub fn row_len(&self) -> usize {
        self.shape.iter().skip(1).product()
    }

    pub fn device(&self) -> Device {
        match self.storage {
            Storage::Cpu(_) => Device::Cpu,
        }
    }

    pub fn as_slice(&self) -> &[T] {
        let Storage::Cpu(data) = &self.storage;
        data
    }

    pub fn row(&self, index: usize) -> &[T] {
        let row_len = self.row_len();
        &self.as_slice()[index * row_len..(index + 1) * row_len]
    }

    /// The elements for writing; copied first if another tensor shares them.
    pub fn make_mut(&mut self) -> &mut [T] {
        let Storage::Cpu(data) = &mut self.storage;
        Arc::<Vec<T>>::make_mut(data)
    }

    /// The elements as a vector; copied if another tensor shares them.
    pub fn into_vec(self) -> Vec<T> {
        let Storage::Cpu(data) = self.storage;
        Arc::unwrap_or_clone(data)
    }

    /// The same elements under another shape of equal size.
    pub fn reshape(self, shape: impl Into<Vec<usize>>) -> Self {
        let shape = shape.into();
        assert_eq!(shape.iter().product::<usize>(), self.len(), "reshape {:?} to {shape:?}", self.shape);
        Self { shape, storage: self.storage }
    }

    /// The elements converted to another scalar type.
    pub fn cast<U: Real>(&self) -> Tensor<U> {
        Tensor::from_vec(self.shape.clone(), self.as_slice().iter().map(|value| U::from_f64(value.to_f64())).collect())
    }

    /// Whether no element is infinite or NaN.
    pub fn is_finite(&self) -> bool {
        // Without an early exit, which would keep the loop from being vectorised.
        let finite = |part: &[T]| part.iter().fold(true, |finite, value| finite & value.is_finite());
        match self.len() {
            ..=CHUNK => finite(self.as_slice()),
            _ => self.as_slice().par_chunks(CHUNK).all(finite),
        }
    }
}

/// Equal shape and equal values; a NaN equals nothing.
impl<T: Real> PartialEq for Tensor<T> {
    fn eq(&self, other: &Self) -> bool {
        self.shape == other.shape && self.as_slice() == other.as_slice()
    }
}
