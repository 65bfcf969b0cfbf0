//! PLY files of Gaussians with the property names of Kerbl et al. 2023, which common viewers support.

use std::path::Path;

use super::Gaussians;
use crate::ply::{Ply, PlyFormat, Property, write_ply};
use crate::{Error, Result};

/// Highest degree of spherical harmonics in use.
const MAX_SH_DEGREE: usize = 3;

impl Gaussians {
    /// Writes the parameters before activation as f32: x, y, z, nx, ny, nz (zero), f_dc_*, f_rest_* (channel-major),
    /// opacity, scale_* and rot_*. [`Gaussians::read_ply`] returns them bit by bit.
    pub fn write_ply(&self, path: &Path) -> Result<()> {
        self.check().map_err(|error| error.at(path))?;
        let properties: Vec<_> = property_names(self.sh_count()).into_iter().map(Property::float).collect();
        let rows = (0..self.len()).flat_map(|index| self.row(index));
        write_ply(path, PlyFormat::BinaryLittleEndian, &properties, self.len(), rows)
    }

    /// Reads a file of [`Gaussians::write_ply`] or of another 3DGS implementation; other properties are skipped.
    pub fn read_ply(path: &Path) -> Result<Self> {
        let ply = Ply::open(path)?;
        let rest_count = (0..).take_while(|index| ply.property(&format!("f_rest_{index}")).is_some()).count();
        let degree = (0..=MAX_SH_DEGREE).find(|degree| 3 * ((degree + 1).pow(2) - 1) == rest_count);
        let sh_degree = degree.ok_or_else(|| {
            let message = format!(
                "{rest_count} properties f_rest_* match no degree of spherical harmonics up to {MAX_SH_DEGREE}"
            );
            Error::new(message).at(path)
        })?;
        let mut gaussians = Self { sh_degree, ..Self::default() };
        let names = property_names(gaussians.sh_count());
        let wanted: Vec<_> = names.iter().map(String::as_str).filter(|name| !name.starts_with('n')).collect();
        for row in ply.vertices(&wanted)?.chunks_exact(wanted.len()) {
            gaussians.push_row(row);
        }
        gaussians.check().map_err(|error| error.at(path))?;
        Ok(gaussians)
    }

    /// The values of one vertex, in the order of [`property_names`].
    fn row(&self, index: usize) -> Vec<f32> {
        let count = self.sh_count();
        let sh = &self.sh[index * 3 * count..][..3 * count];
        let mut row = self.positions[3 * index..][..3].to_vec();
        row.extend([0.0; 3]);
        row.extend_from_slice(&sh[..3]);
        row.extend((0..3).flat_map(|channel| (1..count).map(move |coefficient| sh[3 * coefficient + channel])));
        row.push(self.opacity_logits[index]);
        row.extend_from_slice(&self.log_scales[3 * index..][..3]);
        row.extend_from_slice(&self.rotations[4 * index..][..4]);
        row
    }

    /// Appends a Gaussian from the values of one vertex without normals; the inverse of [`Gaussians::row`].
    fn push_row(&mut self, row: &[f32]) {
        let count = self.sh_count();
        let (position, row) = row.split_at(3);
        let (sh, row) = row.split_at(3 * count);
        let (constant, rest) = sh.split_at(3);
        self.positions.extend_from_slice(position);
        self.sh.extend_from_slice(constant);
        let at = |coefficient: usize, channel: usize| rest[channel * (count - 1) + coefficient - 1];
        self.sh.extend((1..count).flat_map(|coefficient| (0..3).map(move |channel| at(coefficient, channel))));
        self.opacity_logits.push(row[0]);
        self.log_scales.extend_from_slice(&row[1..4]);
        self.rotations.extend_from_slice(&row[4..8]);
    }
}

/// Names of the vertex properties for `sh_count` coefficients per channel, in the order of the reference
/// implementation.
fn property_names(sh_count: usize) -> Vec<String> {
    let numbered = |name: &'static str, count: usize| (0..count).map(move |index| format!("{name}_{index}"));
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(String::from).to_vec();
    names.extend(numbered("f_dc", 3));
    names.extend(numbered("f_rest", 3 * (sh_count - 1)));
    names.push("opacity".into());
    names.extend(numbered("scale", 3));
    names.extend(numbered("rot", 4));
    names
}
