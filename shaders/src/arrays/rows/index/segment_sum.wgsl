// The sum of every segment of a list of rows: of the rows themselves, or of those that `items` indexes if INDIRECT is
// 1. If MEAN is 1, the sum is divided by the number of items of the segment. One invocation per segment and column.
#import gpu::elements
#const INDIRECT, MEAN

struct Segments {
    columns: u32,
}

@group(0) @binding(0) var<uniform> sizes: Segments;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> items: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> item_starts: array<u32>;
@group(0) @binding(5) var<storage, read_write> y: array<f32>;

fn run(index: u32) {
    if (index >= arrayLength(&y)) {
        return;
    }
    let segment = index / sizes.columns;
    let column = index % sizes.columns;
    var sum = 0.0;
    for (var at = starts[segment]; at < starts[segment + 1u]; at++) {
        var row = at;
        if (INDIRECT == 1u) {
            row = items[at];
        }
        sum += x[row * sizes.columns + column];
    }
    if (MEAN == 1u) {
        sum *= 1.0 / f32(max(item_starts[segment + 1u] - item_starts[segment], 1u));
    }
    y[index] = sum;
}
