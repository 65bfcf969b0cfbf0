use shaders::check::noise;

use super::*;

/// The cells of a cube of 2^bits cells per side in the order of a curve.
fn walk(curve: Curve, bits: u32) -> Vec<[u32; 3]> {
    let side = 1_u32 << bits;
    let mut cells: Vec<[u32; 3]> = (0..side.pow(3)).map(|at| [at / side / side, at / side % side, at % side]).collect();
    cells.sort_by_key(|&cell| curve.place(cell, bits));
    cells
}

fn steps(cells: &[[u32; 3]]) -> impl Iterator<Item = u32> {
    let step = |pair: &[[u32; 3]]| (0..3).map(|axis| pair[0][axis].abs_diff(pair[1][axis])).sum();
    cells.windows(2).map(step).collect::<Vec<u32>>().into_iter()
}

fn random_positions(count: usize) -> Vec<[f32; 3]> {
    noise(3 * count, 5).as_chunks::<3>().0.iter().map(|point| point.map(|value| value as f32)).collect()
}

#[test]
fn both_curves_visit_every_cell_once() {
    for curve in [Curve::Hilbert, Curve::ZOrder] {
        for bits in 1..=4 {
            let places: Vec<u64> = walk(curve, bits).iter().map(|&cell| curve.place(cell, bits)).collect();
            assert_eq!(places, (0..1 << (3 * bits)).collect::<Vec<u64>>(), "{curve:?} with {bits} bits");
        }
    }
}

#[test]
fn only_the_hilbert_curve_has_adjacent_cells() {
    for bits in 1..=5 {
        assert!(steps(&walk(Curve::Hilbert, bits)).all(|step| step == 1), "{bits} bits");
    }
    assert!(steps(&walk(Curve::ZOrder, 2)).any(|step| step > 1));
}

#[test]
fn the_z_order_interleaves_with_x_first() {
    assert_eq!(Curve::ZOrder.place([1, 0, 0], 1), 0b100);
    assert_eq!(Curve::ZOrder.place([0b10, 0b01, 0b11], 2), 0b101_011);
    assert_eq!(Curve::ZOrder.place([0xffff; 3], 16), (1 << 48) - 1);
}

#[test]
fn every_order_is_a_permutation() {
    let positions = random_positions(200);
    for curve in [Curve::Hilbert, Curve::ZOrder] {
        for cell_size in [1e-12, 0.05, 100.0] {
            let mut order = curve.order(&positions, cell_size);
            order.sort_unstable();
            assert_eq!(order, (0..200).collect::<Vec<u32>>());
        }
        assert!(curve.order(&[], 0.1).is_empty());
        assert_eq!(curve.order(&[[3.0; 3]; 3], 0.1), [0, 1, 2]);
    }
}

#[test]
fn neighbours_on_a_curve_are_close_in_space() {
    let positions = random_positions(500);
    let mean_distance = |order: &[u32]| {
        let pairs = neighbor_pairs(&positions, order, 4, 3.0);
        let point = |index: u32| glam::Vec3::from(positions[index as usize]);
        pairs.iter().map(|&[first, second]| point(first).distance(point(second))).sum::<f32>() / pairs.len() as f32
    };
    let unordered: Vec<u32> = (0..500).collect();
    for curve in [Curve::Hilbert, Curve::ZOrder] {
        let along_curve = mean_distance(&curve.order(&positions, 0.05));
        assert!(along_curve < 0.4 * mean_distance(&unordered), "{curve:?}: {along_curve}");
    }
}

#[test]
fn pairs_are_unique_and_without_jumps() {
    let mut positions: Vec<[f32; 3]> = (0..10).map(|at| [at as f32, 0.0, 0.0]).collect();
    positions.push([1000.0, 0.0, 0.0]);
    let order: Vec<u32> = (0..11).collect();
    let pairs = neighbor_pairs(&positions, &order, 2, 3.0);
    assert_eq!(pairs.len(), 9 + 8);
    assert!(pairs.iter().all(|&[first, second]| first < second && second < 10));
    assert_eq!(neighbor_pairs(&positions, &order, 2, f64::INFINITY).len(), 10 + 9);
    assert!(neighbor_pairs(&[], &[], 4, 3.0).is_empty());
}
