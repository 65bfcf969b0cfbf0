// Copies columns of rows to columns of other rows; 0 for a missing source column. One invocation per element.
#import gpu::elements

struct Columns {
    // Rows and columns of the destination. The strides between rows are `from_stride` and `to_stride` elements.
    rows: u32,
    width: u32,
    from_stride: u32,
    from_columns: u32,
    // The source column of the first destination column. Values just below 2³² stand for negative columns.
    from_first: u32,
    to_stride: u32,
}

@group(0) @binding(0) var<uniform> sizes: Columns;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> y: array<f32>;

fn run(index: u32) {
    if (index >= sizes.rows * sizes.width) {
        return;
    }
    let row = index / sizes.width;
    let column = index % sizes.width;
    let source = column + sizes.from_first;
    var value = 0.0;
    if (source < sizes.from_columns) {
        value = x[row * sizes.from_stride + source];
    }
    y[row * sizes.to_stride + column] = value;
}
