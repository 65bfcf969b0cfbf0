// The gradients of all texels of the six planes of every scale. One invocation per texel and channel adds its corner of
// the surrounding cells, block by block.
#import gpu::grouped::elements
#import gpu::grouped::grouped
#import networks::hexplane::field
#extern fn g_xy(item: u32, at: u32) -> f32
#extern fn set_g_xy(item: u32, at: u32, value: f32)
#extern fn g_xz(item: u32, at: u32) -> f32
#extern fn set_g_xz(item: u32, at: u32, value: f32)
#extern fn g_xt(item: u32, at: u32) -> f32
#extern fn set_g_xt(item: u32, at: u32, value: f32)
#extern fn g_yz(item: u32, at: u32) -> f32
#extern fn set_g_yz(item: u32, at: u32, value: f32)
#extern fn g_yt(item: u32, at: u32) -> f32
#extern fn set_g_yt(item: u32, at: u32, value: f32)
#extern fn g_zt(item: u32, at: u32) -> f32
#extern fn set_g_zt(item: u32, at: u32, value: f32)

// [cells + 1]: index of the first entry of each cell in the list of entries sorted by cell.
@group(0) @binding(1) var<storage, read> entry_starts: array<u32>;
@group(0) @binding(2) var<storage, read> corners: array<f32>;

fn gradient_so_far(scale: u32, plane: u32, at: u32) -> f32 {
    switch plane {
        case 0u: { return g_xy(scale, at); }
        case 1u: { return g_xz(scale, at); }
        case 2u: { return g_xt(scale, at); }
        case 3u: { return g_yz(scale, at); }
        case 4u: { return g_yt(scale, at); }
        default: {}
    }
    return g_zt(scale, at);
}

fn write_gradient(scale: u32, plane: u32, at: u32, gradient: f32) {
    switch plane {
        case 0u: { set_g_xy(scale, at, gradient); }
        case 1u: { set_g_xz(scale, at, gradient); }
        case 2u: { set_g_xt(scale, at, gradient); }
        case 3u: { set_g_yz(scale, at, gradient); }
        case 4u: { set_g_yt(scale, at, gradient); }
        default: { set_g_zt(scale, at, gradient); }
    }
}

// The sum of all blocks' gradients of a corner of a cell.
fn corner_sum(cell: u32, corner: u32, channel: u32) -> f32 {
    let first = entry_starts[cell] - first_entry(0u);
    let end = entry_starts[cell + 1u] - first_entry(0u);
    var sum = 0.0;
    if (first < end) {
        for (var block = first / ENTRIES_PER_BLOCK; block <= (end - 1u) / ENTRIES_PER_BLOCK; block++) {
            let place = block + cell - first_cell(0u, 0u);
            sum += corners[(4u * place + corner) * channels() + channel];
        }
    }
    return sum;
}

// The sum over the cells of a row that have the texel as a corner: at their high end, then at their low end.
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

fn spatial_gradient(scale: u32, plane: u32, a: u32, b: u32, channel: u32) -> f32 {
    let columns = cells(scale, width_axis(plane));
    let rows = cells(scale, height_axis(plane));
    let first = first_cell(scale, plane);
    var sum = 0.0;
    if (b > 0u) {
        sum += row_sum(first + (b - 1u) * columns, columns, a, 2u, channel);
    }
    if (b < rows) {
        sum += row_sum(first + b * columns, columns, a, 0u, channel);
    }
    return sum;
}

// In a time plane, only the two rows around the time have gradients.
fn time_gradient(scale: u32, plane: u32, a: u32, b: u32, channel: u32) -> f32 {
    let own = constants_of(scale);
    let weight = select(0.0, 1.0 - own.time_fraction, b == own.time_low) +
        select(0.0, own.time_fraction, b == own.time_high);
    if (weight == 0.0) {
        return 0.0;
    }
    return weight * row_sum(first_cell(scale, plane), cells(scale, width_axis(plane)), a, 0u, channel);
}

fn gradient_of(scale: u32, plane: u32, element: u32) -> f32 {
    let channel = element % channels();
    let texel = element / channels();
    let width = texels(scale, width_axis(plane));
    if (height_axis(plane) == 3u) {
        return time_gradient(scale, plane, texel % width, texel / width, channel);
    }
    return spatial_gradient(scale, plane, texel % width, texel / width, channel);
}

fn run(scale: u32, at: u32) {
    // Elements are numbered plane by plane.
    var element = at;
    var plane = 0u;
    for (; plane < 6u; plane++) {
        let len = texels(scale, width_axis(plane)) * texels(scale, height_axis(plane)) * channels();
        if (element < len) {
            break;
        }
        element -= len;
    }
    if (plane == 6u) {
        return;
    }
    let gradient = gradient_of(scale, plane, element);
    if ((constants_of(scale).adds >> plane & 1u) == 0u) {
        write_gradient(scale, plane, element, gradient);
    } else if (gradient != 0.0) {
        // Skips the write for the many texels that are near no point.
        write_gradient(scale, plane, element, gradient_so_far(scale, plane, element) + gradient);
    }
}
