//! The order in which the backward pass visits points.

use crate::tape::chunks::map_chunks;

/// Binary logarithm of the number of cells per axis: at the usual 64 to 128 texels per axis, the texels of one cell and
/// their gradients fill about a first-level cache.
const CELL_BITS: u32 = 4;
const CELLS: usize = 1 << (3 * CELL_BITS);
/// The cell of points without a gradient.
const SKIPPED: u16 = CELLS as u16;
/// Points per chunk when cells are looked up.
const POINTS_PER_CHUNK: usize = 2048;

/// The points whose row of `dy` [N, features] is not zero, cell by cell in Morton order: neighbours in the list use
/// neighbouring texels. Points that contribute to no pixel have no gradient and are omitted.
///
/// Within a cell points keep their order; the list depends on positions [N, 3] and `dy` alone.
pub(crate) fn points_by_cell(positions: &[f32], dy: &[f32], features: usize) -> Vec<u32> {
    let points = positions.len() / 3;
    let cell_of = |n: usize| match has_gradient(&dy[n * features..(n + 1) * features]) {
        true => morton_cell(&positions[3 * n..3 * n + 3]),
        false => SKIPPED,
    };
    let cells = map_chunks(points, POINTS_PER_CHUNK, |range| range.map(cell_of).collect::<Vec<u16>>()).concat();

    // A counting sort: first place of every cell, then every point to the next place of its cell.
    let mut next = vec![0u32; CELLS + 2];
    cells.iter().for_each(|&cell| next[cell as usize + 1] += 1);
    (1..next.len()).for_each(|cell| next[cell] += next[cell - 1]);
    let mut order = vec![0; next[CELLS] as usize];
    for (n, &cell) in cells.iter().enumerate().filter(|&(_, &cell)| cell != SKIPPED) {
        order[next[cell as usize] as usize] = n as u32;
        next[cell as usize] += 1;
    }
    order
}

/// Whether any element differs from zero; NaN does.
fn has_gradient(dy: &[f32]) -> bool {
    dy.iter().fold(false, |any, &value| any | (value != 0.0))
}

/// Interleaved bits of the cell of a point in [−1, 1]³; points outside belong to the border, NaN to the first cell.
fn morton_cell(point: &[f32]) -> u16 {
    let half_cells = (1 << (CELL_BITS - 1)) as f32;
    let cell = |axis: usize| (((point[axis] + 1.0) * half_cells) as u16).min((1 << CELL_BITS) - 1);
    let bits = |axis: usize| (0..CELL_BITS).map(|bit| (cell(axis) >> bit & 1) << (3 * bit + axis as u32)).sum::<u16>();
    (0..3).map(bits).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::noise;

    #[test]
    fn every_point_with_a_gradient_is_listed_once_and_cells_are_contiguous() {
        let positions: Vec<f32> = noise(3 * 5000, 1).iter().map(|&x| 1.2 * x as f32).collect();
        let dy: Vec<f32> = (0..2 * 5000).map(|i| if i / 2 % 7 == 0 { 0.0 } else { i as f32 }).collect();
        let order = points_by_cell(&positions, &dy, 2);
        let cells: Vec<u16> =
            order.iter().map(|&n| morton_cell(&positions[3 * n as usize..3 * n as usize + 3])).collect();
        assert!(cells.is_sorted() && cells[0] < cells[cells.len() - 1]);
        let mut listed = order.clone();
        listed.sort_unstable();
        let live: Vec<u32> = (0..5000).filter(|n| n % 7 != 0).collect();
        assert_eq!(listed, live);
    }

    #[test]
    fn cells_interleave_bits_and_clamp_points_outside() {
        assert_eq!(morton_cell(&[-1.0, -1.0, -1.0]), 0);
        assert_eq!(morton_cell(&[-0.8, -1.0, -1.0]), 1);
        assert_eq!(morton_cell(&[-1.0, -0.8, -1.0]), 2);
        assert_eq!(morton_cell(&[9.0, 9.0, 9.0]), SKIPPED - 1);
        assert_eq!(morton_cell(&[f32::NAN, -9.0, -9.0]), 0);
    }
}
