// The gradients of the corners of every cell, summed over blocks of the list of entries sorted by cell. One invocation
// per block and channel visits its entries and writes its sums when a cell ends. From one write to the next, the block
// or the cell increases, so that block + cell is a unique index.
#import gpu::elements
#import networks::hexplane::field
#const ITEMS

@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read> g_values: array<f32>;
// Sorted by cell: the cell of each entry, and its index in [6·scales, points], which gives scale, plane and point.
@group(0) @binding(3) var<storage, read> sorted_cells: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<u32>;
// [blocks + cells, 4, channels].
@group(0) @binding(5) var<storage, read_write> corners: array<f32>;

// The weights of the corners: low and high along the width at the low end of the height, then at the high end.
fn weights_of(scale: u32, plane: u32, point: u32) -> vec4<f32> {
    let width = width_axis(plane);
    let height = height_axis(plane);
    let a = lookup(positions[3u * point + width], texels(scale, width)).fraction;
    if (height == 3u) {
        return vec4<f32>(1.0 - a, a, 0.0, 0.0);
    }
    let b = lookup(positions[3u * point + height], texels(scale, height)).fraction;
    return vec4<f32>((1.0 - b) * (1.0 - a), (1.0 - b) * a, b * (1.0 - a), b * a);
}

fn write_corners(place: u32, channel: u32, sums: vec4<f32>) {
    for (var corner = 0u; corner < 4u; corner++) {
        corners[(4u * place + corner) * channels() + channel] = sums[corner];
    }
}

fn run(index: u32) {
    let block = index / channels();
    let channel = index % channels();
    // Entries of the items' scales alone, which are consecutive.
    let count = ITEMS * 6u * points();
    let first = block * ENTRIES_PER_BLOCK;
    if (first >= count) {
        return;
    }
    let end = min(first + ENTRIES_PER_BLOCK, count);
    var cell = sorted_cells[first_entry(0u) + first];
    var sums = vec4<f32>();
    for (var at = first; at < end; at++) {
        let next_cell = sorted_cells[first_entry(0u) + at];
        if (next_cell != cell) {
            write_corners(block + cell - first_cell(0u, 0u), channel, sums);
            cell = next_cell;
            sums = vec4<f32>();
        }
        let entry = entries[first_entry(0u) + at] - first_entry(0u);
        let plane = entry / points();
        let weights = weights_of(plane / 6u, plane % 6u, entry - plane * points());
        sums += weights * g_values[entry * channels() + channel];
    }
    write_corners(block + cell - first_cell(0u, 0u), channel, sums);
}
