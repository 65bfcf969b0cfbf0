// The gradients of the nodes' values. A workgroup sums COLUMNS columns of one node over the points that follow it.
#import gpu::column_sum
#import gpu::flat_group
#const COLUMNS

struct Blend {
    points: u32,
    per_point: u32,
    columns: u32,
    nodes: u32,
}

@group(0) @binding(0) var<uniform> sizes: Blend;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read> items: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> dy: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_values: array<f32>;

const LANES: u32 = 256u / COLUMNS;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tiles = (sizes.columns + COLUMNS - 1u) / COLUMNS;
    let node = flat_group(group, groups) / tiles;
    let column = flat_group(group, groups) % tiles * COLUMNS + local % COLUMNS;
    let in_range = node < sizes.nodes && column < sizes.columns;
    var sum = 0.0;
    if (in_range) {
        for (var at = starts[node] + local / COLUMNS; at < starts[node + 1u]; at += LANES) {
            sum += weights[items[at]] * dy[items[at] / sizes.per_point * sizes.columns + column];
        }
    }
    let total = column_sum(local, sum);
    if (in_range && local < COLUMNS) {
        g_values[node * sizes.columns + column] = total;
    }
}
