// The 2×2 window of texels that a position between pixel centres samples: the same definitions as on the CPU. If EDGES
// is 1, windows across an edge (texels that vary too much) are not interpolated.
#import gpu::is_finite
#const EDGES

struct Lookup {
    width: u32,
    height: u32,
    channels: u32,
    // Number of positions.
    count: u32,
    // The fraction of the largest magnitude by which the texels of an interpolated window may vary.
    relative: f32,
}

@group(0) @binding(0) var<uniform> sizes: Lookup;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> pixels: array<vec2<f32>>;

// The two texels along one axis.
struct Axis {
    within: bool,
    texels: vec2<u32>,
    weights: vec2<f32>,
    // Derivative of the second weight; 0 beyond the outermost pixel centres.
    slope: f32,
}

struct Window {
    valid: bool,
    // First row before second, left before right. Texels beyond the border repeat the border.
    texels: vec4<u32>,
    weights: vec4<f32>,
    // ∂weights / ∂uₓ and ∂u_y.
    slopes_x: vec4<f32>,
    slopes_y: vec4<f32>,
}

fn axis_of(position: f32, size: u32) -> Axis {
    var axis: Axis;
    axis.within = is_finite(position) && position >= 0.0 && position <= f32(size);
    if (!axis.within) {
        return axis;
    }
    let from_first = position - 0.5;
    let clamped = min(max(from_first, 0.0), f32(size - 1u));
    let first = min(u32(clamped), max(size, 2u) - 2u);
    let share = clamped - f32(first);
    axis.texels = vec2<u32>(first, min(first + 1u, size - 1u));
    axis.weights = vec2<f32>(1.0 - share, share);
    axis.slope = select(0.0, 1.0, clamped == from_first);
    return axis;
}

fn texel_is_finite(texel: u32) -> bool {
    for (var channel = 0u; channel < sizes.channels; channel++) {
        if (!is_finite(image[texel * sizes.channels + channel])) {
            return false;
        }
    }
    return true;
}

// Whether any channel varies by more than `relative` times the largest magnitude, or is not finite.
fn varies(texels: vec4<u32>) -> bool {
    var spread = 0.0;
    var largest = 0.0;
    for (var channel = 0u; channel < sizes.channels; channel++) {
        let at = texels * sizes.channels + channel;
        let values = vec4<f32>(image[at.x], image[at.y], image[at.z], image[at.w]);
        for (var corner = 0u; corner < 4u; corner++) {
            if (!is_finite(values[corner])) {
                return true;
            }
        }
        let low = min(min(values.x, values.y), min(values.z, values.w));
        let high = max(max(values.x, values.y), max(values.z, values.w));
        spread = max(spread, high - low);
        largest = max(largest, max(abs(high), abs(low)));
    }
    return spread > sizes.relative * largest;
}

fn window_of(pixel: vec2<f32>) -> Window {
    var window: Window;
    let x = axis_of(pixel.x, sizes.width);
    let y = axis_of(pixel.y, sizes.height);
    window.valid = x.within && y.within;
    if (!window.valid) {
        return window;
    }
    let rows = y.texels * sizes.width;
    window.texels = vec4<u32>(rows.xx + x.texels, rows.yy + x.texels);
    window.weights = vec4<f32>(y.weights.x * x.weights, y.weights.y * x.weights);
    let along_x = vec2<f32>(-x.slope, x.slope);
    window.slopes_x = vec4<f32>(y.weights.x * along_x, y.weights.y * along_x);
    window.slopes_y = vec4<f32>(-y.slope * x.weights, y.slope * x.weights);
    let jumps = EDGES == 1u && varies(window.texels);
    if (jumps) {
        let kept = 2u * u32(y.weights.y > y.weights.x) + u32(x.weights.y > x.weights.x);
        window.weights = select(vec4<f32>(0.0), vec4<f32>(1.0), vec4<u32>(0u, 1u, 2u, 3u) == vec4<u32>(kept));
        window.slopes_x = vec4<f32>(0.0);
        window.slopes_y = vec4<f32>(0.0);
    }
    for (var corner = 0u; corner < 4u; corner++) {
        let is_used = !jumps || window.weights[corner] != 0.0;
        window.valid = window.valid && (!is_used || texel_is_finite(window.texels[corner]));
    }
    return window;
}
