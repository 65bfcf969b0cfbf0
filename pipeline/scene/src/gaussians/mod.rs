//! 3D Gaussians in the parametrisation that splatting methods share.

mod ply_file;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// The spherical harmonic of degree 0: colour = `SH_C0` · coefficient + 0.5.
pub const SH_C0: f32 = 0.282_094_8;

/// N Gaussians in the parametrisation of Kerbl et al. 2023, before activation. Tensors are row-major.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gaussians {
    /// [N, 3] world positions in scene units.
    pub positions: Vec<f32>,
    /// [N, 3] natural logarithm of the standard deviations in scene units.
    pub log_scales: Vec<f32>,
    /// [N, 4] quaternions (w, x, y, z), not necessarily of unit length.
    pub rotations: Vec<f32>,
    /// N opacities before the logistic function.
    pub opacity_logits: Vec<f32>,
    /// [N, (sh_degree + 1)², 3] coefficients of spherical harmonics.
    pub sh: Vec<f32>,
    /// Degree of the spherical harmonics, 0 to 3.
    pub sh_degree: usize,
}

impl Gaussians {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// Whether there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.opacity_logits.is_empty()
    }

    /// Number of coefficients per colour channel.
    pub fn sh_count(&self) -> usize {
        (self.sh_degree + 1).pow(2)
    }

    /// Checks for consistent lengths and finite values.
    pub fn check(&self) -> Result<()> {
        let n = self.len();
        let tensors = [
            ("positions", &self.positions, 3 * n),
            ("log_scales", &self.log_scales, 3 * n),
            ("rotations", &self.rotations, 4 * n),
            ("opacity_logits", &self.opacity_logits, n),
            ("sh", &self.sh, 3 * self.sh_count() * n),
        ];
        for (name, values, expected) in tensors {
            if values.len() != expected {
                return Err(Error::new(format!("{n} Gaussians with {} {name} instead of {expected}", values.len())));
            }
            if let Some(at) = values.iter().position(|value| !value.is_finite()) {
                return Err(Error::new(format!("{name}[{at}] of the Gaussians is {}", values[at])));
            }
        }
        Ok(())
    }
}
