// The gradients of every splat's parameters, from those of its projection. One invocation per splat. ARRIVING is a bit
// mask of the upstream gradients that exist: means, conics, depths, opacities, colours. The placeholder for a missing
// one is never read.
#import geometry::algebra
#import gpu::elements_64
#import rasteriser::projection::covariance_factor
#import rasteriser::projection::geometry
#const ARRIVING, GIVEN_FACTORS, SH_DEGREE

@group(0) @binding(6) var<storage, read> cutoffs: array<f32>;
@group(0) @binding(7) var<storage, read> g_means2d: array<f32>;
@group(0) @binding(8) var<storage, read> g_conics: array<f32>;
@group(0) @binding(9) var<storage, read> g_depths: array<f32>;
@group(0) @binding(10) var<storage, read> g_opacities: array<f32>;
@group(0) @binding(11) var<storage, read> g_colors: array<f32>;
@group(0) @binding(12) var<storage, read_write> g_positions: array<f32>;
@group(0) @binding(13) var<storage, read_write> g_logits: array<f32>;
@group(0) @binding(14) var<storage, read_write> g_sh: array<f32>;
@group(0) @binding(15) var<storage, read_write> g_shapes: array<f32>;
@group(0) @binding(16) var<storage, read_write> g_rotations: array<f32>;

fn arrives(bit: u32) -> bool {
    return (ARRIVING & (1u << bit)) != 0u;
}

fn mean_gradient(splat: u32) -> vec2<f32> {
    if (!arrives(0u)) {
        return vec2<f32>(0.0);
    }
    return vec2<f32>(g_means2d[2u * splat], g_means2d[2u * splat + 1u]);
}

fn conic_gradient(splat: u32) -> vec3<f32> {
    if (!arrives(1u)) {
        return vec3<f32>(0.0);
    }
    return vec3<f32>(g_conics[3u * splat], g_conics[3u * splat + 1u], g_conics[3u * splat + 2u]);
}

fn depth_gradient(splat: u32) -> f32 {
    if (!arrives(2u)) {
        return 0.0;
    }
    return g_depths[splat];
}

fn opacity_gradient(splat: u32) -> f32 {
    if (!arrives(3u)) {
        return 0.0;
    }
    return g_opacities[splat];
}

fn color_gradient(splat: u32) -> vec3<f32> {
    if (!arrives(4u)) {
        return vec3<f32>(0.0);
    }
    return vec3<f32>(g_colors[3u * splat], g_colors[3u * splat + 1u], g_colors[3u * splat + 2u]);
}

// The gradient of the covariance (a, b, c), from that of (A, k, m): A = 1/(a − b²/c), k = −b/c, m = 1/c.
fn covariance_gradient(conic: vec3<f32>, g: vec3<f32>) -> vec3<f32> {
    let k = conic.y;
    let m = conic.z;
    let g_variance = -conic.x * conic.x * g.x;
    return vec3<f32>(g_variance, 2.0 * k * g_variance - m * g.y, k * k * g_variance - k * m * g.y - m * m * g.z);
}

fn write_shape_row(first: u32, row: vec3<f32>) {
    for (var axis = 0u; axis < 3u; axis++) {
        g_shapes[first + axis] = row[axis];
    }
}

// Writes the gradients of the shape's inputs, from that of the factor F.
fn write_shape_gradient(splat: u32, factor: Factor, g: Rows) {
    if (GIVEN_FACTORS == 1u) {
        write_shape_row(9u * splat, g.x);
        write_shape_row(9u * splat + 3u, g.y);
        write_shape_row(9u * splat + 6u, g.z);
        return;
    }
    let gradient = scaled_rotation_backward(factor, g);
    write_shape_row(3u * splat, gradient.log_scales);
    for (var i = 0u; i < 4u; i++) {
        g_rotations[4u * splat + i] = gradient.rotation[i];
    }
}

// Returns the gradient of the position through mean, affine map and depth. Writes that of the shape.
fn geometry_backward(splat: u32, geometry: Geometry) -> vec3<f32> {
    let p = geometry.position_view;
    let magnification = view.focal / p.z;
    let slopes = geometry.slopes;

    // The covariance (a, b, c) and its factor V: a = |V₁|², b = V₁·V₂, c = |V₂|².
    let g_abc = covariance_gradient(geometry.conic, conic_gradient(splat));
    let g_row_x = 2.0 * g_abc.x * geometry.factor_x + g_abc.y * geometry.factor_y;
    let g_row_y = g_abc.y * geometry.factor_x + 2.0 * g_abc.z * geometry.factor_y;

    // V = J·M with J = [f/z, 0, −f·slope/z] per row.
    let g_near = vec2<f32>(dot(g_row_x, geometry.factor_view.x), dot(g_row_y, geometry.factor_view.y));
    let g_far = vec2<f32>(dot(g_row_x, geometry.factor_view.z), dot(g_row_y, geometry.factor_view.z));
    let g_view = Rows(
        g_row_x * magnification.x,
        g_row_y * magnification.y,
        -magnification.x * slopes.x * g_row_x - magnification.y * slopes.y * g_row_y,
    );

    let g_uv = mean_gradient(splat);
    var g_position = vec3<f32>(magnification * g_uv, depth_gradient(splat));
    g_position.z -= dot(p.xy, magnification * g_uv) / p.z;
    g_position.z += dot(magnification / p.z, slopes * g_far - g_near);
    let g_slopes = select(vec2<f32>(0.0), -magnification * g_far, geometry.is_free);
    g_position.x += g_slopes.x / p.z;
    g_position.y += g_slopes.y / p.z;
    g_position.z -= dot(g_slopes, slopes) / p.z;

    // Back to world space: the transposed rotation of the camera.
    let camera = camera_rotation();
    let columns = Rows(
        vec3<f32>(camera.x.x, camera.y.x, camera.z.x),
        vec3<f32>(camera.x.y, camera.y.y, camera.z.y),
        vec3<f32>(camera.x.z, camera.y.z, camera.z.z),
    );
    let g_world = Rows(row_times(columns.x, g_view), row_times(columns.y, g_view), row_times(columns.z, g_view));
    write_shape_gradient(splat, geometry.factor_world, g_world);
    return row_times(g_position, camera);
}

// Σₖ gₖ ∇Yₖ(direction), with the components of the direction as independent variables.
fn harmonics_backward(d: vec3<f32>, g: array<f32, 16>) -> vec3<f32> {
    var by = vec3<f32>(0.0);
    let x = d.x;
    let y = d.y;
    let z = d.z;
    if (SH_DEGREE >= 1u) {
        by += 0.4886025119029199 * vec3<f32>(-g[3], -g[1], g[2]);
    }
    if (SH_DEGREE >= 2u) {
        let a = 1.0925484305920792 * g[4];
        let b = -1.0925484305920792 * g[5];
        let c = 0.31539156525252005 * g[6];
        let e = -1.0925484305920792 * g[7];
        let h = 0.5462742152960396 * g[8];
        by += vec3<f32>(
            a * y - 2.0 * c * x + e * z + 2.0 * h * x,
            a * x + b * z - 2.0 * c * y - 2.0 * h * y,
            b * y + 4.0 * c * z + e * x,
        );
    }
    if (SH_DEGREE >= 3u) {
        let a = -0.5900435899266435 * g[9];
        let b = 2.890611442640554 * g[10];
        let c = -0.4570457994644658 * g[11];
        let e = 0.3731763325901154 * g[12];
        let h = -0.4570457994644658 * g[13];
        let k = 1.445305721320277 * g[14];
        let l = -0.5900435899266435 * g[15];
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        by.x += 6.0 * a * x * y + b * y * z - 2.0 * c * x * y - 6.0 * e * x * z
            + h * (4.0 * zz - 3.0 * xx - yy) + 2.0 * k * x * z + 3.0 * l * (xx - yy);
        by.y += 3.0 * a * (xx - yy) + b * x * z + c * (4.0 * zz - xx - 3.0 * yy) - 6.0 * e * y * z
            - 2.0 * h * x * y - 2.0 * k * y * z - 6.0 * l * x * y;
        by.z += b * x * y + 8.0 * c * y * z + 3.0 * e * (2.0 * zz - xx - yy) + 8.0 * h * x * z + k * (xx - yy);
    }
    return by;
}

// Returns the gradient of the position through the viewing direction. Writes that of the harmonics.
fn color_backward(splat: u32) -> vec3<f32> {
    let color = color_of(splat);
    let g_color = select(vec3<f32>(0.0), color_gradient(splat), color.unclamped > vec3<f32>(0.0));
    var g_basis: array<f32, 16>;
    for (var k = 0u; k < COEFFICIENTS; k++) {
        let at = splat * view.sh_len + 3u * k;
        let gradient = color.basis[k] * g_color;
        g_sh[at] = gradient.x;
        g_sh[at + 1u] = gradient.y;
        g_sh[at + 2u] = gradient.z;
        g_basis[k] = dot(coefficient(splat, k), g_color);
    }
    let g_direction = harmonics_backward(color.direction, g_basis);
    let radial = dot(g_direction, color.direction);
    return (g_direction - radial * color.direction) * color.inverse_distance;
}

fn write_zeros(splat: u32) {
    for (var axis = 0u; axis < 3u; axis++) {
        g_positions[3u * splat + axis] = 0.0;
    }
    g_logits[splat] = 0.0;
    let shape_len = select(3u, 9u, GIVEN_FACTORS == 1u);
    for (var at = 0u; at < shape_len; at++) {
        g_shapes[shape_len * splat + at] = 0.0;
    }
    if (GIVEN_FACTORS == 0u) {
        for (var at = 0u; at < 4u; at++) {
            g_rotations[4u * splat + at] = 0.0;
        }
    }
}

fn run(splat: u32) {
    if (splat >= view.count) {
        return;
    }
    let geometry = geometry_of(splat);
    let drawn = cutoffs[splat] >= 0.0 && geometry.usable;
    // Zeroes the gradients of unused harmonics, and of all harmonics of a culled splat.
    let first = select(0u, 3u * COEFFICIENTS, drawn);
    for (var at = first; at < view.sh_len; at++) {
        g_sh[splat * view.sh_len + at] = 0.0;
    }
    if (!drawn) {
        write_zeros(splat);
        return;
    }
    let g_position = geometry_backward(splat, geometry) + color_backward(splat);
    for (var axis = 0u; axis < 3u; axis++) {
        g_positions[3u * splat + axis] = g_position[axis];
    }
    let logit = opacity_logits[splat];
    g_logits[splat] = opacity_gradient(splat) * sigmoid(logit) * sigmoid(-logit);
}
