//! Coloured point clouds.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gaussians::SH_C0;
use crate::ply::{Ply, PlyFormat, Property, write_ply};
use crate::{Error, Result};

/// Largest colour of floats in 0–1: bright surfaces may exceed 1, but those of 0–255 exceed this.
const LARGEST_UNIT: f32 = 2.0;

/// N coloured points in world coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// [N, 3] world positions in scene units.
    pub positions: Vec<[f32; 3]>,
    /// [N, 3] sRGB colours.
    pub colors: Vec<[u8; 3]>,
}

impl PointCloud {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether the cloud has no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Draws `count` grey points uniformly in a box (min, max corner): the initialisation for captures without
    /// structure from motion (Kerbl et al. 2023).
    pub fn random_in(bounds_world: [[f64; 3]; 2], count: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let [low, high] = bounds_world;
        let mut coordinate = |axis: usize| low[axis] + (high[axis] - low[axis]) * random.random::<f64>();
        let mut point = || std::array::from_fn(|axis| coordinate(axis) as f32);
        Self { positions: (0..count).map(|_| point()).collect(), colors: vec![[128; 3]; count] }
    }

    /// Checks that there is one colour per point and that all positions are finite.
    pub fn check(&self) -> Result<()> {
        if self.positions.len() != self.colors.len() {
            let (points, colors) = (self.positions.len(), self.colors.len());
            return Err(Error::new(format!("{points} points with {colors} colours")));
        }
        match self.positions.iter().position(|point| !point.iter().all(|value| value.is_finite())) {
            Some(at) => {
                let message = format!("point {at} has the position {:?} in single precision", self.positions[at]);
                Err(Error::new(message)
                    .hint("remove the point, or correct it: coordinates must be numbers below 3.4e38"))
            }
            None => Ok(()),
        }
    }

    /// Reads the `vertex` elements of a PLY file: x, y, z and, if present, colours (e.g. `red` or `r`; integers in
    /// 0–255 or 0–65535, or floats in 0–1 or 0–255, whichever the largest value needs). Gaussians have the colours of degree 0 (`f_dc_0`). Points without colours are grey. Other
    /// properties and elements are skipped.
    pub fn read_ply(path: &Path) -> Result<Self> {
        let cloud = Self::read_unchecked(path)?;
        cloud.check().map_err(|error| error.at(path))?;
        Ok(cloud)
    }

    /// Reads a PLY file as [`PointCloud::read_ply`] does, but drops points whose position is not finite. Returns their number, too.
    pub fn read_finite_ply(path: &Path) -> Result<(Self, usize)> {
        let Self { positions, colors } = Self::read_unchecked(path)?;
        let count = positions.len();
        let is_finite = |(position, _): &([f32; 3], [u8; 3])| position.iter().all(|value| value.is_finite());
        let (positions, colors): (Vec<_>, Vec<_>) = positions.into_iter().zip(colors).filter(is_finite).unzip();
        let dropped = count - positions.len();
        Ok((Self { positions, colors }, dropped))
    }

    fn read_unchecked(path: &Path) -> Result<Self> {
        let ply = Ply::open(path)?;
        let values = ply.vertices(&["x", "y", "z"])?;
        let positions = values.chunks_exact(3).map(|point| [point[0], point[1], point[2]]).collect::<Vec<_>>();
        let colors = colors(&ply)?.unwrap_or_else(|| vec![[128; 3]; positions.len()]);
        Ok(Self { positions, colors })
    }

    /// Writes a PLY file with positions as `float` and colours as `uchar`.
    pub fn write_ply(&self, path: &Path, format: PlyFormat) -> Result<()> {
        self.check().map_err(|error| error.at(path))?;
        let mut properties = vec![];
        properties.extend(["x", "y", "z"].map(Property::float));
        properties.extend(["red", "green", "blue"].map(Property::byte));
        let rows = self.positions.iter().zip(&self.colors).flat_map(|(position, color)| {
            let color = color.map(f32::from);
            position.iter().copied().chain(color)
        });
        write_ply(path, format, &properties, self.len(), rows)
    }
}

/// The colours of the vertices, if the file has any.
fn colors(ply: &Ply) -> Result<Option<Vec<[u8; 3]>>> {
    const GAUSSIANS: [&str; 3] = ["f_dc_0", "f_dc_1", "f_dc_2"];
    let names =
        [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"], GAUSSIANS];
    let named = names.iter().find(|names| names.iter().all(|name| ply.property(name).is_some()));
    let Some(names) = named else { return Ok(None) };
    let is_float = ply.property(names[0]).is_some_and(Property::is_float);
    let values = ply.vertices(names)?;
    let largest = values.iter().copied().fold(0.0, f32::max);
    let level = |value: f32| match is_float {
        _ if *names == GAUSSIANS => 255.0 * (0.5 + SH_C0 * value),
        true if largest <= LARGEST_UNIT => 255.0 * value,
        false if largest > 255.0 => value / 257.0,
        _ => value,
    };
    let byte = |value: f32| level(value).round().clamp(0.0, 255.0) as u8;
    Ok(Some(values.chunks_exact(3).map(|rgb| [byte(rgb[0]), byte(rgb[1]), byte(rgb[2])]).collect()))
}
