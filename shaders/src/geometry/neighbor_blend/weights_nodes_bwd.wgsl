// The gradients of the nodes' positions, logarithmic radii and gates. LANES invocations per node; each takes every
// LANES-th of the points that follow the node, AXES axes at a time.
#import geometry::neighbor_blend::node_weight
#import gpu::flat_group
#import gpu::row_sum
#const AXES, LANES

@group(0) @binding(5) var<storage, read> items: array<u32>;
@group(0) @binding(6) var<storage, read> starts: array<u32>;
@group(0) @binding(7) var<storage, read> unnormalised: array<f32>;
@group(0) @binding(8) var<storage, read_write> g_nodes: array<f32>;
@group(0) @binding(9) var<storage, read_write> g_log_radii: array<f32>;
@group(0) @binding(10) var<storage, read_write> g_gates: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let node = flat_group(group, groups) * (256u / LANES) + local / LANES;
    for (var first = 0u; first < sizes.axes; first += AXES) {
        add_followers(local, node, first);
    }
}

// Sums the gradients along AXES axes from `first` on. The pass from axis 0 also sums those of radius and gate.
fn add_followers(local: u32, node: u32, first: u32) {
    var g_position: array<f32, AXES>;
    var g_radius = 0.0;
    var g_gate = 0.0;
    let axes = min(AXES, sizes.axes - first);
    if (node < sizes.nodes) {
        for (var at = starts[node] + local % LANES; at < starts[node + 1u]; at += LANES) {
            let point = items[at] / sizes.per_point;
            let pair = pair_of(point, node);
            let dweight = unnormalised[items[at]];
            let pull = dweight * pair.gate * pair.falloff * pair.inverse_variance;
            for (var axis = 0u; axis < axes; axis++) {
                g_position[axis] += pull * difference(point, node, first + axis);
            }
            g_radius += pull * pair.squared_distance;
            g_gate += dweight * pair.falloff * pair.gate * (1.0 - pair.gate);
        }
    }
    let writes = node < sizes.nodes && local % LANES == 0u;
    for (var axis = 0u; axis < axes; axis++) {
        let sum = row_sum(local, g_position[axis]);
        if (writes) {
            g_nodes[node * sizes.axes + first + axis] = sum;
        }
    }
    if (first > 0u) {
        return;
    }
    let radius = row_sum(local, g_radius);
    let gate = row_sum(local, g_gate);
    if (writes) {
        g_log_radii[node] = radius;
        g_gates[node] = gate;
    }
}
