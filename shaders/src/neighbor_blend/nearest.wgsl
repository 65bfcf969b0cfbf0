// The KEPT nearest of the nodes of every point in a space of AXES axes, nearest first; of equally near ones the first. An
// invocation per point; nodes are loaded by the workgroup, TILE at a time. OTHERS is 1 where points are the nodes, and none
// is its own neighbour.

struct Nearest {
    points: u32,
    nodes: u32,
}

@group(0) @binding(0) var<uniform> sizes: Nearest;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> nodes: array<f32>;
@group(0) @binding(3) var<storage, read_write> node_of_item: array<u32>;

const GROUP: u32 = 64u;
const TILE: u32 = 64u;

var<workgroup> tile: array<f32, TILE * AXES>;

// The nearest so far.
struct Found {
    count: u32,
    nodes: array<u32, KEPT>,
    distances: array<f32, KEPT>,
}

fn insert(found: ptr<function, Found>, node: u32, distance: f32) {
    let is_full = (*found).count == KEPT;
    if (is_full && !(distance < (*found).distances[KEPT - 1u])) {
        return;
    }
    (*found).count = min((*found).count + 1u, KEPT);
    var at = (*found).count - 1u;
    while (at > 0u && distance < (*found).distances[at - 1u]) {
        (*found).distances[at] = (*found).distances[at - 1u];
        (*found).nodes[at] = (*found).nodes[at - 1u];
        at -= 1u;
    }
    (*found).distances[at] = distance;
    (*found).nodes[at] = node;
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
    var found: Found;
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
                insert(&found, first + node, distance);
            }
        }
    }
    if (point < sizes.points) {
        for (var rank = 0u; rank < KEPT; rank++) {
            node_of_item[point * KEPT + rank] = found.nodes[rank];
        }
    }
}
