// Gathers the row of every item; if MEAN is 1, divided by the number of items of that row. One invocation per element.
#import gpu::elements
#const MEAN

struct Items {
    columns: u32,
}

@group(0) @binding(0) var<uniform> sizes: Items;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> row_of_item: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read_write> y: array<f32>;

fn run(index: u32) {
    if (index >= arrayLength(&y)) {
        return;
    }
    let row = row_of_item[index / sizes.columns];
    var value = x[row * sizes.columns + index % sizes.columns];
    if (MEAN == 1u) {
        value *= 1.0 / f32(starts[row + 1u] - starts[row]);
    }
    y[index] = value;
}
