//! Nearest neighbours among a few hundred nodes.
//!
//! All distances are computed: with 512 nodes that takes half a microsecond per point in vector instructions, as long as a
//! k-d tree takes in three dimensions, and it grows little with the dimensions of a learnt space. Points on a GPU
//! are searched there, and the result stays there until the host reads it.

use rayon::prelude::*;

use super::{Neighbors, gpu};
use crate::arrays::rows::RowIndex;
use crate::tape::{Real, Tensor};

/// Points per parallel chunk: tens of microseconds.
const POINTS_PER_CHUNK: usize = 64;

impl Neighbors {
    /// The `count` nodes [M, D] nearest to each point [N, D]; all nodes if there are fewer. Ties are
    /// resolved by index.
    pub fn nearest<T: Real>(points: &Tensor<T>, nodes: &Tensor<T>, count: usize) -> Self {
        assert_eq!(points.row_len(), nodes.row_len(), "points and nodes in different spaces");
        Self::search(points, nodes, count.min(nodes.rows()), false)
    }

    /// The `count` nodes nearest to each node [M, D] other than itself; all others if there are fewer.
    pub fn nearest_others<T: Real>(nodes: &Tensor<T>, count: usize) -> Self {
        Self::search(nodes, nodes, count.min(nodes.rows().saturating_sub(1)), true)
    }

    /// With `others`, the points are the nodes, and a node is not its own neighbour.
    fn search<T: Real>(points: &Tensor<T>, nodes: &Tensor<T>, per_point: usize, others: bool) -> Self {
        let on_gpu = points.gpu().or(nodes.gpu()).filter(|_| per_point > 0 && points.rows() > 0);
        let on_gpu = on_gpu.map(|gpu| gpu::nearest(gpu, points, nodes, per_point, others));
        let on_host = || {
            let found = if per_point == 0 { Vec::new() } else { search_on_host(points, nodes, per_point, others) };
            RowIndex::new(found, nodes.rows())
        };
        let node_of_item = on_gpu.map_or_else(on_host, |found| RowIndex::of_gpu(found, nodes.rows()));
        Self { per_point, points: if per_point == 0 { 0 } else { points.rows() }, node_of_item }
    }

    /// K.
    pub fn per_point(&self) -> usize {
        self.per_point
    }

    /// N.
    pub fn points(&self) -> usize {
        self.points
    }

    /// M.
    pub fn nodes(&self) -> usize {
        self.node_of_item.rows()
    }

    /// The nodes of a point, nearest first.
    pub fn of_point(&self, point: usize) -> &[u32] {
        &self.node_of_item.row_of_item()[point * self.per_point..(point + 1) * self.per_point]
    }

    /// The followers of a node: (point, which of the point's neighbours the node is), ascending.
    pub(crate) fn followers(&self, node: usize) -> impl Iterator<Item = (usize, usize)> {
        self.node_of_item
            .items_of(node)
            .iter()
            .map(|&item| (item as usize / self.per_point, item as usize % self.per_point))
    }

    /// The node of every item, N·K items point by point.
    pub fn node_of_item(&self) -> &RowIndex {
        &self.node_of_item
    }
}

/// The nodes of every point.
fn search_on_host<T: Real>(points: &Tensor<T>, nodes: &Tensor<T>, per_point: usize, others: bool) -> Vec<u32> {
    let coordinates = transposed(nodes);
    let mut found = vec![0; points.rows() * per_point];
    found.par_chunks_mut(POINTS_PER_CHUNK * per_point).enumerate().for_each(|(chunk, found)| {
        let mut distances = vec![T::ZERO; nodes.rows()];
        for (at, found) in found.chunks_exact_mut(per_point).enumerate() {
            let point = chunk * POINTS_PER_CHUNK + at;
            squared_distances(points.row(point), &coordinates, &mut distances);
            if others {
                distances[point] = T::from_f64(f64::INFINITY);
            }
            choose_smallest(&distances, found);
        }
    });
    found
}

/// [M, D] to D runs of M values.
fn transposed<T: Real>(nodes: &Tensor<T>) -> Vec<Vec<T>> {
    (0..nodes.row_len()).map(|axis| (0..nodes.rows()).map(|node| nodes.row(node)[axis]).collect()).collect()
}

fn squared_distances<T: Real>(point: &[T], coordinates: &[Vec<T>], distances: &mut [T]) {
    distances.fill(T::ZERO);
    for (&x, axis) in point.iter().zip(coordinates) {
        for (distance, &node) in distances.iter_mut().zip(axis) {
            *distance += (x - node) * (x - node);
        }
    }
}

/// The indices of the smallest distances, ascending; of equal ones the first.
fn choose_smallest<T: Real>(distances: &[T], found: &mut [u32]) {
    let mut filled = 0;
    for (node, &distance) in distances.iter().enumerate() {
        if filled == found.len() && !(distance < distances[found[filled - 1] as usize]) {
            continue;
        }
        filled = (filled + 1).min(found.len());
        let mut at = filled - 1;
        while at > 0 && distance < distances[found[at - 1] as usize] {
            found[at] = found[at - 1];
            at -= 1;
        }
        found[at] = node as u32;
    }
}
