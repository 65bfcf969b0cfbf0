// The gradients of every 4D Gaussian's parameters; zero for an absent Gaussian. One invocation per Gaussian. ARRIVING
// is a bit mask of the upstream gradients that exist: displacements, velocities, factors, opacities. The placeholder
// for a missing one is never read.
#import geometry::algebra
#import gpu::elements_64
#import rasteriser::slicing4d::stored_gaussian
#import rasteriser::slicing4d::time_slice
#const ARRIVING

@group(0) @binding(7) var<storage, read> g_displacements: array<f32>;
@group(0) @binding(8) var<storage, read> g_velocities: array<f32>;
@group(0) @binding(9) var<storage, read> g_factors: array<f32>;
@group(0) @binding(10) var<storage, read> g_faded_logits: array<f32>;
@group(0) @binding(11) var<storage, read_write> g_log_scales: array<f32>;
@group(0) @binding(12) var<storage, read_write> g_log_scales_time: array<f32>;
@group(0) @binding(13) var<storage, read_write> g_rotations_left: array<vec4<f32>>;
@group(0) @binding(14) var<storage, read_write> g_rotations_right: array<vec4<f32>>;
@group(0) @binding(15) var<storage, read_write> g_times: array<f32>;
@group(0) @binding(16) var<storage, read_write> g_opacity_logits: array<f32>;

struct Upstream {
    displacement: vec3<f32>,
    velocity: vec3<f32>,
    factor: Rows,
    opacity_logit: f32,
}

fn factor_row(first: u32) -> vec3<f32> {
    return vec3<f32>(g_factors[first], g_factors[first + 1u], g_factors[first + 2u]);
}

fn upstream_of(row: u32) -> Upstream {
    var upstream: Upstream;
    let at = 3u * row;
    if ((ARRIVING & 1u) != 0u) {
        upstream.displacement = vec3<f32>(g_displacements[at], g_displacements[at + 1u], g_displacements[at + 2u]);
    }
    if ((ARRIVING & 2u) != 0u) {
        upstream.velocity = vec3<f32>(g_velocities[at], g_velocities[at + 1u], g_velocities[at + 2u]);
    }
    if ((ARRIVING & 4u) != 0u) {
        upstream.factor = Rows(factor_row(9u * row), factor_row(9u * row + 3u), factor_row(9u * row + 6u));
    }
    if ((ARRIVING & 8u) != 0u) {
        upstream.opacity_logit = g_faded_logits[row];
    }
    return upstream;
}

// The gradient of q, from that of `left_matrix(q)`.
fn left_backward(g: mat4x4<f32>) -> vec4<f32> {
    return vec4<f32>(
        g[0].x + g[1].y + g[2].z + g[3].w,
        g[0].w - g[1].z + g[2].y - g[3].x,
        g[0].z + g[1].w - g[2].x - g[3].y,
        g[1].x - g[0].y + g[2].w - g[3].z,
    );
}

// The gradient of q, from that of `right_matrix(q)`.
fn right_backward(g: mat4x4<f32>) -> vec4<f32> {
    return vec4<f32>(
        g[0].x + g[1].y + g[2].z + g[3].w,
        g[2].y - g[0].w - g[1].z + g[3].x,
        g[0].z - g[1].w - g[2].x + g[3].y,
        g[1].x - g[0].y - g[2].w + g[3].z,
    );
}

// The gradient of v, from that of v/|v|: the component of `g` tangential to the unit vector, divided by the length.
fn direction_backward(unit: vec4<f32>, inverse_length: f32, g: vec4<f32>) -> vec4<f32> {
    return (g - dot(g, unit) * unit) * inverse_length;
}

// Returns the gradient of L.
fn cut_backward(
    axes: Axes,
    time_row: TimeRow,
    cut: Cut,
    g_velocity: vec3<f32>,
    g_factor: Rows,
    g_fade: f32,
) -> mat4x4<f32> {
    let g_rows = mat3x3<f32>(g_factor.x, g_factor.y, g_factor.z);
    var g_lengths: mat4x4<f32>;
    var g_direction = vec4<f32>(0.0);
    var g_normal = vec4<f32>(0.0);
    var g_deviation = g_fade;
    for (var axis = 0u; axis < 3u; axis++) {
        let row = axes.lengths[axis];
        // velocity = row·direction/σ.
        let g = g_velocity[axis] / time_row.deviation;
        g_deviation -= g * cut.velocity[axis];
        g_direction += g * row;

        // factor = row − 2(row·û)û without its last column.
        let g_reflected = vec4<f32>(g_rows[axis], 0.0);
        g_normal -= 2.0 * (dot(g_reflected, cut.normal) * row + dot(row, cut.normal) * g_reflected);
        g_lengths[axis] = reflected(g_reflected, cut.normal) + g * time_row.direction;
    }
    g_direction += direction_backward(cut.normal, cut.inverse_normal_length, g_normal);
    let along = select(g_deviation, 0.0, time_row.is_clamped);
    g_lengths[3] = direction_backward(time_row.direction, time_row.inverse_length, g_direction)
        + along * time_row.direction;
    return g_lengths;
}

// Writes the gradients of the logarithms of the scales and of both quaternions.
fn write_axes(row: u32, axes: Axes, g: mat4x4<f32>) {
    let l = axes.lengths;
    let along = l[0] * g[0] + l[1] * g[1] + l[2] * g[2] + l[3] * g[3];
    for (var axis = 0u; axis < 3u; axis++) {
        g_log_scales[3u * row + axis] = along[axis];
    }
    g_log_scales_time[row] = along.w;
    let s = axes.scales;
    let g_rotation = mat4x4<f32>(g[0] * s, g[1] * s, g[2] * s, g[3] * s);
    let g_left = left_backward(transpose(right_matrix(axes.right.quaternion)) * g_rotation);
    let g_right = right_backward(g_rotation * transpose(left_matrix(axes.left.quaternion)));
    g_rotations_left[row] = normalised_backward(axes.left, g_left);
    g_rotations_right[row] = normalised_backward(axes.right, g_right);
}

fn write_zeros(row: u32) {
    for (var axis = 0u; axis < 3u; axis++) {
        g_log_scales[3u * row + axis] = 0.0;
    }
    g_log_scales_time[row] = 0.0;
    g_rotations_left[row] = vec4<f32>(0.0);
    g_rotations_right[row] = vec4<f32>(0.0);
    g_times[row] = 0.0;
    g_opacity_logits[row] = 0.0;
}

fn run(row: u32) {
    if (row >= slicing.count) {
        return;
    }
    let gaussian = gaussian_of(row);
    let axes = axes_of(gaussian);
    let time_row = time_row_of(axes.lengths[3]);
    if (!is_present(gaussian, time_row)) {
        write_zeros(row);
        return;
    }
    let upstream = upstream_of(row);
    let cut = cut_of(axes, time_row);
    let offset = gaussian.offset_time;
    let fade = faded(gaussian.opacity_logit, log_share(offset, time_row.deviation));
    let g_log_share = upstream.opacity_logit * fade.by_log_share;

    // displacement = Δt·velocity, log share = −½Δt²/σ².
    let g_velocity = upstream.velocity + offset * upstream.displacement;
    let inverse = 1.0 / time_row.deviation;
    let g_offset = dot(cut.velocity, upstream.displacement) - g_log_share * offset * inverse * inverse;
    let g_deviation = g_log_share * offset * offset * inverse * inverse * inverse;
    write_axes(row, axes, cut_backward(axes, time_row, cut, g_velocity, upstream.factor, g_deviation));
    g_times[row] = -g_offset;
    g_opacity_logits[row] = upstream.opacity_logit * fade.by_logit;
}
