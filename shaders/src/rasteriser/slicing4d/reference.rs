//! One 4D Gaussian at one instant, forward and backward, for f32 and f64.

use super::algebra::{Mat4, Vec4, direction_backward, left, left_backward, product, right, right_backward, transposed};
use crate::geometry::algebra::{Mat3, Vec3, combine4, dot4, normalised, normalised_backward};
use crate::tape::Real;

/// The least standard deviation in time, in units of time: a ten thousandth of a clip whose time is 0 to 1, below which
/// velocities and shares are rounding noise.
const MIN_DEVIATION_TIME: f64 = 1e-4;
/// The square of a length that has no direction any more in f32.
const MIN_SQUARED_LENGTH: f64 = 1e-30;
/// Keeps the logarithm of 1 − opacity finite; such opacities are indistinguishable in an image.
const MIN_TRANSPARENCY: f64 = 1e-30;

/// The parameters of one Gaussian; also the gradient of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gaussian<T> {
    /// Logarithms of the standard deviations along x, y, z, t before rotation.
    pub log_scales: Vec4<T>,
    /// (w, x, y, z).
    pub(crate) rotation_left: [T; 4],
    pub(crate) rotation_right: [T; 4],
    /// t − μₜ.
    pub(crate) offset_time: T,
    pub(crate) opacity_logit: T,
}

/// One Gaussian at an instant; also the gradient of it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sliced<T> {
    pub displacement: Vec3<T>,
    pub velocity: Vec3<T>,
    pub factor: Mat3<T>,
    pub(crate) opacity_logit: T,
}

/// The Gaussian at the instant.
pub(super) fn slice<T: Real>(gaussian: &Gaussian<T>) -> Sliced<T> {
    let Cut { velocity, factor, .. } = Cut::new(gaussian);
    Sliced {
        displacement: velocity.map(|value| value * gaussian.offset_time),
        velocity,
        factor,
        opacity_logit: Faded::new(gaussian.opacity_logit, gaussian.log_share()).logit,
    }
}

/// The gradient of the Gaussian's parameters.
pub(super) fn backward<T: Real>(gaussian: &Gaussian<T>, upstream: &Sliced<T>) -> Gaussian<T> {
    let cut = Cut::new(gaussian);
    let offset = gaussian.offset_time;
    let faded = Faded::new(gaussian.opacity_logit, gaussian.log_share());
    let g_log_share = upstream.opacity_logit * faded.by_log_share;

    // displacement = Δt·velocity, log share = −½Δt²/σ².
    let g_velocity = [0, 1, 2].map(|axis| upstream.velocity[axis] + offset * upstream.displacement[axis]);
    let moved: T = (0..3).map(|axis| cut.velocity[axis] * upstream.displacement[axis]).sum();
    let inverse = T::ONE / cut.time_row.deviation;
    let g_offset = moved - g_log_share * offset * inverse * inverse;
    let g_deviation = g_log_share * offset * offset * inverse * inverse * inverse;

    let g_lengths = cut.backward(g_velocity, &upstream.factor, g_deviation);
    let (log_scales, rotation_left, rotation_right) = cut.axes.backward(&g_lengths);
    Gaussian {
        log_scales,
        rotation_left,
        rotation_right,
        offset_time: g_offset,
        opacity_logit: upstream.opacity_logit * faded.by_logit,
    }
}

impl<T: Real> Gaussian<T> {
    /// The logarithm of the share of the opacity at the instant.
    #[inline(always)]
    pub(crate) fn log_share(&self) -> T {
        let (unit_left, _) = normalised(self.rotation_left);
        let (unit_right, _) = normalised(self.rotation_right);
        let columns = transposed(&right(unit_right));
        let scales = self.log_scales.map(T::exp);
        let turned = columns.map(|column| dot4(left(unit_left)[3], column));
        let row = TimeRow::new([0, 1, 2, 3].map(|axis| turned[axis] * scales[axis]));
        let offset = self.offset_time / row.deviation;
        -T::from_f64(0.5) * offset * offset
    }
}

/// L = R·diag(eˢ), with the intermediates of its backward pass.
struct Axes<T> {
    scales: Vec4<T>,
    /// Unit quaternions and the inverse of their lengths.
    left: ([T; 4], T),
    right: ([T; 4], T),
    lengths: Mat4<T>,
}

impl<T: Real> Axes<T> {
    #[inline(always)]
    fn new(gaussian: &Gaussian<T>) -> Self {
        let scales = gaussian.log_scales.map(T::exp);
        let unit = [gaussian.rotation_left, gaussian.rotation_right].map(normalised);
        let rotation = product(&left(unit[0].0), &right(unit[1].0));
        let lengths = rotation.map(|row| [0, 1, 2, 3].map(|axis| row[axis] * scales[axis]));
        Self { scales, left: unit[0], right: unit[1], lengths }
    }

    /// The gradients of the logarithms of the scales and of both quaternions.
    #[inline(always)]
    fn backward(&self, g_lengths: &Mat4<T>) -> (Vec4<T>, [T; 4], [T; 4]) {
        let along = |axis: usize| -> T { (0..4).map(|row| self.lengths[row][axis] * g_lengths[row][axis]).sum() };
        let g_rotation = g_lengths.map(|row| [0, 1, 2, 3].map(|axis| row[axis] * self.scales[axis]));
        let g_left = left_backward(&product(&g_rotation, &transposed(&right(self.right.0))));
        let g_right = right_backward(&product(&transposed(&left(self.left.0)), &g_rotation));
        (
            [0, 1, 2, 3].map(along),
            normalised_backward(self.left.0, self.left.1, g_left),
            normalised_backward(self.right.0, self.right.1, g_right),
        )
    }
}

/// The last row of L: its length is the standard deviation in time, its direction the normal of the slice.
struct TimeRow<T> {
    direction: Vec4<T>,
    /// 1/length; zero for a row without direction.
    inverse_length: T,
    deviation: T,
    is_clamped: bool,
}

impl<T: Real> TimeRow<T> {
    #[inline(always)]
    fn new(row: Vec4<T>) -> Self {
        let squared = dot4(row, row);
        let least = T::from_f64(MIN_DEVIATION_TIME);
        if squared < T::from_f64(MIN_SQUARED_LENGTH) {
            let direction = [T::ZERO, T::ZERO, T::ZERO, T::ONE];
            return Self { direction, inverse_length: T::ZERO, deviation: least, is_clamped: true };
        }
        let length = squared.sqrt();
        let inverse_length = T::ONE / length;
        let direction = row.map(|value| value * inverse_length);
        Self { direction, inverse_length, deviation: length.max(least), is_clamped: length < least }
    }
}

/// The Gaussian's shape and velocity at the instant, with the intermediates of the backward pass.
struct Cut<T> {
    axes: Axes<T>,
    time_row: TimeRow<T>,
    /// The unit normal û of the reflection H = I − 2ûûᵀ, and the inverse of its length before normalisation.
    normal: Vec4<T>,
    inverse_normal_length: T,
    velocity: Vec3<T>,
    factor: Mat3<T>,
}

impl<T: Real> Cut<T> {
    #[inline(always)]
    fn new(gaussian: &Gaussian<T>) -> Self {
        let axes = Axes::new(gaussian);
        let time_row = TimeRow::new(axes.lengths[3]);

        // The time row goes to ∓ the last axis, whichever is farther: the normal is never short.
        let mut normal = time_row.direction;
        normal[3] += if normal[3] >= T::ZERO { T::ONE } else { -T::ONE };
        let inverse_normal_length = T::ONE / dot4(normal, normal).sqrt();
        let normal = normal.map(|value| value * inverse_normal_length);

        let velocity = [0, 1, 2].map(|axis| dot4(axes.lengths[axis], time_row.direction) / time_row.deviation);
        let factor = [0, 1, 2].map(|axis| {
            let [x, y, z, _] = reflected(axes.lengths[axis], normal);
            [x, y, z]
        });
        Self { axes, time_row, normal, inverse_normal_length, velocity, factor }
    }

    /// The gradient of L.
    #[inline(always)]
    fn backward(&self, g_velocity: Vec3<T>, g_factor: &Mat3<T>, g_deviation: T) -> Mat4<T> {
        let TimeRow { direction, inverse_length, deviation, is_clamped } = self.time_row;
        let two = T::from_f64(2.0);
        let mut g_lengths = [[T::ZERO; 4]; 4];
        let mut g_direction = [T::ZERO; 4];
        let mut g_normal = [T::ZERO; 4];
        let mut g_deviation = g_deviation;
        for axis in 0..3 {
            let row = self.axes.lengths[axis];
            // velocity = row·direction/σ.
            let g = g_velocity[axis] / deviation;
            g_deviation += -g * self.velocity[axis];
            g_direction = combine4(T::ONE, g_direction, g, row);

            // factor = row − 2(row·û)û without its last column.
            let [x, y, z] = g_factor[axis];
            let g_reflected = [x, y, z, T::ZERO];
            g_normal = combine4(T::ONE, g_normal, -two * dot4(g_reflected, self.normal), row);
            g_normal = combine4(T::ONE, g_normal, -two * dot4(row, self.normal), g_reflected);
            g_lengths[axis] = combine4(T::ONE, reflected(g_reflected, self.normal), g, direction);
        }
        let g_unnormalised = direction_backward(self.normal, self.inverse_normal_length, g_normal);
        g_direction = combine4(T::ONE, g_direction, T::ONE, g_unnormalised);
        let along = if is_clamped { T::ZERO } else { g_deviation };
        g_lengths[3] = combine4(T::ONE, direction_backward(direction, inverse_length, g_direction), along, direction);
        g_lengths
    }
}

/// v·(I − 2ûûᵀ).
#[inline(always)]
fn reflected<T: Real>(v: Vec4<T>, normal: Vec4<T>) -> Vec4<T> {
    combine4(T::ONE, v, -T::from_f64(2.0) * dot4(v, normal), normal)
}

/// The logit of an opacity times a share w, and its derivatives by the opacity's logit x and by ln w.
///
/// σ(x)·w = σ(ln w − ln(e⁻ˣ + 1 − w)); for negative x with eˣ taken out of the logarithm, so that nothing overflows.
struct Faded<T> {
    logit: T,
    by_logit: T,
    by_log_share: T,
}

impl<T: Real> Faded<T> {
    #[inline(always)]
    fn new(logit: T, log_share: T) -> Self {
        let share = log_share.exp();
        let rest = T::ONE - share;
        if logit >= T::ZERO {
            let e = (-logit).exp();
            let sum = (e + rest).max(T::from_f64(MIN_TRANSPARENCY));
            Self { logit: log_share - sum.ln(), by_logit: e / sum, by_log_share: T::ONE + share / sum }
        } else {
            let e = logit.exp();
            let sum = T::ONE + e * rest;
            Self { logit: log_share + logit - sum.ln(), by_logit: T::ONE / sum, by_log_share: T::ONE + e * share / sum }
        }
    }
}
