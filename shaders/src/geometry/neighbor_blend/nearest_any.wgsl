// The nearest nodes of every point, for any number of dimensions and of nodes per point. One invocation per point,
// which keeps its list in the output array. If OTHERS is 1, the points are the nodes, and no point is its own
// neighbour.
#import geometry::neighbor_blend::nearest_list
#import gpu::elements_64
#const OTHERS

// Squared distances of the nodes in the list, [points, kept].
@group(0) @binding(4) var<storage, read_write> distances: array<f32>;

var<private> first_found: u32;

fn kept() -> u32 {
    return sizes.kept;
}

fn found_node(rank: u32) -> u32 {
    return node_of_item[first_found + rank];
}

fn found_distance(rank: u32) -> f32 {
    return distances[first_found + rank];
}

fn set_found(rank: u32, node: u32, distance: f32) {
    node_of_item[first_found + rank] = node;
    distances[first_found + rank] = distance;
}

fn run(point: u32) {
    if (point >= sizes.points) {
        return;
    }
    first_found = point * sizes.kept;
    for (var node = 0u; node < sizes.nodes; node++) {
        var distance = 0.0;
        for (var axis = 0u; axis < sizes.axes; axis++) {
            let difference = points[point * sizes.axes + axis] - nodes[node * sizes.axes + axis];
            distance += difference * difference;
        }
        if (OTHERS == 0u || node != point) {
            insert(node, distance);
        }
    }
}
