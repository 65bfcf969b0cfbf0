use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use super::Real;
use super::chunks::CHUNK;
use crate::gpu::{AdapterError, Gpu, GpuArray};

/// Where operations run.
#[derive(Copy, Clone, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The host's processor.
    #[default]
    Cpu,
    /// A GPU; f32 only. Operations without kernels run on the CPU.
    Gpu(Gpu),
}

impl Device {
    /// The device `"cpu"`, or the adapter of that name ([`crate::gpu::choose`]).
    pub fn open(id: &str) -> Result<Self, AdapterError> {
        if id == "cpu" { Ok(Self::Cpu) } else { Ok(Self::Gpu(crate::gpu::choose(id)?.open()?)) }
    }

    /// Submits all recorded work without waiting.
    pub fn submit(self) {
        if let Self::Gpu(gpu) = self {
            gpu.submit();
        }
    }

    /// Waits until all recorded work is finished, e.g. to measure time.
    pub fn wait(self) {
        if let Self::Gpu(gpu) = self {
            gpu.wait();
        }
    }

    /// The GPU, if it is one.
    pub fn gpu(self) -> Option<Gpu> {
        match self {
            Self::Cpu => None,
            Self::Gpu(gpu) => Some(gpu),
        }
    }

    /// `"cpu"`, or the adapter's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu(gpu) => gpu.name(),
        }
    }
}

/// The elements on the host, on a GPU, or on both; at least one is present.
///
/// A copy is made on first use and kept, so that an operation need not know where its inputs are.
#[derive(Debug)]
struct Elements<T> {
    host: OnceLock<Vec<T>>,
    gpu: OnceLock<GpuArray>,
}

/// A dense row-major array; cloning shares the data, writing copies it if it is shared.
#[derive(Clone, Debug)]
pub struct Tensor<T: Real> {
    shape: Vec<usize>,
    elements: Arc<Elements<T>>,
}

/// The first element of each of several short tensors; elements on a GPU are fetched with one readback.
pub fn first_elements<T: Real>(tensors: &[&Tensor<T>]) -> Vec<T> {
    let on_gpu: Vec<&GpuArray> = tensors.iter().filter_map(|tensor| tensor.only_on_gpu()).collect();
    let mut of_gpu = GpuArray::read_all(&on_gpu).into_iter();
    let mut first = |tensor: &&Tensor<T>| match tensor.only_on_gpu() {
        Some(_) => T::from_f64(f32::from_bits(of_gpu.next().expect("one of each")[0]).into()),
        None => tensor.as_slice()[0],
    };
    tensors.iter().map(&mut first).collect()
}

impl<T: Real> Tensor<T> {
    /// Takes `data` of `shape.iter().product()` elements.
    pub fn from_vec(shape: impl Into<Vec<usize>>, data: Vec<T>) -> Self {
        let shape = shape.into();
        assert_eq!(shape.iter().product::<usize>(), data.len(), "tensor of shape {shape:?}: wrong number of elements");
        Self { shape, elements: Arc::new(Elements { host: data.into(), gpu: OnceLock::new() }) }
    }

    /// Takes an array of `shape.iter().product()` elements in a GPU's memory.
    pub(crate) fn from_gpu(shape: impl Into<Vec<usize>>, array: GpuArray) -> Self {
        let shape = shape.into();
        assert_eq!(T::NAME, "f32", "a GPU holds f32");
        assert_eq!(shape.iter().product::<usize>(), array.len(), "tensor of shape {shape:?}: wrong number of elements");
        Self { shape, elements: Arc::new(Elements { host: OnceLock::new(), gpu: array.into() }) }
    }

    /// A tensor of zeros.
    pub fn zeros(shape: impl Into<Vec<usize>>) -> Self {
        Self::full(shape, T::ZERO)
    }

    /// A tensor whose elements all have the same value.
    pub fn full(shape: impl Into<Vec<usize>>, value: T) -> Self {
        let shape = shape.into();
        let len = shape.iter().product();
        Self::from_vec(shape, vec![value; len])
    }

    /// A tensor of shape `[1]`.
    pub fn scalar(value: T) -> Self {
        Self::from_vec([1], vec![value])
    }

    /// The dimensions, outermost first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The number of elements.
    pub fn len(&self) -> usize {
        self.elements.host.get().map_or_else(|| self.shape.iter().product(), Vec::len)
    }

    /// Whether there are no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The first dimension; 1 for a tensor without dimensions.
    pub fn rows(&self) -> usize {
        self.shape.first().copied().unwrap_or(1)
    }

    /// The number of elements per row: the product of all dimensions but the first.
    pub fn row_len(&self) -> usize {
        self.shape.iter().skip(1).product()
    }

    /// The elements in the host's memory, read back first if a GPU computed them.
    pub fn as_slice(&self) -> &[T] {
        self.elements.host()
    }

    /// The elements on the GPU, uploaded first if necessary.
    pub(crate) fn on_gpu(&self, gpu: Gpu) -> &GpuArray {
        let upload = || GpuArray::upload(gpu, T::as_f32(self.as_slice()).expect("a GPU holds f32"));
        let array = self.elements.gpu.get_or_init(upload);
        assert_eq!(array.gpu(), gpu, "a tensor is used on one GPU");
        array
    }

    /// The tensor with its elements on this GPU only; unchanged for [`Device::Cpu`].
    pub fn moved_to(self, device: Device) -> Self {
        let Some(gpu) = device.gpu() else { return self };
        let array = GpuArray::upload(gpu, T::as_f32(self.as_slice()).expect("a GPU holds f32"));
        Self::from_gpu(self.shape, array)
    }

    /// The GPU array, if the host has no copy of the elements.
    pub(crate) fn only_on_gpu(&self) -> Option<&GpuArray> {
        self.elements.gpu.get().filter(|_| !self.is_on_host())
    }

    /// Whether both share their elements (identity, not equality).
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.elements, &other.elements)
    }

    /// Whether the elements are in the host's memory, so that reading them costs no readback.
    pub(crate) fn is_on_host(&self) -> bool {
        self.elements.host.get().is_some()
    }

    /// The GPU that holds the elements, or the CPU if no GPU does.
    pub fn device(&self) -> Device {
        self.gpu().map_or(Device::Cpu, Device::Gpu)
    }

    /// The GPU that holds the elements, if any.
    pub(crate) fn gpu(&self) -> Option<Gpu> {
        self.elements.gpu.get().map(GpuArray::gpu)
    }

    /// The elements of one row.
    pub fn row(&self, index: usize) -> &[T] {
        let row_len = self.row_len();
        &self.as_slice()[index * row_len..(index + 1) * row_len]
    }

    /// The elements for writing; copied first if another tensor shares them.
    pub fn make_mut(&mut self) -> &mut [T] {
        if Arc::get_mut(&mut self.elements).is_none() {
            *self = Self::from_vec(std::mem::take(&mut self.shape), self.as_slice().to_vec());
        }
        let elements = Arc::get_mut(&mut self.elements).expect("the elements are not shared");
        elements.host();
        // A copy elsewhere would be out of date.
        elements.gpu = OnceLock::new();
        elements.host.get_mut().expect("it is there")
    }

    /// The elements in the GPU's memory for kernels that write there; copied first if another tensor shares them.
    pub(crate) fn make_mut_on_gpu(&mut self, gpu: Gpu) -> &GpuArray {
        self.on_gpu(gpu);
        if Arc::get_mut(&mut self.elements).is_none() {
            *self = Self::from_gpu(self.shape(), self.on_gpu(gpu).copied());
        }
        let elements = Arc::get_mut(&mut self.elements).expect("the elements are not shared");
        // A copy on the host would be out of date.
        elements.host = OnceLock::new();
        elements.gpu.get().expect("it is there")
    }

    /// The elements as a vector; copied if another tensor shares them.
    pub fn into_vec(self) -> Vec<T> {
        self.as_slice();
        match Arc::try_unwrap(self.elements) {
            Ok(elements) => elements.host.into_inner().expect("it is there"),
            Err(shared) => shared.host().to_vec(),
        }
    }

    /// The tensor with another shape of equal size.
    pub fn reshape(self, shape: impl Into<Vec<usize>>) -> Self {
        let shape = shape.into();
        assert_eq!(shape.iter().product::<usize>(), self.len(), "reshape {:?} to {shape:?}", self.shape);
        Self { shape, elements: self.elements }
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

impl<T: Real> Elements<T> {
    fn host(&self) -> &Vec<T> {
        self.host.get_or_init(|| {
            let array = self.gpu.get().expect("elements are somewhere");
            let mut data = vec![T::ZERO; array.len()];
            array.read_into(T::as_f32_mut(&mut data).expect("a GPU holds f32"));
            data
        })
    }
}

/// Equal shape and equal values; a NaN equals nothing.
impl<T: Real> PartialEq for Tensor<T> {
    fn eq(&self, other: &Self) -> bool {
        self.shape == other.shape && self.as_slice() == other.as_slice()
    }
}
