// The scales of a hexplane field at one time; each scale is an item. The six planes xy, xz, xt, yz, yt, zt have the
// shape [height, width, channels].
#import gpu::grouped::grouped
#import gpu::is_finite

struct Item {
    // Texels along x, y, z and t.
    resolution: vec4<u32>,
    // Index of the first cell of each of this scale's planes, in a numbering over all planes. A cell has a texel at
    // every corner. The cells of a time plane form a single row, because all points have the same time.
    cell_starts: array<vec4<u32>, 2>,
    points: u32,
    channels: u32,
    // Feature columns of all scales.
    features: u32,
    // Index of this scale in the field, of whose scales only some may be items.
    number: u32,
    // The rows of the time planes around the time, and the weight of the second.
    time_low: u32,
    time_high: u32,
    time_fraction: f32,
    // Bit mask of the planes whose gradients are added to the current values.
    adds: u32,
}

// Entries of the sorted list that one invocation sums.
const ENTRIES_PER_BLOCK: u32 = 32u;

// The axis along the width of a plane.
fn width_axis(plane: u32) -> u32 {
    return select(select(2u, 1u, plane < 5u), 0u, plane < 3u);
}

// The axis along the height of a plane; axis 3 is time.
fn height_axis(plane: u32) -> u32 {
    return select(select(3u, plane - 1u, plane < 5u), plane + 1u, plane < 3u);
}

// The number of points, which all scales share.
fn points() -> u32 {
    return grouped.items[0].constants.points;
}

// The number of channels, which all scales share.
fn channels() -> u32 {
    return grouped.items[0].constants.channels;
}

fn texels(scale: u32, axis: u32) -> u32 {
    return grouped.items[scale].constants.resolution[axis];
}

// Index of the first entry of a scale in the list of entries.
fn first_entry(scale: u32) -> u32 {
    return 6u * grouped.items[scale].constants.number * points();
}

fn first_cell(scale: u32, plane: u32) -> u32 {
    return grouped.items[scale].constants.cell_starts[plane / 4u][plane % 4u];
}

// The number of cells along an axis.
fn cells(scale: u32, axis: u32) -> u32 {
    return max(texels(scale, axis), 2u) - 1u;
}

// Linear interpolation between neighbouring texels of one axis.
struct Lookup {
    low: u32,
    high: u32,
    // Weight of `high`.
    fraction: f32,
    // d(texel coordinate)/d(coordinate); 0 outside [−1, 1].
    slope: f32,
}

fn lookup(coordinate: f32, texels: u32) -> Lookup {
    let half_span = 0.5 * f32(texels - 1u);
    let last = half_span + half_span;
    let unclamped = (coordinate + 1.0) * half_span;
    var texel = unclamped;
    if (unclamped < 0.0) {
        texel = 0.0;
    } else if (unclamped > last) {
        texel = last;
    }
    // By its bits: drivers may turn the branches into a minimum and a maximum, which replace NaN by a number.
    if (is_nan(coordinate)) {
        texel = coordinate;
    }
    // Clamped, so that the texel is in range even for NaN.
    let low = min(u32(max(texel, 0.0)), max(texels, 2u) - 2u);
    let is_inside = coordinate >= -1.0 && coordinate <= 1.0;
    return Lookup(low, min(low + 1u, texels - 1u), texel - f32(low), select(0.0, half_span, is_inside));
}

fn time_lookup(scale: u32) -> Lookup {
    let own = constants_of(scale);
    return Lookup(own.time_low, own.time_high, own.time_fraction, 0.0);
}
