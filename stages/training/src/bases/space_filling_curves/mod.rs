//! Space-filling curves: an order of cells in which neighbours along the curve are neighbours in space, so that pairs
//! of close points are found by one sort.
//!
//! The Hilbert curve is Skilling's transform (Skilling 2004, Programming the Hilbert curve, AIP Conference Proceedings
//! 707): consecutive cells share a face. The Z-order curve (Morton 1966) interleaves the bits of the coordinates; it is
//! cheaper and jumps.

#[cfg(test)]
mod tests;

/// Maximum bits per coordinate: three coordinates take 48 of the 64 bits of an index.
const MAX_BITS: u32 = 16;

/// A space-filling curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Curve {
    /// Hilbert curve: consecutive cells share a face.
    Hilbert,
    /// Z-order curve: interleaved bits.
    ZOrder,
}

impl Curve {
    /// The index on the curve of a cell whose coordinates are below 2^bits.
    pub(crate) fn place(self, cell: [u32; 3], bits: u32) -> u64 {
        assert!(bits <= MAX_BITS && cell.iter().all(|&axis| u64::from(axis) < 1 << bits), "a cell outside the cube");
        match self {
            Self::Hilbert => interleave(hilbert_transpose(cell, bits), bits),
            Self::ZOrder => interleave(cell, bits),
        }
    }

    /// The indices of positions in the order of the curve through cells of side `cell_size`, or larger cells if there
    /// were more than 2^16 of them along an axis. Positions of one cell keep their order.
    pub(crate) fn order(self, positions: &[[f32; 3]], cell_size: f64) -> Vec<u32> {
        let low: [f64; 3] = std::array::from_fn(|axis| extreme(positions, axis, f64::min));
        let high: [f64; 3] = std::array::from_fn(|axis| extreme(positions, axis, f64::max));
        let longest = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
        let most_cells = ((1_u64 << MAX_BITS) - 1) as f64;
        let cell_size = cell_size.max(longest / most_cells).max(f64::MIN_POSITIVE);
        let bits = u32::BITS - ((longest / cell_size) as u32).leading_zeros();
        let place = |position: &[f32; 3]| {
            let axis = |axis: usize| ((f64::from(position[axis]) - low[axis]) / cell_size) as u32;
            self.place([axis(0), axis(1), axis(2)], bits)
        };
        let places: Vec<u64> = positions.iter().map(place).collect();
        let mut order: Vec<u32> = (0..positions.len() as u32).collect();
        order.sort_by_key(|&index| places[index as usize]);
        order
    }
}

/// Pairs (i, j) of positions that are at most `reach` apart along an order, without those that are far apart in space:
/// more than `jump` times the median distance of a pair. A curve has such jumps where it leaves a region.
pub(crate) fn neighbor_pairs(positions: &[[f32; 3]], order: &[u32], reach: usize, jump: f64) -> Vec<[u32; 2]> {
    let pairs_at = |steps: usize| order.iter().zip(order.iter().skip(steps)).map(|(&first, &second)| [first, second]);
    let pairs: Vec<[u32; 2]> = (1..=reach).flat_map(pairs_at).collect();
    without_jumps(positions, pairs, jump)
}

/// The pairs whose distance is at most `jump` times the median distance.
pub(crate) fn without_jumps(positions: &[[f32; 3]], mut pairs: Vec<[u32; 2]>, jump: f64) -> Vec<[u32; 2]> {
    let distance = |&[first, second]: &[u32; 2]| {
        glam::Vec3::from(positions[first as usize]).distance(glam::Vec3::from(positions[second as usize]))
    };
    let mut distances: Vec<f32> = pairs.iter().map(distance).collect();
    if distances.is_empty() {
        return pairs;
    }
    let middle = distances.len() / 2;
    let median = *distances.select_nth_unstable_by(middle, f32::total_cmp).1;
    pairs.retain(|pair| f64::from(distance(pair)) <= jump * f64::from(median));
    pairs
}

/// Bit i of x goes to bit 3i + 2, of y to 3i + 1, of z to 3i.
fn interleave([x, y, z]: [u32; 3], bits: u32) -> u64 {
    let triple = |bit: u32| {
        let at = |axis: u32| u64::from(axis >> bit & 1);
        (at(x) << 2 | at(y) << 1 | at(z)) << (3 * bit)
    };
    (0..bits).map(triple).fold(0, |code, triple| code | triple)
}

/// Skilling's transform: coordinates whose interleaved bits are the index on the Hilbert curve.
fn hilbert_transpose(mut x: [u32; 3], bits: u32) -> [u32; 3] {
    // Undo the rotations and reflections of the sub-cubes, from the largest to the smallest.
    for bit in (1..bits).rev() {
        let below = (1 << bit) - 1;
        for axis in 0..3 {
            if x[axis] >> bit & 1 == 1 {
                x[0] ^= below;
            } else {
                let swapped = (x[0] ^ x[axis]) & below;
                x[0] ^= swapped;
                x[axis] ^= swapped;
            }
        }
    }
    // Gray code.
    x[1] ^= x[0];
    x[2] ^= x[1];
    let flips = (1..bits).filter(|bit| x[2] >> bit & 1 == 1).fold(0, |flips, bit| flips ^ ((1_u32 << bit) - 1));
    x.map(|axis| axis ^ flips)
}

/// The smallest or largest coordinate along an axis; 0 without positions.
fn extreme(positions: &[[f32; 3]], axis: usize, choose: fn(f64, f64) -> f64) -> f64 {
    positions.iter().map(|position| f64::from(position[axis])).reduce(choose).unwrap_or(0.0)
}
