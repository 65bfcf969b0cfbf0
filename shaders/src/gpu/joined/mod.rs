//! On adapters that allow a kernel fewer arrays than it has, the arrays that it only reads are copied into one before the
//! launch, and its text is rewritten to read them there. No kernel writes more than 7 arrays, so the 8 that WebGPU
//! guarantees are enough.
//!
//! The joined array of 32-bit numbers begins with two numbers per array: where its copy begins and how many numbers it has.

#[cfg(test)]
pub(crate) mod tests;

use super::accessors::{DeclaredArray, through_functions, without_comments};
use super::launch::{Kernel, uniforms};
use super::{Binding, Gpu, GpuArray, GpuFailure, Groups};

/// Arrays that an adapter must allow a kernel: the most that a kernel writes, and the joined one.
pub(super) const FEWEST_ARRAYS: u32 = 8;

const JOIN: Kernel = Kernel { name: "join", text: include_str!("join.wgsl") };

uniforms! {
    struct PlaceBlock as "Place" {
        index: u32,
        first: u32,
        len: u32,
    }
}

/// Copies of the arrays that a kernel only reads, in one array.
pub(super) struct Joined {
    numbers: GpuArray,
}

impl Joined {
    /// Records the copies if a kernel with these arrays needs them. Panics with a [`GpuFailure`] if they exceed a binding.
    pub(super) fn of(gpu: Gpu, kernel: &str, arrays: &[Binding]) -> Option<Self> {
        #[cfg(test)]
        tests::count_large(arrays.len());
        if arrays.len() <= gpu.arrays_per_kernel() {
            return None;
        }
        let read: Vec<Binding> = arrays.iter().copied().filter(|array| array.is_read_only()).collect();
        let heads = 2 * read.len();
        let len = heads + read.iter().map(|array| array.len()).sum::<usize>();
        if 4 * len as u64 > gpu.visible_bytes() {
            let (name, allowed, most) = (gpu.name(), gpu.arrays_per_kernel(), gpu.visible_bytes());
            let limit = format!("adapter {name:?} allows {allowed} arrays of {most} bytes in kernel {kernel:?}");
            let needed = format!("its {} inputs, joined in one array, have {} bytes", read.len(), 4 * len);
            GpuFailure::OutOfMemory(format!("{limit}, and {needed}")).raise();
        }
        let numbers = GpuArray::new(gpu, len);
        let mut first = heads;
        for (index, array) in read.into_iter().enumerate() {
            let place = PlaceBlock { index: index as u32, first: first as u32, len: array.len() as u32 };
            first += array.len();
            JOIN.launch(gpu, &[], &place, &[array, Binding::Write(&numbers)], Groups::Over(array.len().max(1)));
        }
        #[cfg(test)]
        tests::count_joined();
        Some(Self { numbers })
    }

    /// The arrays to bind: the joined one, then those that the kernel writes.
    pub(super) fn bindings<'a>(&'a self, arrays: &[Binding<'a>]) -> Vec<Binding<'a>> {
        let written = arrays.iter().copied().filter(|array| !array.is_read_only());
        std::iter::once(Binding::Read(&self.numbers)).chain(written).collect()
    }
}

/// The text of a kernel with this many arrays, which reads those that it does not write from the joined array.
pub(super) fn text(whole: &str, arrays: usize) -> String {
    let whole = without_comments(whole);
    let arrays: Vec<DeclaredArray> = (1..=arrays).map(|binding| DeclaredArray::at(&whole, binding)).collect();
    let (written, read): (Vec<_>, Vec<_>) = arrays.iter().partition(|array| array.is_written);
    let mut body = whole.clone();
    for array in &read {
        body = body.replace(&format!("{};", array.statement), "");
    }
    for (index, array) in written.iter().enumerate() {
        let (_, declared) = array.statement.split_once(" var<").expect("a declaration");
        let moved = format!("@group(0) @binding({}) var<{declared}", index + 2);
        body = body.replace(array.statement, &moved);
    }
    let names: Vec<&str> = read.iter().map(|array| array.name).collect();
    let functions: String = read.iter().enumerate().map(|(index, array)| functions(index, array)).collect();
    let joined = "@group(0) @binding(1) var<storage, read> joined_numbers: array<u32>;\n";
    format!("{joined}{functions}{}", through_functions(&body, &names))
}

/// The functions that read an array from the joined one.
fn functions(index: usize, array: &DeclaredArray) -> String {
    let DeclaredArray { name, element, .. } = array;
    let lanes = array.lanes();
    let number = |lane: usize| format!("joined_numbers[first + {lane}u]");
    let bits = match lanes {
        1 => number(0),
        _ => format!("vec{lanes}<u32>({})", (0..lanes).map(number).collect::<Vec<_>>().join(", ")),
    };
    let (head, len) = (2 * index, 2 * index + 1);
    let get = format!(
        "fn get_{name}(at: u32) -> {element} {{\n    let first = joined_numbers[{head}u] + at * {lanes}u;\n    \
         return bitcast<{element}>({bits});\n}}\n"
    );
    get + &format!("fn len_{name}() -> u32 {{ return joined_numbers[{len}u] / {lanes}u; }}\n")
}
