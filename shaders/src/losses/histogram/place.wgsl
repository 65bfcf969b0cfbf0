// Where in the histogram a value lies: the same definitions as on the CPU.

struct Histogram {
    // Values, and blocks of them.
    len: u32,
    blocks: u32,
    bins: u32,
    low: f32,
    // Of a bin.
    width: f32,
    // What a whole value counts.
    share: f32,
}

@group(0) @binding(0) var<uniform> sizes: Histogram;
@group(0) @binding(1) var<storage, read> x: array<f32>;

// By bits: compilers may assume that no number is NaN.
fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

struct Place {
    // The lower of the two bins that share a value, the upper one's part, and whether that part changes with the value.
    lower: u32,
    upper_part: f32,
    inside: bool,
}

fn place_of(value: f32) -> Place {
    // In bin widths from the first centre.
    let at = (value - sizes.low) / sizes.width - 0.5;
    let last = f32(sizes.bins - 1u);
    let clamped = min(max(at, 0.0), last);
    // Of what is not a number any bin will do: the part shows it.
    let lower = select(0.0, min(floor(clamped), last - 1.0), is_finite(at));
    let inside = at > 0.0 && at < last;
    return Place(u32(lower), select(clamped, at, inside || !is_finite(at)) - lower, inside);
}

