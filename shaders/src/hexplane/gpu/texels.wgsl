// The gradients of all texels of the six planes: each adds its corner of the cells around it, block by block.

// [cells + 1]: where the entries of a cell begin in the list by cells.
@group(0) @binding(1) var<storage, read> entry_starts: array<u32>;
@group(0) @binding(2) var<storage, read> corners: array<f32>;
@group(0) @binding(3) var<storage, read_write> g_xy: array<f32>;
@group(0) @binding(4) var<storage, read_write> g_xz: array<f32>;
@group(0) @binding(5) var<storage, read_write> g_xt: array<f32>;
@group(0) @binding(6) var<storage, read_write> g_yz: array<f32>;
@group(0) @binding(7) var<storage, read_write> g_yt: array<f32>;
@group(0) @binding(8) var<storage, read_write> g_zt: array<f32>;

fn write_gradient(plane: u32, at: u32, gradient: f32) {
    switch plane {
        case 0u: { g_xy[at] = gradient; }
        case 1u: { g_xz[at] = gradient; }
        case 2u: { g_xt[at] = gradient; }
        case 3u: { g_yz[at] = gradient; }
        case 4u: { g_yt[at] = gradient; }
        default: { g_zt[at] = gradient; }
    }
}

// What the blocks have for a corner of a cell.
fn corner_sum(cell: u32, corner: u32, channel: u32) -> f32 {
    let first = entry_starts[cell] - scale.first_entry;
    let end = entry_starts[cell + 1u] - scale.first_entry;
    var sum = 0.0;
    if (first < end) {
        for (var block = first / ENTRIES_PER_BLOCK; block <= (end - 1u) / ENTRIES_PER_BLOCK; block++) {
            let place = block + cell - first_cell(0u);
            sum += corners[(4u * place + corner) * scale.channels + channel];
        }
    }
    return sum;
}

// The sum over the cells of a row of cells that have the texel: as their high end, then as their low end.
fn row_sum(first: u32, count: u32, texel: u32, corner: u32, channel: u32) -> f32 {
    var sum = 0.0;
    if (texel > 0u) {
        sum += corner_sum(first + texel - 1u, corner + 1u, channel);
    }
    if (texel < count) {
        sum += corner_sum(first + texel, corner, channel);
    }
    return sum;
}

fn spatial_gradient(plane: u32, a: u32, b: u32, channel: u32) -> f32 {
    let columns = cells(width_axis(plane));
    let rows = cells(height_axis(plane));
    var sum = 0.0;
    if (b > 0u) {
        sum += row_sum(first_cell(plane) + (b - 1u) * columns, columns, a, 2u, channel);
    }
    if (b < rows) {
        sum += row_sum(first_cell(plane) + b * columns, columns, a, 0u, channel);
    }
    return sum;
}

// Of the rows of a time plane only the two around the time have gradients.
fn time_gradient(plane: u32, a: u32, b: u32, channel: u32) -> f32 {
    let weight = select(0.0, 1.0 - scale.time_fraction, b == scale.time_low) +
        select(0.0, scale.time_fraction, b == scale.time_high);
    if (weight == 0.0) {
        return 0.0;
    }
    return weight * row_sum(first_cell(plane), cells(width_axis(plane)), a, 0u, channel);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    // The elements of all planes, plane by plane.
    var element = flat_group(group, groups) * 256u + local;
    var plane = 0u;
    for (; plane < 6u; plane++) {
        let len = scale.resolution[width_axis(plane)] * scale.resolution[height_axis(plane)] * scale.channels;
        if (element < len) {
            break;
        }
        element -= len;
    }
    if (plane == 6u) {
        return;
    }
    let channel = element % scale.channels;
    let a = element / scale.channels % scale.resolution[width_axis(plane)];
    let b = element / scale.channels / scale.resolution[width_axis(plane)];
    if (height_axis(plane) == 3u) {
        write_gradient(plane, element, time_gradient(plane, a, b, channel));
    } else {
        write_gradient(plane, element, spatial_gradient(plane, a, b, channel));
    }
}
