use std::cell::Cell;

use super::*;
use crate::check::agree;
use crate::check::conformance::Disagreement;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::{Fields, check_layout, validate};
use crate::gpu::tests::test_gpu;
use crate::gpu::{GpuArray, uniforms};
use crate::tape::Tensor;

thread_local! {
    /// Arrays that a launch may have at most, for the tests of this thread.
    pub static MOST: Cell<usize> = const { Cell::new(usize::MAX) };
}

/// The result on an adapter that allows no more arrays than this.
pub(crate) fn with_arrays<R>(most: usize, result: impl FnOnce() -> R) -> R {
    let before = MOST.replace(most);
    let result = result();
    MOST.set(before);
    result
}

/// Panics unless a kernel is valid for one and for many items, with constants laid out as `T`.
pub(crate) fn assert_valid_grouped<T: Fields>(grouped: &Grouped, specialisation: &[(&'static str, u32)]) {
    for items in [1, 2, 5, 18] {
        let specialisation = specialised_for_items::<T>(items, specialisation);
        let source = grouped.kernel.source_with(&grouped.declarations(items), &specialisation);
        check_layout::<T>(&source).unwrap_or_else(|error| panic!("{}: {error}", grouped.kernel.name));
        assert_eq!(layout_of_items(&source), [16 * items.div_ceil(4), size_of::<T>().next_multiple_of(ALIGNMENT)]);
    }
}

/// Where the items of a block of constants begin, and the bytes from one to the next.
fn layout_of_items(source: &str) -> [usize; 2] {
    let module = validate(source).unwrap();
    let named = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some("Grouped")).unwrap().1;
    let naga::TypeInner::Struct { members, .. } = &named.inner else { panic!("no struct: {named:?}") };
    let naga::TypeInner::Array { stride, .. } = module.types[members[1].ty].inner else {
        panic!("no array: {named:?}")
    };
    [members[1].offset as usize, stride as usize]
}

uniforms! {
    struct TestItem as "Item" { len: u32, factor: f32, first: u32 }
}

/// y = factor · x + offset, and the place of the item's first sum in a list that all share.
const SCALED: Grouped = Grouped {
    kernel: Kernel {
        name: "test of groups",
        text: "#import gpu::flat_group
#import gpu::grouped::grouped
             struct Item { len: u32, factor: f32, first: u32 }
             @group(0) @binding(1) var<storage, read> offset: array<f32>;
             @group(0) @binding(2) var<storage, read_write> groups_of_items: array<u32>;

             @compute @workgroup_size(256)
             fn main(
                 @builtin(workgroup_id) group: vec3<u32>,
                 @builtin(num_workgroups) groups: vec3<u32>,
                 @builtin(local_invocation_index) local: u32,
             ) {
                 let flat = flat_group(group, groups);
                 let item = item_of(flat);
                 let own = constants_of(item);
                 let own_group = flat - first_group(item);
                 let at = own_group * 256u + local;
                 if (at < own.len) {
                     set_y(item, at, own.factor * bitcast<f32>(x(item, at)) + offset[0]);
                 }
                 if (local == 0u && at < own.len) {
                     groups_of_items[own.first + own_group] = item;
                 }
             }",
    },
    shared: 2,
    arrays: &[ItemArray::read("x").of_bits(), ItemArray::write("y")],
};

/// Runs the test's kernel over items of these lengths: the results one after the other, and the shared list.
fn scaled(gpu: Gpu, lens: &[usize]) -> (Vec<f32>, Vec<u32>) {
    let value = |item: usize, at: usize| (item * 1000 + at % 97) as f32;
    let inputs: Vec<Vec<f32>> =
        lens.iter().enumerate().map(|(item, &len)| (0..len).map(|at| value(item, at)).collect()).collect();
    let x: Vec<GpuArray> = inputs.iter().map(|input| GpuArray::upload(gpu, input)).collect();
    let y: Vec<GpuArray> = lens.iter().map(|&len| GpuArray::new(gpu, len)).collect();
    let offset = GpuArray::upload(gpu, &[0.5_f32]);
    let (mut items, mut first) = (Vec::new(), 0);
    for (item, &len) in lens.iter().enumerate() {
        let constants = TestItem { len: len as u32, factor: item as f32, first };
        let groups = len.div_ceil(256);
        items.push(Item { constants, arrays: vec![Binding::Read(&x[item]), Binding::Write(&y[item])], groups });
        first += groups as u32;
    }
    let list = GpuArray::new(gpu, first as usize);
    SCALED.launch(gpu, &[], &[Binding::Read(&offset), Binding::Write(&list)], &items);
    let mut groups = vec![0_u32; first as usize];
    list.read_into(&mut groups);
    let read = |array: &GpuArray| {
        let mut out = vec![0.0_f32; array.len()];
        array.read_into(&mut out);
        out
    };
    (y.iter().flat_map(read).collect(), groups)
}

fn expected(lens: &[usize]) -> Vec<f32> {
    let of_item = |(item, &len): (usize, &usize)| (0..len).map(move |at| (item * (item * 1000 + at % 97)) as f32 + 0.5);
    lens.iter().enumerate().flat_map(of_item).collect()
}

#[test]
fn the_kernel_is_valid() {
    assert_valid_grouped::<TestItem>(&SCALED, &[]);
}

#[test]
fn every_item_has_its_own_arrays_however_many_fit_one_launch() {
    let Some(gpu) = test_gpu() else { return };
    let many: Vec<usize> = (0..37).map(|item| [3, 0, 257, 1000, 1][item % 5]).collect();
    for lens in [&[][..], &[0], &[1], &[256, 257], &[0, 0, 700, 0], &many] {
        for most in [4, 5, 16, usize::MAX] {
            let (found, groups) = with_arrays(most, || scaled(gpu, lens));
            assert_eq!(found, expected(lens), "{lens:?} with {most} arrays");
            assert!(most < 6 || lens != [256, 257] || groups == [0, 1, 1], "{groups:?}");
        }
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let lens = [300, 20, 1000, 2, 700];
    let compare = || {
        let found = Tensor::from_vec([2022], scaled(gpu, &lens).0);
        let mismatch = |mismatch| Disagreement { what: "scaled".into(), mismatch };
        agree(&found, &Tensor::from_vec([2022], expected(&lens)), 0.0).map(|()| 1).map_err(mismatch)
    };
    let name = SCALED.kernel.name;
    let wrong = [
        ("first_group(middle) <= group", "first_group(middle) < group"),
        ("return x_1[at]", "return x_0[at]"),
        ("y_1[at] = value", "y_1[at] = 0.0"),
    ];
    assert_noticed(&wrong.map(|(right, wrong)| (name, right, wrong)), compare);
}
