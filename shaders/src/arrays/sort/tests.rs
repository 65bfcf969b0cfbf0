use super::*;
use crate::check::conformance::Disagreement;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::{check_layout, validate};
use crate::gpu::length::tests::length_of;
use crate::gpu::tests::test_gpu;
use crate::tape::Tensor;

/// Around the sizes of workgroups and blocks, two levels of blocks, and [`FEW_BLOCKS`].
const LENGTHS: [usize; 9] = [0, 1, 255, 256, 257, 1023, 1025, 65_535, 65_537];

/// Unordered numbers.
fn scrambled(len: usize) -> Vec<u32> {
    (0..len as u32).map(|index| index.wrapping_add(1).wrapping_mul(0x9e37_79b9) ^ index << 7).collect()
}

fn read(array: &GpuArray) -> Vec<u32> {
    let mut out = vec![0; array.len()];
    array.read_into(&mut out);
    out
}

#[test]
fn kernels_are_valid() {
    for source in [SCAN.source(&[]), SCAN_ADD.source(&[])] {
        validate(&source).and_then(|_| check_layout::<ScanBlock>(&source)).unwrap_or_else(|error| panic!("{error}"));
    }
    for counted in [0, 1].map(|counted| ("COUNTED", counted)) {
        crate::gpu::layout_tests::assert_valid::<SortBlock>(&COUNT, &[counted]);
        for lanes in [128, 256] {
            crate::gpu::layout_tests::assert_valid::<SortBlock>(&ROWS, &[counted, ("LANES", lanes)]);
        }
        for (first, summed) in [(0, 0), (1, 1)] {
            crate::gpu::layout_tests::assert_valid::<SortBlock>(
                &SCATTER,
                &[counted, ("FIRST", first), ("LAST", first), ("SUMMED", summed)],
            );
        }
    }
}

#[test]
fn sums_of_any_length_are_exact() {
    let Some(gpu) = test_gpu() else { return };
    // The last has three levels of blocks.
    for len in LENGTHS.into_iter().chain([(1 << 20) + 1]) {
        let numbers: Vec<u32> = scrambled(len).iter().map(|number| number % 100).collect();
        let sums = read(&exclusive_sums(gpu, &GpuArray::upload(gpu, &numbers)));
        let mut expected = 0;
        for (index, (&sum, &number)) in sums.iter().zip(&numbers).enumerate() {
            assert_eq!(sum, expected, "element {index} of {len}");
            expected += number;
        }
    }
}

#[test]
fn sums_that_would_overflow_saturate() {
    let Some(gpu) = test_gpu() else { return };
    // 2³² + 5 in total.
    let mut numbers = vec![1 << 20; 4096];
    numbers.push(5);
    numbers.push(0);
    let sums = read(&exclusive_sums(gpu, &GpuArray::upload(gpu, &numbers)));
    assert!(sums.is_sorted() && sums[511] == 511 << 20 && sums[513..].iter().all(|&sum| sum == SUM_CAP));
}

/// Whether the result equals a stable sort of `keys`.
fn is_stably_sorted(keys: &[u32], (sorted, places): (&[u32], &[u32])) -> bool {
    let mut expected: Vec<usize> = (0..keys.len()).collect();
    expected.sort_by_key(|&place| keys[place]);
    expected.iter().zip(places).all(|(&expected, &place)| expected == place as usize)
        && places.iter().zip(sorted).all(|(&place, &key)| keys[place as usize] == key)
}

#[test]
fn sorts_of_any_length_are_stable() {
    let Some(gpu) = test_gpu() else { return };
    // The last has more blocks than a workgroup has invocations.
    for len in LENGTHS.into_iter().chain([300_000]) {
        let few: Vec<u32> = scrambled(len).iter().map(|key| key % 11).collect();
        let falling = (0..len as u32).rev().collect();
        for (keys, bits) in
            [(scrambled(len), 32), (few, 4), (vec![7; len], 32), (falling, 32), (vec![u32::MAX; len], 32)]
        {
            let (sorted, places) = sort(gpu, &GpuArray::upload(gpu, &keys), bits);
            assert!(is_stably_sorted(&keys, (&read(&sorted), &read(&places))), "{len} keys of {bits} bits");
        }
    }
}

#[test]
fn as_many_keys_are_sorted_as_there_are() {
    let Some(gpu) = test_gpu() else { return };
    for (capacity, count) in [(0, 0), (1, 0), (3000, 1), (3000, 2047), (3000, 3000), (70_000, 66_000)] {
        let keys = scrambled(capacity);
        let length = length_of(gpu, count, capacity);
        let (sorted, places) = sort_first(gpu, &GpuArray::upload(gpu, &keys), Some(&length), 32);
        let (sorted, places) = (read(&sorted), read(&places));
        assert!(is_stably_sorted(&keys[..count], (&sorted[..count], &places[..count])), "{count} of {capacity}");
    }
}

#[test]
fn a_sort_that_is_not_stable_is_noticed() {
    let keys = [3, 1, 1, 2];
    assert!(is_stably_sorted(&keys, (&[1, 1, 2, 3], &[1, 2, 3, 0])));
    assert!(!is_stably_sorted(&keys, (&[1, 1, 2, 3], &[2, 1, 3, 0])));
}

#[test]
fn keys_begin_where_the_first_of_them_is() {
    let Some(gpu) = test_gpu() else { return };
    crate::gpu::layout_tests::assert_valid::<StartsBlock>(&STARTS, &[]);
    for (keys, expected) in [
        (&[][..], &[0, 0, 0, 0][..]),
        (&[0, 0, 2], &[0, 2, 2, 3]),
        (&[1, 1, 1, 2, 2], &[0, 0, 3, 5]),
        (&[2], &[0, 0, 0, 1]),
    ] {
        assert_eq!(read(&starts(gpu, &GpuArray::upload::<u32>(gpu, keys), 3)), expected);
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let compare = || {
        let is_sorted = [5000, 70_000].map(scrambled).iter().all(|keys| {
            let (sorted, places) = sort(gpu, &GpuArray::upload(gpu, keys), 32);
            is_stably_sorted(keys, (&read(&sorted), &read(&places)))
        });
        let sums = read(&exclusive_sums(gpu, &GpuArray::upload(gpu, &vec![1; 5000])));
        let are_sums = sums.iter().enumerate().all(|(index, &sum)| sum == index as u32);
        let found = Tensor::from_vec([1], vec![f32::from(is_sorted && are_sums)]);
        let mismatch = |mismatch| Disagreement { what: "a sort".into(), mismatch };
        crate::check::agree(&found, &Tensor::from_vec([1], vec![1.0_f32]), 0.0).map(|()| 1).map_err(mismatch)
    };
    let faults = [
        ("sort, counts", "block * BLOCK + item * GROUP", "block * BLOCK"),
        ("sort, counts", "counts[count_at(later, local, block)] = 0u", "counts[count_at(later, local, block)] = 1u"),
        ("sort, rows", "partial[local] - own", "partial[local]"),
        ("sort, scatter", "digit_of(key, next)", "digit_of(key, next - 1u)"),
        ("sort, scatter", "earlier = all", "earlier = 0u"),
        ("sort, scatter", "own.x - own.y", "0u - own.y"),
        ("sort, scatter", "- local_starts[digit]", ""),
        ("scan", "running = partial[local - 1u]", "running = 0u"),
        ("scan, offsets", "index / 1024u", "index / 2048u"),
    ];
    assert_noticed(&faults, compare);
}
