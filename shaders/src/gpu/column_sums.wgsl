// Sums two terms per row and column, `terms(row, column)`, over blocks of rows. A workgroup sums COLUMNS columns of one
// block. The output is [blocks, 2, columns].
#import gpu::column_sum
#import gpu::flat_group
#const COLUMNS
#extern fn terms(row: u32, column: u32) -> vec2<f32>

struct Sums {
    rows: u32,
    columns: u32,
    block_rows: u32,
}

@group(0) @binding(0) var<uniform> sums: Sums;
@group(0) @binding(1) var<storage, read_write> block_sums: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tiles = (sums.columns + COLUMNS - 1u) / COLUMNS;
    let block = flat_group(group, groups) / tiles;
    let column = flat_group(group, groups) % tiles * COLUMNS + local % COLUMNS;
    let end = min((block + 1u) * sums.block_rows, sums.rows);
    var own = vec2<f32>(0.0);
    if (column < sums.columns) {
        for (var row = block * sums.block_rows + local / COLUMNS; row < end; row += 256u / COLUMNS) {
            own += terms(row, column);
        }
    }
    let first = column_sum(local, own.x);
    let second = column_sum(local, own.y);
    // A folded dispatch may have workgroups past the last block.
    if (local < COLUMNS && column < sums.columns && block * sums.block_rows < sums.rows) {
        block_sums[2u * block * sums.columns + column] = first;
        block_sums[(2u * block + 1u) * sums.columns + column] = second;
    }
}
