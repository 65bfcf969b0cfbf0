// The sorted list of the `kept` nearest nodes of a point, nearest first; ties go to the lower index. The importing file
// stores the list.
#extern fn found_node(rank: u32) -> u32
#extern fn found_distance(rank: u32) -> f32
#extern fn set_found(rank: u32, node: u32, distance: f32)

struct Nearest {
    points: u32,
    nodes: u32,
    axes: u32,
    // Nodes per point.
    kept: u32,
}

@group(0) @binding(0) var<uniform> sizes: Nearest;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> nodes: array<f32>;
// [points, kept].
@group(0) @binding(3) var<storage, read_write> node_of_item: array<u32>;

// Number of nodes in the list so far.
var<private> found_count: u32;

fn insert(node: u32, distance: f32) {
    let is_full = found_count == sizes.kept;
    if (is_full && !(distance < found_distance(sizes.kept - 1u))) {
        return;
    }
    found_count = min(found_count + 1u, sizes.kept);
    var at = found_count - 1u;
    while (at > 0u && distance < found_distance(at - 1u)) {
        set_found(at, found_node(at - 1u), found_distance(at - 1u));
        at -= 1u;
    }
    set_found(at, node, distance);
}
