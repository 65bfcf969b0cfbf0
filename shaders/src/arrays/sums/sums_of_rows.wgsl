// Column sums over blocks of rows. One invocation per block and column.

struct Rows {
    rows: u32,
    columns: u32,
    rows_per_block: u32,
}

@group(0) @binding(0) var<uniform> sizes: Rows;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_group(group, groups) * 256u + local;
    if (index >= arrayLength(&sums)) {
        return;
    }
    let first = index / sizes.columns * sizes.rows_per_block;
    let end = min(first + sizes.rows_per_block, sizes.rows);
    var sum = 0.0;
    for (var row = first; row < end; row++) {
        sum += x[row * sizes.columns + index % sizes.columns];
    }
    sums[index] = sum;
}
