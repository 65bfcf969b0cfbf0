// Column sums over blocks of rows. One invocation per block and column.
#import gpu::elements

struct Rows {
    rows: u32,
    columns: u32,
    rows_per_block: u32,
}

@group(0) @binding(0) var<uniform> sizes: Rows;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

fn run(index: u32) {
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
