//! Arrays that exceed the maximum size of a binding are bound in several parts, and the text of any kernel is rewritten
//! to select the part by index ([`text`]). The size of a scene is limited by the adapter's memory only.

#[cfg(test)]
pub(crate) mod tests;
pub(crate) mod text;

use super::binding::ALIGNMENT;
use super::{Binding, Gpu, GpuFailure};

/// The number of 32-bit values of an array that one binding shows: the adapter's limit, rounded down to where another part
/// can begin.
pub(crate) fn visible_len(gpu: Gpu) -> usize {
    #[cfg(test)]
    if let Some(len) = tests::changed_len() {
        return len;
    }
    let numbers = usize::try_from(gpu.visible_bytes() / 4).unwrap_or(usize::MAX);
    numbers / ALIGNMENT * ALIGNMENT
}

/// The number of parts of an array of `len` numbers.
pub(crate) fn count(gpu: Gpu, len: usize) -> usize {
    count_of(len, visible_len(gpu))
}

/// The number of parts of `len` numbers each.
fn count_of(array_len: usize, len: usize) -> usize {
    array_len.div_ceil(len).max(1)
}

/// The arrays of a launch, some of them in parts.
pub(crate) struct Parts<'a> {
    /// The number of parts of every array.
    counts: Vec<usize>,
    /// 32-bit numbers of every part but the last.
    len: usize,
    /// The arrays or their first parts, followed by the remaining parts.
    pub(crate) bindings: Vec<Binding<'a>>,
}

impl<'a> Parts<'a> {
    /// The parts of a kernel's arrays; `None` if every array fits into one binding. Panics with a [`GpuFailure`] if there are
    /// too many parts.
    pub(crate) fn of(gpu: Gpu, kernel: &str, arrays: &[Binding<'a>]) -> Option<Self> {
        let len = visible_len(gpu);
        #[cfg(test)]
        let len = tests::bindable_len(gpu, arrays, len);
        let counts: Vec<usize> = arrays.iter().map(|array| count_of(array.len(), len)).collect();
        if counts.iter().all(|&count| count == 1) {
            return None;
        }
        let part = |array: Binding<'a>, index: usize| {
            let first = index * len;
            array.within(first, len.min(array.len() - first))
        };
        let firsts = arrays.iter().map(|&array| part(array, 0));
        let others = arrays.iter().zip(&counts);
        let others = others.flat_map(|(&array, &count)| (1..count).map(move |index| part(array, index)));
        let bindings: Vec<Binding> = firsts.chain(others).collect();
        let allowed = gpu.arrays_per_kernel();
        if bindings.len() > allowed {
            let (name, bytes, kernel, needed) = (gpu.name(), 4 * len, kernel, bindings.len());
            let limit = format!("adapter {name:?} allows {allowed} arrays of {bytes} bytes in kernel {kernel:?}");
            GpuFailure::OutOfMemory(format!("{limit}, and {needed} are needed")).raise();
        }
        Some(Self { counts, len, bindings })
    }

    /// The part of the pipeline's name that identifies the parts.
    pub(crate) fn name(&self) -> String {
        let name = format!(" [parts {:?} of {}]", self.counts, self.len);
        #[cfg(test)]
        let name = super::fault_tests::marked("parts", name);
        name
    }

    /// The text of the kernel for its arrays in parts.
    pub(crate) fn text(&self, whole: &str) -> String {
        text::in_parts(whole, &self.counts, self.len)
    }
}
