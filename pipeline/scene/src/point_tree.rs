//! Nearest points of a cloud, in space or in the image.

use kd_tree::{ItemAndDistance, KdIndexTree, KdPoint};

/// A point near a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbor {
    /// Index among the points of the tree.
    pub index: usize,
    /// Squared distance from the query, in the squared unit of the points.
    pub squared_distance: f64,
}

impl From<ItemAndDistance<'_, usize, f64>> for Neighbor {
    fn from(found: ItemAndDistance<'_, usize, f64>) -> Self {
        Self { index: *found.item, squared_distance: found.squared_distance }
    }
}

/// A search tree over finite points, e.g. `[f64; 3]`.
pub struct PointTree<'a, P: KdPoint>(KdIndexTree<'a, P>);

impl<'a, P: KdPoint<Scalar = f64>> PointTree<'a, P> {
    /// Builds the tree in O(N log N).
    pub fn new(points: &'a [P]) -> Self {
        Self(KdIndexTree::build_by_ordered_float(points))
    }

    /// The nearest point; none without points.
    pub fn nearest(&self, query: &P) -> Option<Neighbor> {
        self.0.nearest(query).map(Neighbor::from)
    }

    /// The `count` nearest points by increasing distance; all points if there are fewer.
    ///
    /// `KdIndexTree::nearests` (kd-tree 0.6.2) is not used: it skips subtrees before it has found `count` points, and so
    /// may return too few or wrong ones from clouds of fewer than 2^`count` − 1 points. From larger clouds, where every
    /// path from the root has `count` points, it returns the same points in the same order as this search.
    pub fn nearests(&self, query: &P, count: usize) -> Vec<Neighbor> {
        let mut nearests = Nearests { count, found: Vec::with_capacity(count) };
        self.search(self.0.indices(), 0, query, &mut nearests);
        nearests.found
    }

    /// Offers the points of a subtree: its root is in the middle, and splits the other points at its coordinate of `axis`.
    fn search(&self, subtree: &[usize], axis: usize, query: &P, nearests: &mut Nearests) {
        let (below, [root, above @ ..]) = subtree.split_at(subtree.len() / 2) else { return };
        let point = self.0.item(*root);
        let offset = |axis: usize| query.at(axis) - point.at(axis);
        let squared_distance = (0..P::dim()).map(|axis| offset(axis) * offset(axis)).sum();
        nearests.offer(Neighbor { index: *root, squared_distance });
        let (near, far) = if offset(axis) < 0.0 { (below, above) } else { (above, below) };
        let next_axis = (axis + 1) % P::dim();
        self.search(near, next_axis, query, nearests);
        if nearests.accepts(offset(axis) * offset(axis)) {
            self.search(far, next_axis, query, nearests);
        }
    }
}

/// The nearest points so far, by increasing distance.
struct Nearests {
    count: usize,
    found: Vec<Neighbor>,
}

impl Nearests {
    fn accepts(&self, squared_distance: f64) -> bool {
        let is_nearer = |last: &Neighbor| squared_distance < last.squared_distance;
        self.found.len() < self.count || self.found.last().is_some_and(is_nearer)
    }

    fn offer(&mut self, point: Neighbor) {
        if !self.accepts(point.squared_distance) {
            return;
        }
        self.found.truncate(self.count - 1);
        let order = |other: &Neighbor| other.squared_distance.total_cmp(&point.squared_distance);
        let place = self.found.binary_search_by(order).unwrap_or_else(|place| place);
        self.found.insert(place, point);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// A cloud of some kind: 0 random; 1 on a small grid, with duplicates; 2 collinear; 3 collinear along an axis.
    fn cloud(kind: usize, count: usize, random: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
        let mut point = |at: f64| match kind {
            0 => std::array::from_fn(|_| random.random()),
            1 => std::array::from_fn(|_| f64::from(random.random_range(0..3))),
            2 => [at, 2.0 * at, -at],
            _ => [0.0, at, 0.0],
        };
        (0..count).map(|at| point(at as f64)).collect()
    }

    fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
    }

    /// Whether neighbours are distinct points of a cloud at the `count` smallest distances from a query.
    fn are_nearest(found: &[Neighbor], points: &[[f64; 3]], query: &[f64; 3], count: usize) -> bool {
        let mut distances: Vec<f64> = points.iter().map(|point| squared_distance(point, query)).collect();
        distances.sort_by(f64::total_cmp);
        distances.truncate(count);
        let indices: BTreeSet<usize> = found.iter().map(|neighbor| neighbor.index).collect();
        indices.len() == found.len()
            && found.iter().all(|it| squared_distance(&points[it.index], query) == it.squared_distance)
            && found.iter().map(|it| it.squared_distance).eq(distances)
    }

    /// Calls a function with a tree, its points, a query and a number of neighbours from 1 to 9.
    fn for_each_search(
        sizes: &[usize],
        mut visit: impl FnMut(&PointTree<'_, [f64; 3]>, &[[f64; 3]], &[f64; 3], usize),
    ) {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for (kind, &size) in (0..4).flat_map(|kind| sizes.iter().map(move |size| (kind, size))) {
            let points = cloud(kind, size, &mut random);
            let tree = PointTree::new(&points);
            let elsewhere = cloud(0, 5, &mut random);
            for query in points.iter().take(40).chain(&elsewhere) {
                (1..=9).for_each(|count| visit(&tree, &points, query, count));
            }
        }
    }

    #[test]
    fn small_clouds_give_what_brute_force_gives() {
        let sizes: Vec<usize> = (0..=40).collect();
        let mut misses_of_crate = 0;
        for_each_search(&sizes, |tree, points, query, count| {
            let found = tree.nearests(query, count);
            assert!(are_nearest(&found, points, query, count), "{count} nearest to {query:?} of {points:?}: {found:?}");
            let nearest: Vec<Neighbor> = tree.nearest(query).into_iter().collect();
            assert!(are_nearest(&nearest, points, query, 1), "nearest to {query:?} of {points:?}: {nearest:?}");
            let of_crate: Vec<Neighbor> = tree.0.nearests(query, count).into_iter().map(Neighbor::from).collect();
            misses_of_crate += usize::from(!are_nearest(&of_crate, points, query, count));
        });
        assert!(misses_of_crate > 0, "`KdIndexTree::nearests` is exact and can replace the search of this module");
    }

    #[test]
    fn large_clouds_give_the_order_of_the_crate() {
        for_each_search(&[511, 512, 3000], |tree, points, query, count| {
            let found = tree.nearests(query, count);
            let of_crate: Vec<Neighbor> = tree.0.nearests(query, count).into_iter().map(Neighbor::from).collect();
            assert_eq!(found, of_crate, "{count} nearest to {query:?}");
            assert!(are_nearest(&found, points, query, count), "{count} nearest to {query:?}: {found:?}");
        });
    }

    #[test]
    fn zero_neighbours_are_none() {
        assert_eq!(PointTree::new(&[[0.0, 1.0]]).nearests(&[0.0, 1.0], 0), []);
    }
}
