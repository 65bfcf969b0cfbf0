use super::isa::Isa;

/// Settings that are common to all splats of a render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RasterSettings {
    /// Splats with a view depth below this are culled, in scene units; positive. Kerbl et al. 2023 use 0.2.
    pub near_view: f64,
    /// Splats with a view depth of this or more are culled, in scene units.
    pub far_view: f64,
    /// Added to both variances of the projected covariance, in px²: the low-pass filter of Zwicker et al. 2002.
    pub dilation: f64,
    /// Upper bound of a splat's alpha.
    pub alpha_cap: f64,
    /// A splat that would leave at most this transmittance is not blended, nor is any splat behind it.
    pub transmittance_stop: f64,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Degree of the spherical harmonics in use, 0 to 3; at most what the coefficients allow.
    pub sh_degree: usize,
    /// Also render Σ wᵢ zᵢ. Costs one more channel.
    pub depth: bool,
    /// Finite-difference checks only: alpha fades to zero between 1½ and ½ of the threshold instead of jumping there.
    pub smooth_cutoff: bool,
    /// The vector instructions of the fast body; every choice gives the same bits.
    pub isa: Isa,
}

impl Default for RasterSettings {
    fn default() -> Self {
        Self {
            near_view: 0.01,
            far_view: 1e10,
            dilation: 0.3,
            alpha_cap: 0.99,
            transmittance_stop: 1e-4,
            background: [0.0; 3],
            sh_degree: 3,
            depth: false,
            smooth_cutoff: false,
            isa: Isa::best(),
        }
    }
}

impl RasterSettings {
    /// Alphas below this are not blended (Kerbl et al. 2023): one level of an 8-bit image.
    pub(crate) const ALPHA_THRESHOLD: f64 = 1.0 / 255.0;

    /// The least alpha that has any effect: the bottom of the smooth band if there is one.
    pub(crate) fn alpha_min(&self) -> f64 {
        if self.smooth_cutoff { 0.5 * Self::ALPHA_THRESHOLD } else { Self::ALPHA_THRESHOLD }
    }
}
