//! One splat through one camera, forward and backward, for f32 and f64.

use super::harmonics::{self, MAX_COEFFICIENTS};
use super::shape::{Factor, Shape};
use super::{CLAMP_MARGIN, Culled};
use crate::geometry::algebra::{Mat3, Vec3, apply, combine, cross, dot, product, transposed};
use crate::geometry::camera::PinholeCamera;
use crate::rasteriser::settings::RasterSettings;
use crate::rasteriser::splats::HIDDEN_LOGIT;
use crate::tape::Real;

/// Below this distance between splat and camera centre, in scene units, the viewing direction is undefined.
const MIN_DISTANCE: f64 = 1e-8;

/// Camera and settings, rounded once to the scalar type.
pub(super) struct View<T> {
    pub rotation: Mat3<T>,
    pub translation: Vec3<T>,
    pub position_world: Vec3<T>,
    pub focal: [T; 2],
    pub center: [T; 2],
    pub size: [T; 2],
    /// Range of x/z and y/z within which the affine map follows the splat.
    pub(crate) slope_range: [(T, T); 2],
    pub near: T,
    pub far: T,
    pub dilation: T,
    pub(crate) alpha_min: T,
    pub sh_degree: usize,
}

impl<T: Real> View<T> {
    pub(super) fn new(camera: &PinholeCamera, settings: &RasterSettings) -> Self {
        let f = T::from_f64;
        let size = [camera.width as f64, camera.height as f64];
        let slope_range = |axis: usize| {
            let (size, focal, center) = (size[axis], camera.focal[axis], camera.center[axis]);
            (f(-(CLAMP_MARGIN * size + center) / focal), f(((1.0 + CLAMP_MARGIN) * size - center) / focal))
        };
        Self {
            rotation: camera.rotation.map(|row| row.map(f)),
            translation: camera.translation.map(f),
            position_world: camera.position_world().map(f),
            focal: camera.focal.map(f),
            center: camera.center.map(f),
            size: size.map(f),
            slope_range: [slope_range(0), slope_range(1)],
            near: f(settings.near_view),
            far: f(settings.far_view),
            dilation: f(settings.dilation),
            alpha_min: f(settings.alpha_min()),
            sh_degree: settings.sh_degree,
        }
    }
}

/// The parameters of one splat.
#[derive(Clone, Copy)]
pub(crate) struct Splat<'a, T> {
    pub position: Vec3<T>,
    pub shape: Shape<T>,
    pub(crate) opacity_logit: T,
    /// [K, 3].
    pub sh: &'a [T],
}

/// One splat in the image; also the gradient of one (without its cutoff).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Projected<T> {
    pub(crate) mean2d: [T; 2],
    pub conic: [T; 3],
    pub depth: T,
    pub opacity: T,
    pub color: [T; 3],
    /// The largest σ that is blended: ln(opacity / least alpha).
    pub cutoff: T,
}

/// The gradient of a [`Splat`]; that of the harmonics is written in place.
pub(crate) struct SplatGradient<T> {
    pub position: Vec3<T>,
    pub shape: Shape<T>,
    pub(crate) opacity_logit: T,
}

/// The image of a splat, or `None` if it is culled: not between the near and far planes, too faint, outside the image, or
/// not finite. Comparisons are phrased so that NaN culls.
pub(super) fn project<T: Real>(splat: &Splat<T>, view: &View<T>) -> Option<Projected<T>> {
    let geometry = Geometry::new(splat, view)?;
    let opacity = sigmoid(splat.opacity_logit);
    let cutoff = (opacity / view.alpha_min).ln();
    if !(cutoff >= T::ZERO) || !geometry.touches_image(cutoff, view) {
        return None;
    }
    let color = Color::new(splat, view);
    let is_finite = color.unclamped.iter().all(|value| value.is_finite()) && splat.shape.is_finite();
    is_finite.then_some(Projected {
        mean2d: geometry.mean2d,
        conic: geometry.conic,
        depth: geometry.view_position[2],
        opacity,
        color: color.unclamped.map(|value| value.max(T::ZERO)),
        cutoff,
    })
}

/// Why [`project`] culled a splat.
pub(crate) fn why_culled<T: Real>(splat: &Splat<T>, view: &View<T>) -> Culled {
    let coefficients = &splat.sh[..3 * harmonics::coefficient_count(view.sh_degree)];
    let values = splat.position.iter().chain([&splat.opacity_logit]).chain(coefficients);
    let log_scales = match &splat.shape {
        Shape::ScaleRotation { log_scales, .. } => log_scales.as_slice(),
        Shape::Factor(_) => &[],
    };
    // Minus infinity is a scale of zero.
    let scales_are_numbers = log_scales.iter().all(|value| *value < T::from_f64(f64::INFINITY));
    if !(values.into_iter().all(|value| value.is_finite()) && splat.shape.is_finite() && scales_are_numbers) {
        return Culled::NotFinite;
    }
    // A hidden splat is culled at any position.
    if splat.opacity_logit <= T::from_f64(HIDDEN_LOGIT) {
        return Culled::Unseen;
    }
    let position_view = combine(T::ONE, apply(&view.rotation, splat.position), T::ONE, view.translation);
    if position_view[2] < view.near {
        return Culled::Near;
    }
    let in_range = position_view[2] < view.far;
    if in_range && Geometry::new(splat, view).is_none() { Culled::Huge } else { Culled::Unseen }
}

/// The gradient of a splat that [`project`] did not cull; `sh_gradient` [K, 3] holds zeros on entry.
pub(super) fn backward<T: Real>(
    splat: &Splat<T>,
    view: &View<T>,
    upstream: &Projected<T>,
    sh_gradient: &mut [T],
) -> Option<SplatGradient<T>> {
    let geometry = Geometry::new(splat, view)?;
    let mut gradient = geometry.backward(view, upstream);
    let from_color = Color::new(splat, view).backward(splat, view, upstream.color, sh_gradient);
    gradient.position = combine(T::ONE, gradient.position, T::ONE, from_color);
    gradient.opacity_logit = upstream.opacity * sigmoid(splat.opacity_logit) * sigmoid(-splat.opacity_logit);
    Some(gradient)
}

/// 1 / (1 + e⁻ˣ) without overflow; σ(x)·σ(−x) is its derivative without cancellation.
#[inline(always)]
fn sigmoid<T: Real>(x: T) -> T {
    let e = (-x.abs()).exp();
    let tail = e / (T::ONE + e);
    if x >= T::ZERO { T::ONE / (T::ONE + e) } else { tail }
}

/// Position and shape in the image, with the intermediates of the backward pass.
struct Geometry<T> {
    view_position: Vec3<T>,
    /// x/z and y/z, clamped, and whether they were not.
    slopes: [(T, bool); 2],
    factor_world: Factor<T>,
    /// camera_from_world · factor_world.
    factor_view: Mat3<T>,
    /// J · factor_view: the 2×3 factor of the covariance in px.
    factor: [Vec3<T>; 2],
    variances: [T; 2],
    mean2d: [T; 2],
    conic: [T; 3],
}

impl<T: Real> Geometry<T> {
    #[inline(always)]
    fn new(splat: &Splat<T>, view: &View<T>) -> Option<Self> {
        let view_position = combine(T::ONE, apply(&view.rotation, splat.position), T::ONE, view.translation);
        let [x, y, z] = view_position;
        let in_range = z >= view.near && z < view.far;
        if !in_range {
            return None;
        }
        let factor_world = Factor::new(&splat.shape)?;
        let factor_view = product(&view.rotation, &factor_world.matrix);
        let slopes = [clamp(x / z, view.slope_range[0]), clamp(y / z, view.slope_range[1])];
        let row = |axis: usize| {
            let magnification = view.focal[axis] / z;
            combine(magnification, factor_view[axis], -magnification * slopes[axis].0, factor_view[2])
        };
        let factor = [row(0), row(1)];
        let (conic, variances) = cholesky(&factor, view.dilation);
        let mean2d = [0, 1].map(|axis| view.focal[axis] * view_position[axis] / z + view.center[axis]);

        let is_finite = conic.iter().chain(&mean2d).chain(&variances).all(|value| value.is_finite());
        let usable = is_finite && conic[0] > T::ZERO && conic[2] > T::ZERO;
        usable.then_some(Self { view_position, slopes, factor_world, factor_view, factor, variances, mean2d, conic })
    }

    /// Whether the bounding box of σ ≤ cutoff overlaps the image; with half a pixel of slack, because no pixel centre lies on the
    /// border.
    fn touches_image(&self, cutoff: T, view: &View<T>) -> bool {
        (0..2).all(|axis| {
            let extent = (T::from_f64(2.0) * cutoff * self.variances[axis]).sqrt();
            self.mean2d[axis] + extent >= T::ZERO && self.mean2d[axis] - extent <= view.size[axis]
        })
    }

    #[inline(always)]
    fn backward(&self, view: &View<T>, upstream: &Projected<T>) -> SplatGradient<T> {
        let two = T::from_f64(2.0);
        let [x, y, z] = self.view_position;
        let [magnification_x, magnification_y] = view.focal.map(|focal| focal / z);
        let [(slope_x, x_is_free), (slope_y, y_is_free)] = self.slopes;

        // The covariance (a, b, c) and its factor V: a = |V₁|², b = V₁·V₂, c = |V₂|².
        let [g_a, g_b, g_c] = cholesky_backward(self.conic, upstream.conic);
        let g_row_x = combine(two * g_a, self.factor[0], g_b, self.factor[1]);
        let g_row_y = combine(g_b, self.factor[0], two * g_c, self.factor[1]);

        // V = J·M with J = [f/z, 0, −f·slope/z] per row.
        let (g_j00, g_j02) = (dot(g_row_x, self.factor_view[0]), dot(g_row_x, self.factor_view[2]));
        let (g_j11, g_j12) = (dot(g_row_y, self.factor_view[1]), dot(g_row_y, self.factor_view[2]));
        let g_factor_view = [
            g_row_x.map(|value| value * magnification_x),
            g_row_y.map(|value| value * magnification_y),
            combine(-magnification_x * slope_x, g_row_x, -magnification_y * slope_y, g_row_y),
        ];

        // The position in view space, through the mean, J and the depth.
        let [g_u, g_v] = upstream.mean2d;
        let mut g_view = [magnification_x * g_u, magnification_y * g_v, upstream.depth];
        g_view[2] += (-x * magnification_x * g_u - y * magnification_y * g_v) / z;
        g_view[2] += magnification_x / z * (slope_x * g_j02 - g_j00) + magnification_y / z * (slope_y * g_j12 - g_j11);
        for (axis, is_free, g_slope) in
            [(0, x_is_free, -magnification_x * g_j02), (1, y_is_free, -magnification_y * g_j12)]
        {
            if is_free {
                g_view[axis] += g_slope / z;
                g_view[2] += -g_slope * self.slopes[axis].0 / z;
            }
        }

        let world_from_view = transposed(&view.rotation);
        SplatGradient {
            position: apply(&world_from_view, g_view),
            shape: self.factor_world.backward(&product(&world_from_view, &g_factor_view)),
            opacity_logit: T::ZERO,
        }
    }
}

#[inline(always)]
fn clamp<T: Real>(value: T, (low, high): (T, T)) -> (T, bool) {
    (value.max(low).min(high), value >= low && value <= high)
}

/// The form (A, k, m) of σ = ½(A(dx + k·dy)² + m·dy²) and the variances in x and y, both with dilation ε.
///
/// The covariance VVᵀ + εI is never formed: det VVᵀ = |V₁×V₂|² (Lagrange) makes 1/A = ε + (|V₁×V₂|² + εa)/(c + ε) a sum
/// of non-negative terms.
#[inline(always)]
fn cholesky<T: Real>(factor: &[Vec3<T>; 2], dilation: T) -> ([T; 3], [T; 2]) {
    let [row_x, row_y] = *factor;
    let (a, b, c) = (dot(row_x, row_x), dot(row_x, row_y), dot(row_y, row_y));
    let normal = cross(row_x, row_y);
    let m = T::ONE / (c + dilation);
    let conditional_variance = dilation + (dot(normal, normal) + dilation * a) * m;
    ([T::ONE / conditional_variance, -b * m, m], [a + dilation, c + dilation])
}

/// From (A, k, m) to the covariance's (a, b, c): A = 1/(a − b²/c), k = −b/c, m = 1/c.
#[inline(always)]
fn cholesky_backward<T: Real>([a, k, m]: [T; 3], [g_a, g_k, g_m]: [T; 3]) -> [T; 3] {
    let two = T::from_f64(2.0);
    let g_variance = -a * a * g_a;
    [g_variance, two * k * g_variance - m * g_k, k * k * g_variance - k * m * g_k - m * m * g_m]
}

/// The colour towards the camera before clamping at 0, with the intermediates of the backward pass.
struct Color<T> {
    direction: Vec3<T>,
    /// 1/distance; zero where the direction is undefined.
    inverse_distance: T,
    basis: [T; MAX_COEFFICIENTS],
    unclamped: [T; 3],
}

impl<T: Real> Color<T> {
    #[inline(always)]
    fn new(splat: &Splat<T>, view: &View<T>) -> Self {
        let offset = combine(T::ONE, splat.position, -T::ONE, view.position_world);
        let distance = dot(offset, offset).sqrt();
        let inverse_distance = if distance >= T::from_f64(MIN_DISTANCE) { T::ONE / distance } else { T::ZERO };
        let direction = offset.map(|value| value * inverse_distance);
        let basis = harmonics::basis(view.sh_degree, direction);
        let mut unclamped = [T::from_f64(0.5); 3];
        for (&value, coefficients) in
            basis[..harmonics::coefficient_count(view.sh_degree)].iter().zip(splat.sh.as_chunks::<3>().0)
        {
            unclamped = combine(T::ONE, unclamped, value, *coefficients);
        }
        Self { direction, inverse_distance, basis, unclamped }
    }

    /// Writes the gradient of the harmonics and returns that of the position; zero where the colour was clamped.
    #[inline(always)]
    fn backward(&self, splat: &Splat<T>, view: &View<T>, upstream: [T; 3], sh_gradient: &mut [T]) -> Vec3<T> {
        let g_color = [0, 1, 2].map(|c| if self.unclamped[c] > T::ZERO { upstream[c] } else { T::ZERO });
        let count = harmonics::coefficient_count(view.sh_degree);
        let mut g_basis = [T::ZERO; MAX_COEFFICIENTS];
        let coefficients = splat.sh.as_chunks::<3>().0.iter().zip(sh_gradient.as_chunks_mut::<3>().0);
        for (k, (coefficients, gradient)) in coefficients.take(count).enumerate() {
            *gradient = g_color.map(|value| self.basis[k] * value);
            g_basis[k] = dot(*coefficients, g_color);
        }
        let g_direction = harmonics::basis_backward(view.sh_degree, self.direction, &g_basis);
        let radial = dot(g_direction, self.direction);
        combine(self.inverse_distance, g_direction, -radial * self.inverse_distance, self.direction)
    }
}
