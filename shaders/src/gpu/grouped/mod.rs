//! One launch over many items, such as all tensors of a model: each has separate constants, arrays and workgroups.
//!
//! WGSL has no arrays of arrays. Therefore Rust generates the declarations of the arrays for the number of items of a
//! launch, with functions that choose among them by item: `values(item, at)`, `gather_values(item, at)` of four indices,
//! which waits for memory once, and, for arrays that the kernel writes, `set_values(item, at, value)`.
//!
//! A kernel imports `gpu::grouped::grouped` and defines `struct Item`. A workgroup finds its item with `item_of(group)`,
//! its index in the item with `group - first_group(item)`, and the item's constants with `constants_of(item)`. Workgroups
//! past the last item belong to that item, so a kernel compares with the sizes in its constants.

#[cfg(test)]
pub(crate) mod tests;

use super::{Binding, Gpu, Kernel, parts};

/// The stride of constants between items is a multiple of this, as WGSL requires.
const ALIGNMENT: usize = 16;
/// Maximum number of arrays of a launch, even on adapters that allow more: every access selects among the items.
const MOST_ARRAYS: usize = 256;
/// The most items of a launch: their constants fill a small part of those of a submission.
const MOST_ITEMS: usize = 64;

/// A kernel over items.
pub(crate) struct Grouped {
    pub kernel: Kernel,
    /// Arrays that all items share, which the text declares from binding 1 on.
    pub shared: usize,
    /// The arrays of every item.
    pub arrays: &'static [ItemArray],
}

/// An array that every item has.
pub(crate) struct ItemArray {
    name: &'static str,
    element: &'static str,
    is_written: bool,
}

/// One item of a launch.
pub(crate) struct Item<'a, C> {
    /// A `repr(C)` struct laid out as `Item`.
    pub constants: C,
    /// The arrays, in the order of [`Grouped::arrays`].
    pub arrays: Vec<Binding<'a>>,
    /// The number of workgroups of this item.
    pub groups: usize,
}

impl<'a, C> Item<'a, C> {
    /// Items that together cover arrays of `len` elements each: one item if a binding can show whole arrays, otherwise
    /// one item per slice. `constants` maps the number of elements of an item to its constants.
    pub(crate) fn in_parts(
        gpu: Gpu,
        len: usize,
        elements_per_group: usize,
        arrays: &[Binding<'a>],
        constants: impl Fn(u32) -> C,
    ) -> Vec<Self> {
        let visible = parts::visible_len(gpu);
        let item = |first: usize| {
            let len = visible.min(len - first);
            let arrays = arrays.iter().map(|array| array.within(first, len)).collect();
            Self { constants: constants(len as u32), arrays, groups: len.div_ceil(elements_per_group) }
        };
        (0..len).step_by(visible).map(item).collect()
    }
}

impl ItemArray {
    /// An array of f32 that is read.
    pub(crate) const fn read(name: &'static str) -> Self {
        Self { name, element: "f32", is_written: false }
    }

    /// An array of f32 that the kernel writes, and may read.
    pub(crate) const fn write(name: &'static str) -> Self {
        Self { name, element: "f32", is_written: true }
    }

    /// Declares the array as u32: the bits of f32, or whole numbers.
    pub(crate) const fn of_bits(self) -> Self {
        Self { element: "u32", ..self }
    }

    /// The declaration for one item.
    fn declaration(&self, item: usize, binding: usize) -> String {
        let Self { name, element, is_written } = self;
        let access = if *is_written { "read_write" } else { "read" };
        format!("@group(0) @binding({binding}) var<storage, {access}> {name}_{item}: array<{element}>;\n")
    }

    /// The functions that select among the arrays of this many items.
    fn functions(&self, items: usize) -> String {
        let Self { name, element, is_written } = self;
        let get = choice(items, |item| format!("return {name}_{item}[at];"));
        let four = ["x", "y", "z", "w"];
        let gather = choice(items, |item| {
            let [x, y, z, w] = four.map(|at| format!("{name}_{item}[at.{at}]"));
            format!("return vec4<{element}>({x}, {y}, {z}, {w});")
        });
        let mut text = format!("fn {name}(item: u32, at: u32) -> {element} {{\n{get}}}\n");
        text += &format!("fn gather_{name}(item: u32, at: vec4<u32>) -> vec4<{element}> {{\n{gather}}}\n");
        if *is_written {
            let set = choice(items, |item| format!("{name}_{item}[at] = value; return;"));
            text += &format!("fn set_{name}(item: u32, at: u32, value: {element}) {{\n{set}}}\n");
        }
        text
    }
}

/// WGSL that runs the statement of the item with index `item`; every statement must return. Indices past the end run
/// the last statement.
fn choice(items: usize, statement: impl Fn(usize) -> String) -> String {
    let (last, cases) = (statement(items - 1), 0..items - 1);
    let cases: String = cases.map(|item| format!("        case {item}u: {{ {} }}\n", statement(item))).collect();
    let switch =
        if cases.is_empty() { cases } else { format!("    switch item {{\n{cases}        default: {{}}\n    }}\n") };
    format!("{switch}    {last}\n")
}

impl Grouped {
    /// The items' arrays, and the functions that choose among them.
    fn declarations(&self, items: usize) -> String {
        let array = |(at, array): (usize, &ItemArray)| array.declaration(at / self.arrays.len(), 1 + self.shared + at);
        let declared = std::iter::repeat_n(self.arrays, items).flatten().enumerate().map(array);
        let functions = self.arrays.iter().map(|array| array.functions(items));
        declared.chain(functions).collect()
    }

    /// Items per launch if the kernel sees their arrays whole.
    pub(crate) fn capacity(&self, gpu: Gpu) -> usize {
        capacity(gpu, self.shared, self.arrays.len())
    }

    /// The number of items per launch, given the parts that the arrays of these items need.
    pub(crate) fn capacity_for<C>(&self, gpu: Gpu, shared: &[Binding], items: &[Item<C>]) -> usize {
        let parts = |arrays: &[Binding]| arrays.iter().map(|array| parts::count(gpu, array.len())).sum();
        let most = items.iter().map(|item| parts(&item.arrays)).max();
        capacity(gpu, parts(shared), most.unwrap_or(self.arrays.len()))
    }

    /// Records one run over all items, in as few launches as the adapter allows; items without workgroups are left out.
    pub(crate) fn launch<C: bytemuck::NoUninit>(
        &self,
        gpu: Gpu,
        specialisation: &[(&str, u32)],
        shared: &[Binding],
        items: &[Item<C>],
    ) {
        let capacity = self.capacity_for(gpu, shared, items);
        let items: Vec<&Item<C>> = items.iter().filter(|item| item.groups > 0).collect();
        // Of equal sizes, which share a pipeline.
        let launches = items.len().div_ceil(capacity).max(1);
        for items in items.chunks(items.len().div_ceil(launches).max(1)) {
            let mut groups = 0;
            let mut first_groups = Vec::new();
            for item in items {
                first_groups.push(groups as u32);
                groups += item.groups;
            }
            self.record(gpu, specialisation, shared, items, (first_groups, groups));
        }
    }

    /// Records one launch whose workgroups all process every item; at most [`Grouped::capacity`] items.
    pub(crate) fn launch_together<C: bytemuck::NoUninit>(
        &self,
        gpu: Gpu,
        specialisation: &[(&str, u32)],
        shared: &[Binding],
        items: &[Item<C>],
        groups: usize,
    ) {
        assert!(items.len() <= self.capacity(gpu), "{}: {} items in one launch", self.kernel.name, items.len());
        let items: Vec<&Item<C>> = items.iter().collect();
        self.record(gpu, specialisation, shared, &items, (vec![0; items.len()], groups));
    }

    fn record<C: bytemuck::NoUninit>(
        &self,
        gpu: Gpu,
        specialisation: &[(&str, u32)],
        shared: &[Binding],
        items: &[&Item<C>],
        (mut first_groups, groups): (Vec<u32>, usize),
    ) {
        let name = self.kernel.name;
        assert!(items.iter().all(|item| item.arrays.len() == self.arrays.len()), "{name}: arrays of an item");
        assert_eq!(shared.len(), self.shared, "{name}: shared arrays");
        first_groups.resize(items.len().next_multiple_of(4), u32::MAX);
        let mut constants: Vec<u8> = bytemuck::cast_slice(&first_groups).to_vec();
        for item in items {
            constants.extend_from_slice(bytemuck::bytes_of(&item.constants));
            constants.resize(constants.len().next_multiple_of(ALIGNMENT), 0);
        }
        let arrays: Vec<Binding> = shared.iter().chain(items.iter().flat_map(|item| &item.arrays)).copied().collect();
        let specialisation = specialised_for_items::<C>(items.len(), specialisation);
        let declarations = || self.declarations(items.len());
        self.kernel.launch_with(gpu, &declarations, &specialisation, &constants, &arrays, groups);
    }
}

/// Items per launch of `arrays` arrays each, besides `shared` arrays; at least one.
fn capacity(gpu: Gpu, shared: usize, arrays: usize) -> usize {
    let left = gpu.arrays_per_kernel().saturating_sub(shared);
    left.checked_div(arrays).unwrap_or(MOST_ITEMS).clamp(1, MOST_ITEMS)
}

/// The constants of a kernel over this many items, each with a `C`.
fn specialised_for_items<'a, C>(items: usize, specialisation: &[(&'a str, u32)]) -> Vec<(&'a str, u32)> {
    let bytes = size_of::<C>().next_multiple_of(ALIGNMENT);
    [&[("ITEMS", items as u32), ("ITEM_BYTES", bytes as u32)], specialisation].concat()
}

impl Gpu {
    /// The most arrays that one launch may bind.
    pub(crate) fn arrays_per_kernel(self) -> usize {
        let most = (self.0.limits.max_storage_buffers_per_shader_stage as usize).min(MOST_ARRAYS);
        #[cfg(test)]
        let most = most.min(tests::MOST.get());
        most
    }
}
