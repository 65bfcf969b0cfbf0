// Adds the block sums of `column_sums` [blocks, 2, columns] in a fixed order. A workgroup sums COLUMNS columns.
#import gpu::column_sum
#import gpu::flat_group
#const COLUMNS

struct Totals {
    blocks: u32,
    columns: u32,
}

@group(0) @binding(0) var<uniform> totals: Totals;
@group(0) @binding(1) var<storage, read> block_sums: array<f32>;
@group(0) @binding(2) var<storage, read_write> first: array<f32>;
@group(0) @binding(3) var<storage, read_write> second: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let column = flat_group(group, groups) * COLUMNS + local % COLUMNS;
    var own = vec2<f32>(0.0);
    if (column < totals.columns) {
        for (var block = local / COLUMNS; block < totals.blocks; block += 256u / COLUMNS) {
            own.x += block_sums[2u * block * totals.columns + column];
            own.y += block_sums[(2u * block + 1u) * totals.columns + column];
        }
    }
    let total_x = column_sum(local, own.x);
    let total_y = column_sum(local, own.y);
    if (local < COLUMNS && column < totals.columns) {
        first[column] = total_x;
        second[column] = total_y;
    }
}
