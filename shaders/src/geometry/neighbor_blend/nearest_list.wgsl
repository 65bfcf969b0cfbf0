// The sorted list of the `kept()` nearest nodes of a point, nearest first; ties go to the lower index. The importing file
// stores the list.
#extern fn found_node(rank: u32) -> u32
#extern fn found_distance(rank: u32) -> f32
#extern fn set_found(rank: u32, node: u32, distance: f32)
#extern fn kept() -> u32

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
    if (found_count == kept() && !(distance < found_distance(kept() - 1u))) {
        return;
    }
    // The node goes before the first one that is farther, and all later ones move on by one rank. With a constant length,
    // drivers unroll the loop and keep the list in registers.
    var own = node;
    var own_distance = distance;
    var is_placed = false;
    for (var rank = 0u; rank < kept(); rank++) {
        let next = found_node(rank);
        let next_distance = found_distance(rank);
        is_placed = is_placed || rank >= found_count || own_distance < next_distance;
        if (is_placed) {
            set_found(rank, own, own_distance);
            own = next;
            own_distance = next_distance;
        }
    }
    found_count = min(found_count + 1u, kept());
}
