use super::*;
use crate::check::noise;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::parts::tests::assert_equal_in_parts;
use crate::gpu::tests::test_gpu;

fn read(array: &GpuArray) -> Vec<f32> {
    let mut out = vec![0.0; array.len()];
    array.read_into(&mut out);
    out
}

/// Integers whose sums are exact in f32.
fn numbers(len: usize) -> Vec<f32> {
    noise(len, 3).iter().map(|value| (10.0 * value).round() as f32).collect()
}

#[test]
fn totals_are_exact_for_whole_numbers_of_any_count() {
    let Some(gpu) = test_gpu() else { return };
    for len in [0, 1, 255, 257, 4096, 4097, 100_000] {
        let x = numbers(len);
        let found = read(&total(gpu, &GpuArray::upload(gpu, &x), 0.5));
        assert_eq!(found, [0.5 * x.iter().sum::<f32>()], "{len} elements");
    }
}

#[test]
fn rows_are_added_column_by_column() {
    let Some(gpu) = test_gpu() else { return };
    for (rows, columns) in [(0, 3), (1, 5), (7, 1), (1024, 3), (1025, 300), (5000, 7)] {
        let x = numbers(rows * columns);
        let mut expected = vec![0.0; columns];
        x.iter().enumerate().for_each(|(at, value)| expected[at % columns] += value);
        let found = read(&over_rows(gpu, &GpuArray::upload(gpu, &x), columns));
        assert_eq!(found, expected, "{rows} rows of {columns}");
    }
}

#[test]
fn sums_of_arrays_in_parts_are_those_of_whole_ones() {
    let Some(gpu) = test_gpu() else { return };
    let x = GpuArray::upload(gpu, &numbers(3 * 70_000));
    assert!(assert_equal_in_parts(|| [read(&over_rows(gpu, &x, 3)), read(&total(gpu, &x, 0.5))]) >= 3);
}

#[test]
fn the_kernels_are_valid() {
    assert_valid::<RowsBlock>(&ROWS, &[]);
    assert_valid_total(&TOTAL);
}
