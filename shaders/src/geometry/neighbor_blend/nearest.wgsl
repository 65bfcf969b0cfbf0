// The KEPT nearest nodes of every point in AXES dimensions, nearest first; ties go to the lower index. One invocation
// per point. The workgroup loads TILE nodes at a time. If OTHERS is 1, the points are the nodes, and no point is its
// own neighbour.
#import geometry::neighbor_blend::nearest_list
#import gpu::flat_group
#const AXES, KEPT, OTHERS

const GROUP: u32 = 64u;
const TILE: u32 = 64u;

var<workgroup> tile: array<f32, TILE * AXES>;

// The nearest nodes so far.
var<private> found_nodes: array<u32, KEPT>;
var<private> found_distances: array<f32, KEPT>;

fn kept() -> u32 {
    return KEPT;
}

fn found_node(rank: u32) -> u32 {
    return found_nodes[rank];
}

fn found_distance(rank: u32) -> f32 {
    return found_distances[rank];
}

fn set_found(rank: u32, node: u32, distance: f32) {
    found_nodes[rank] = node;
    found_distances[rank] = distance;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let point = flat_group(group, groups) * GROUP + local;
    var own: array<f32, AXES>;
    if (point < sizes.points) {
        for (var axis = 0u; axis < AXES; axis++) {
            own[axis] = points[point * AXES + axis];
        }
    }
    for (var first = 0u; first < sizes.nodes; first += TILE) {
        let count = min(TILE, sizes.nodes - first);
        workgroupBarrier();
        for (var at = local; at < count * AXES; at += GROUP) {
            tile[at] = nodes[first * AXES + at];
        }
        workgroupBarrier();
        for (var node = 0u; node < count; node++) {
            var distance = 0.0;
            for (var axis = 0u; axis < AXES; axis++) {
                let difference = own[axis] - tile[node * AXES + axis];
                distance += difference * difference;
            }
            if (OTHERS == 0u || first + node != point) {
                insert(first + node, distance);
            }
        }
    }
    if (point < sizes.points) {
        for (var rank = 0u; rank < KEPT; rank++) {
            node_of_item[point * KEPT + rank] = found_nodes[rank];
        }
    }
}
