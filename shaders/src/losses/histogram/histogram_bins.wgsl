// The bins of a value of the soft histogram: the same definitions as on the CPU.
#import gpu::is_finite

struct Histogram {
    // Number of values, and of blocks of values.
    len: u32,
    blocks: u32,
    bins: u32,
    low: f32,
    // Width of a bin.
    width: f32,
    // Total share of one value.
    share: f32,
}

@group(0) @binding(0) var<uniform> sizes: Histogram;
@group(0) @binding(1) var<storage, read> x: array<f32>;

struct Place {
    // The lower of the two bins that share a value, the upper bin's part, and whether that part depends on the value.
    lower: u32,
    upper_part: f32,
    inside: bool,
}

fn place_of(value: f32) -> Place {
    // In bin widths from the first centre.
    let at = (value - sizes.low) / sizes.width - 0.5;
    let last = f32(sizes.bins - 1u);
    let clamped = min(max(at, 0.0), last);
    // A value that is not finite goes to any bin: its part is not finite.
    let lower = select(0.0, min(floor(clamped), last - 1.0), is_finite(at));
    let inside = at > 0.0 && at < last;
    return Place(u32(lower), select(clamped, at, inside || !is_finite(at)) - lower, inside);
}
