//! Lens distortion: the Brown–Conrady and fisheye models of OpenCV, COLMAP, instant-ngp and nerfstudio.

use std::fmt;

use glam::DVec2;

/// Step of the numeric derivative on the plane z = 1: the cube root of the rounding of f64, where the error is smallest.
const STEP: f64 = 6e-6;
/// Squared radius on the plane z = 1, and angle in radians, below which ratios are replaced by their limits.
const TINY: f64 = 1e-16;

/// How a lens bends rays: maps a point of the plane z = 1 to a point on the sensor, in units of the focal length.
///
/// With q the projection of the point, r = |q| and
/// d = (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) / (1 + m1 r² + m2 r⁴ + m3 r⁶):
/// x' = q.x d + 2 p1 q.x q.y + p2 (r² + 2 q.x²) + s1 r², y' = q.y d + p1 (r² + 2 q.y²) + 2 p2 q.x q.y + s2 r²
/// (Brown 1966; Kannala & Brandt 2006; Weng et al. 1992 for the denominator and the thin prism). All camera models of
/// COLMAP up to number 10 are special cases.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Distortion {
    projection: Projection,
    /// k1 to k4.
    radial: [f64; 4],
    /// m1 to m3; called k4 to k6 in OpenCV.
    denominator: [f64; 3],
    /// p1 and p2.
    tangential: [f64; 2],
    /// s1 and s2; called sx1 and sy1 in COLMAP.
    prism: [f64; 2],
}

/// How the angle θ of a ray to the optical axis becomes the radius that the polynomials act on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Projection {
    /// tan θ.
    #[default]
    Perspective,
    /// θ.
    Equidistant,
    /// atan(2 tan θ tan(ω/2)) / ω (Devernay & Faugeras 2001).
    FieldOfView {
        /// ω in radians.
        omega: f64,
    },
}

impl Projection {
    fn apply(self, point: DVec2) -> DVec2 {
        let radius = point.length();
        match self {
            Self::Perspective => point,
            _ if radius * radius < TINY => point * self.slope_at_axis(),
            Self::Equidistant => point * (radius.atan() / radius),
            Self::FieldOfView { omega } => point * ((2.0 * radius * (0.5 * omega).tan()).atan() / (radius * omega)),
        }
    }

    /// The limit of the radius over tan θ at the optical axis.
    fn slope_at_axis(self) -> f64 {
        match self {
            Self::Perspective | Self::Equidistant => 1.0,
            Self::FieldOfView { omega } => 2.0 * (0.5 * omega).tan() / omega,
        }
    }
}

impl fmt::Display for Distortion {
    /// The coefficients that are not zero.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.projection {
            Projection::Perspective => write!(out, "perspective")?,
            Projection::Equidistant => write!(out, "fisheye")?,
            Projection::FieldOfView { omega } => write!(out, "omega {omega}")?,
        }
        let groups: [(&str, &[f64]); 4] = [
            ("radial", &self.radial),
            ("denominator", &self.denominator),
            ("tangential", &self.tangential),
            ("prism", &self.prism),
        ];
        let mut used = groups.iter().filter(|(_, values)| values.iter().any(|value| *value != 0.0));
        used.try_for_each(|(name, values)| write!(out, ", {name} {values:?}"))
    }
}

impl Distortion {
    /// Radial coefficients of r², r⁴, r⁶, r⁸ and the tangential ones: `OPENCV` (two radial coefficients), OpenCV's five
    /// coefficients, and nerfstudio's six.
    pub(crate) fn brown(radial: [f64; 4], tangential: [f64; 2]) -> Self {
        Self { radial, tangential, ..Self::default() }
    }

    /// COLMAP's `FULL_OPENCV`: OpenCV's k1 to k3 in the numerator, k4 to k6 in the denominator, and the tangential
    /// coefficients.
    pub(crate) fn rational([k1, k2, k3]: [f64; 3], denominator: [f64; 3], tangential: [f64; 2]) -> Self {
        Self { denominator, ..Self::brown([k1, k2, k3, 0.0], tangential) }
    }

    /// `OPENCV_FISHEYE`: coefficients of θ², θ⁴, θ⁶, θ⁸.
    pub(crate) fn fisheye(radial: [f64; 4]) -> Self {
        Self { projection: Projection::Equidistant, radial, ..Self::default() }
    }

    /// COLMAP's `THIN_PRISM_FISHEYE`: a fisheye with tangential and prism coefficients.
    pub(crate) fn thin_prism_fisheye(radial: [f64; 4], tangential: [f64; 2], prism: [f64; 2]) -> Self {
        Self { tangential, prism, ..Self::fisheye(radial) }
    }

    /// COLMAP's `FOV` with ω in radians; ω = 0 is a pinhole.
    pub(crate) fn field_of_view(omega: f64) -> Self {
        let bends = !(omega.abs() <= TINY);
        let projection = if bends { Projection::FieldOfView { omega } } else { Projection::Perspective };
        Self { projection, ..Self::default() }
    }

    /// Whether the lens is a pinhole.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Distorts a point of the plane z = 1.
    pub(crate) fn apply(&self, point: DVec2) -> DVec2 {
        let q = self.projection.apply(point);
        let ([k1, k2, k3, k4], [m1, m2, m3]) = (self.radial, self.denominator);
        let ([p1, p2], (r2, xy)) = (self.tangential, (q.length_squared(), q.x * q.y));
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        let denominator = 1.0 + r2 * (m1 + r2 * (m2 + r2 * m3));
        let tangential =
            DVec2::new(2.0 * p1 * xy + p2 * (r2 + 2.0 * q.x * q.x), p1 * (r2 + 2.0 * q.y * q.y) + 2.0 * p2 * xy);
        q * (radial / denominator) + tangential + r2 * DVec2::from(self.prism)
    }

    /// Whether neighbouring rays stay in order at this point of the plane z = 1: the Jacobian determinant is positive.
    pub(crate) fn is_regular_at(&self, point: DVec2) -> bool {
        let difference = |step: DVec2| self.apply(point + step) - self.apply(point - step);
        difference(DVec2::X * STEP).perp_dot(difference(DVec2::Y * STEP)) > 0.0
    }
}
