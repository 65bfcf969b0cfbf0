// Projects one splat with one camera, for both directions: the same definitions as the CPU reference. SH_DEGREE is the
// degree of the harmonics. GIVEN_FACTORS is 1 if the inputs are the factors of the covariances.
#import geometry::algebra
#import gpu::is_finite
#import rasteriser::projection::covariance_factor
#const GIVEN_FACTORS, SH_DEGREE

struct View {
    // Rows of camera_from_world, with the translation last.
    rows: array<vec4<f32>, 3>,
    position_world: vec3<f32>,
    alpha_cap: f32,
    focal: vec2<f32>,
    center: vec2<f32>,
    size: vec2<f32>,
    near: f32,
    far: f32,
    // Range of x/z and y/z within which the affine approximation is taken at the splat; outside, at the nearest limit.
    slope_low: vec2<f32>,
    slope_high: vec2<f32>,
    dilation: f32,
    alpha_min: f32,
    count: u32,
    sh_len: u32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read> opacity_logits: array<f32>;
@group(0) @binding(3) var<storage, read> sh: array<f32>;
// Logarithms of the standard deviations [N, 3], or factors [N, 9].
@group(0) @binding(4) var<storage, read> shapes: array<f32>;
@group(0) @binding(5) var<storage, read> rotations: array<f32>;

// Below this distance to the camera the viewing direction is undefined.
const MIN_DISTANCE: f32 = 1e-8;
const COEFFICIENTS: u32 = (SH_DEGREE + 1u) * (SH_DEGREE + 1u);

struct Geometry {
    usable: bool,
    position_view: vec3<f32>,
    // x/z and y/z, clamped, and whether each is within its range.
    slopes: vec2<f32>,
    is_free: vec2<bool>,
    factor_world: Factor,
    factor_view: Rows,
    // J·factor_view: the 2×3 factor of the covariance in px.
    factor_x: vec3<f32>,
    factor_y: vec3<f32>,
    variances: vec2<f32>,
    mean2d: vec2<f32>,
    // A, k, m.
    conic: vec3<f32>,
}

struct Color {
    direction: vec3<f32>,
    // 1/distance; zero if the direction is undefined.
    inverse_distance: f32,
    basis: array<f32, 16>,
    unclamped: vec3<f32>,
}

fn camera_rotation() -> Rows {
    return Rows(view.rows[0].xyz, view.rows[1].xyz, view.rows[2].xyz);
}

fn position_of(splat: u32) -> vec3<f32> {
    return vec3<f32>(positions[3u * splat], positions[3u * splat + 1u], positions[3u * splat + 2u]);
}

fn shape_row(first: u32) -> vec3<f32> {
    return vec3<f32>(shapes[first], shapes[first + 1u], shapes[first + 2u]);
}

fn given_factor(splat: u32) -> Rows {
    return Rows(shape_row(9u * splat), shape_row(9u * splat + 3u), shape_row(9u * splat + 6u));
}

fn raw_rotation(splat: u32) -> vec4<f32> {
    let at = 4u * splat;
    return vec4<f32>(rotations[at], rotations[at + 1u], rotations[at + 2u], rotations[at + 3u]);
}

fn coefficient(splat: u32, k: u32) -> vec3<f32> {
    let at = splat * view.sh_len + 3u * k;
    return vec3<f32>(sh[at], sh[at + 1u], sh[at + 2u]);
}

fn largest(m: Rows) -> f32 {
    let rows = max(max(abs(m.x), abs(m.y)), abs(m.z));
    return max(max(rows.x, rows.y), rows.z);
}

// Whether the shape inputs whose infinities and NaNs the projection may hide are finite.
fn shape_is_finite(splat: u32) -> bool {
    if (GIVEN_FACTORS == 1u) {
        let m = given_factor(splat);
        return is_finite3(m.x) && is_finite3(m.y) && is_finite3(m.z);
    }
    let q = raw_rotation(splat);
    return is_finite3(q.xyz) && is_finite(q.w);
}

fn factor_of(splat: u32) -> Factor {
    if (GIVEN_FACTORS == 1u) {
        var factor: Factor;
        factor.matrix = given_factor(splat);
        factor.in_range = shape_is_finite(splat) && largest(factor.matrix) <= MAX_SCALE;
        return factor;
    }
    return scaled_rotation(shape_row(3u * splat), raw_rotation(splat));
}

fn position_in_view(splat: u32) -> vec3<f32> {
    let position = vec4<f32>(position_of(splat), 1.0);
    return vec3<f32>(dot(view.rows[0], position), dot(view.rows[1], position), dot(view.rows[2], position));
}

fn geometry_of(splat: u32) -> Geometry {
    var geometry: Geometry;
    geometry.usable = false;
    let p = position_in_view(splat);
    geometry.position_view = p;
    if (!(is_finite(p.z) && p.z >= view.near && p.z < view.far)) {
        return geometry;
    }
    geometry.factor_world = factor_of(splat);
    if (!geometry.factor_world.in_range) {
        return geometry;
    }
    let world = geometry.factor_world.matrix;
    let rotation = camera_rotation();
    geometry.factor_view =
        Rows(row_times(rotation.x, world), row_times(rotation.y, world), row_times(rotation.z, world));
    let slopes = p.xy / p.z;
    geometry.slopes = min(max(slopes, view.slope_low), view.slope_high);
    geometry.is_free = (slopes >= view.slope_low) & (slopes <= view.slope_high);
    let magnification = view.focal / p.z;
    let along_z = geometry.factor_view.z;
    geometry.factor_x = magnification.x * (geometry.factor_view.x - geometry.slopes.x * along_z);
    geometry.factor_y = magnification.y * (geometry.factor_view.y - geometry.slopes.y * along_z);

    // (A, k, m): the covariance V·Vᵀ + εI is never formed, because its determinant would suffer from cancellation.
    let a = dot(geometry.factor_x, geometry.factor_x);
    let b = dot(geometry.factor_x, geometry.factor_y);
    let c = dot(geometry.factor_y, geometry.factor_y);
    let normal = cross(geometry.factor_x, geometry.factor_y);
    let m = 1.0 / (c + view.dilation);
    let conditional_variance = view.dilation + (dot(normal, normal) + view.dilation * a) * m;
    geometry.conic = vec3<f32>(1.0 / conditional_variance, -b * m, m);
    geometry.variances = vec2<f32>(a, c) + view.dilation;
    geometry.mean2d = view.focal * p.xy / p.z + view.center;

    let all_finite = is_finite3(geometry.conic) && is_finite3(vec3<f32>(geometry.mean2d, geometry.variances.x))
        && is_finite(geometry.variances.y);
    geometry.usable = all_finite && geometry.conic.x > 0.0 && geometry.conic.z > 0.0;
    return geometry;
}

// Whether the bounding box of σ ≤ cutoff overlaps the image, with a margin of half a pixel.
fn touches_image(geometry: Geometry, cutoff: f32) -> bool {
    let extent = sqrt(2.0 * cutoff * geometry.variances);
    return all(geometry.mean2d + extent >= vec2<f32>(0.0)) && all(geometry.mean2d - extent <= view.size);
}

// Real spherical harmonics in the order and with the signs of Kerbl et al. 2023.
fn harmonics(d: vec3<f32>) -> array<f32, 16> {
    var b: array<f32, 16>;
    b[0] = 0.28209479177387814;
    if (SH_DEGREE >= 1u) {
        b[1] = -0.4886025119029199 * d.y;
        b[2] = 0.4886025119029199 * d.z;
        b[3] = -0.4886025119029199 * d.x;
    }
    let s = d * d;
    if (SH_DEGREE >= 2u) {
        b[4] = 1.0925484305920792 * d.x * d.y;
        b[5] = -1.0925484305920792 * d.y * d.z;
        b[6] = 0.31539156525252005 * (2.0 * s.z - s.x - s.y);
        b[7] = -1.0925484305920792 * d.x * d.z;
        b[8] = 0.5462742152960396 * (s.x - s.y);
    }
    if (SH_DEGREE >= 3u) {
        b[9] = -0.5900435899266435 * d.y * (3.0 * s.x - s.y);
        b[10] = 2.890611442640554 * d.x * d.y * d.z;
        b[11] = -0.4570457994644658 * d.y * (4.0 * s.z - s.x - s.y);
        b[12] = 0.3731763325901154 * d.z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y);
        b[13] = -0.4570457994644658 * d.x * (4.0 * s.z - s.x - s.y);
        b[14] = 1.445305721320277 * d.z * (s.x - s.y);
        b[15] = -0.5900435899266435 * d.x * (s.x - 3.0 * s.y);
    }
    return b;
}

fn color_of(splat: u32) -> Color {
    var color: Color;
    let offset = position_of(splat) - view.position_world;
    let range = sqrt(dot(offset, offset));
    color.inverse_distance = 0.0;
    if (range >= MIN_DISTANCE) {
        color.inverse_distance = 1.0 / range;
    }
    color.direction = offset * color.inverse_distance;
    color.basis = harmonics(color.direction);
    color.unclamped = vec3<f32>(0.5);
    for (var k = 0u; k < COEFFICIENTS; k++) {
        color.unclamped += color.basis[k] * coefficient(splat, k);
    }
    return color;
}
