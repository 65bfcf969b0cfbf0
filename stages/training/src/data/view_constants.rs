//! Constant tensors of views, cached on a GPU.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use shaders::tape::{Device, Real, Tensor};

/// Capacity of the cache, bytes: little memory for a GPU that can train on views of their size.
const MAX_BYTES: usize = 2 << 30;

/// Tensors of views that many steps read. A GPU receives each of them once, up to the capacity of the cache; on the CPU
/// they are recomputed, because caching them would double the memory of the data set. Results of long computations are
/// kept on both.
pub(crate) struct ViewConstants<T: Real> {
    cache: Mutex<Cache<T>>,
}

/// Cached tensors by name and the view's index.
struct Cache<T: Real> {
    tensors: BTreeMap<(&'static str, usize), Tensor<T>>,
    bytes: usize,
}

impl<T: Real> Default for ViewConstants<T> {
    fn default() -> Self {
        Self { cache: Mutex::new(Cache { tensors: BTreeMap::new(), bytes: 0 }) }
    }
}

impl<T: Real> ViewConstants<T> {
    /// The tensor `what` of a view on a device, from the cache or from `make`.
    pub(crate) fn get(
        &self,
        device: Device,
        what: &'static str,
        view: usize,
        make: impl FnOnce() -> Tensor<T>,
    ) -> Tensor<T> {
        if device == Device::Cpu {
            return make();
        }
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(tensor) = cache.tensors.get(&(what, view)) {
            return tensor.clone();
        }
        let tensor = make().moved_to(device);
        cache.keep((what, view), &tensor);
        tensor
    }

    /// A tensor that [`ViewConstants::keep`] kept, on any device.
    pub(crate) fn kept(&self, what: &'static str, view: usize) -> Option<Tensor<T>> {
        let cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        cache.tensors.get(&(what, view)).cloned()
    }

    /// Keeps a small tensor that is expensive to compute, as long as the cache has capacity. Unlike [`ViewConstants::get`], it is
    /// kept on the CPU, too.
    pub(crate) fn keep(&self, what: &'static str, view: usize, tensor: &Tensor<T>) {
        self.cache.lock().unwrap_or_else(PoisonError::into_inner).keep((what, view), tensor);
    }
}

impl<T: Real> Cache<T> {
    /// Keeps a tensor if it fits.
    fn keep(&mut self, key: (&'static str, usize), tensor: &Tensor<T>) {
        let bytes = size_of::<T>() * tensor.len();
        if self.bytes + bytes <= MAX_BYTES {
            self.bytes += bytes;
            self.tensors.insert(key, tensor.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use shaders::check::test_gpu;

    use super::*;

    #[test]
    fn kept_tensors_are_found_by_name_and_view() {
        let constants = ViewConstants::<f32>::default();
        constants.keep("answer", 3, &Tensor::full([2], 7.0));
        assert_eq!(constants.kept("answer", 3).unwrap().as_slice(), [7.0; 2]);
        assert!(constants.kept("answer", 2).is_none() && constants.kept("other", 3).is_none());
    }

    #[test]
    fn a_gpu_receives_every_tensor_once() {
        let made = Cell::new(0);
        let constants = ViewConstants::<f32>::default();
        let ask = |device, what, view| {
            let make = || {
                made.set(made.get() + 1);
                Tensor::full([2], view as f32)
            };
            assert_eq!(constants.get(device, what, view, make).as_slice(), [view as f32; 2]);
        };
        (0..3).for_each(|_| ask(Device::Cpu, "depth", 1));
        assert_eq!(made.replace(0), 3);
        let Some(gpu) = test_gpu() else { return };
        for _ in 0..3 {
            for (what, view) in [("depth", 1), ("depth", 2), ("flow", 1)] {
                ask(Device::Gpu(gpu), what, view);
            }
        }
        assert_eq!(made.get(), 3);
    }
}
