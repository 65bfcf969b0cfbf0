//! The artifact: sampled particles.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use scene::PointCloud;
use scene::index_file;
use scene::ply::{Ply, PlyFormat, Property, write_ply};
use serde::{Deserialize, Serialize};

/// Name of the index file.
const INDEX_FILE: &str = "particles.json";
/// What the index describes, for error messages.
const WHAT: &str = "particles";
/// Name of the file of particles.
const CLOUD: &str = "particles.ply";
/// Name of the PLY property with the energy of a particle.
const ENERGY: &str = "energy";

/// Particles sampled on moving surfaces: the index `particles.json` (this structure) and `particles.ply`, a point cloud
/// whose vertices have an `energy` in addition to position and colour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Particles {
    /// The folder of the artifact; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// Number of particles.
    pub count: usize,
    /// The first instant of the training views, in seconds. The position of a particle is that at the instant of its
    /// view.
    pub canonical_time_secs: f64,
    /// The views from which they were sampled.
    pub canonical_views: Vec<CanonicalView>,
    /// Strides in frames for which flow was available.
    pub strides: Vec<usize>,
}

/// A view from which particles were sampled.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CanonicalView {
    /// Index within the views of the capture.
    pub index: usize,
    /// Name of the view.
    pub name: String,
    /// Number of particles sampled from the view.
    pub particles: usize,
}

impl Particles {
    /// Reads world positions and colours, in the order in which the particles were drawn.
    pub fn load(&self) -> scene::Result<PointCloud> {
        PointCloud::read_ply(&self.dir.join(CLOUD))
    }

    /// The share of each particle in the momentum energy of all pixels.
    pub(crate) fn energies(&self) -> scene::Result<Vec<f32>> {
        Ply::open(&self.dir.join(CLOUD))?.vertices(&[ENERGY])
    }

    /// Writes the particles, then the index.
    pub(crate) fn save(&self, points: &PointCloud, energies: &[f32]) -> anyhow::Result<()> {
        let names = ["x", "y", "z"].map(Property::float).into_iter();
        let names = names.chain(["red", "green", "blue"].map(Property::byte)).chain([Property::float(ENERGY)]);
        let rows = points.positions.iter().zip(&points.colors).zip(energies);
        let values = rows.flat_map(|((position, color), energy)| {
            position.iter().copied().chain(color.map(f32::from)).chain([*energy])
        });
        let properties: Vec<_> = names.collect();
        write_ply(&self.dir.join(CLOUD), PlyFormat::BinaryLittleEndian, &properties, points.len(), values)?;
        Ok(index_file::write(&self.dir.join(INDEX_FILE), WHAT, self)?)
    }
}

impl engine::Artifact for Particles {
    const NAME: &'static str = "particles";
    const SCHEMA: u32 = 1;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        Ok(Self { dir: dir.into(), ..index_file::read(&dir.join(INDEX_FILE), WHAT)? })
    }

    /// Checks for at least one particle, finite positions, consistent counts, and energies that are shares of one
    /// total.
    fn check(&self) -> anyhow::Result<()> {
        let path = self.dir.join(CLOUD);
        let (points, energies) = (self.load()?, self.energies()?);
        ensure!(points.len() == self.count, "{} particles instead of {}: {}", points.len(), self.count, path.display());
        ensure!(self.count > 0, "no particles: {}", path.display());
        let drawn: usize = self.canonical_views.iter().map(|view| view.particles).sum();
        ensure!(
            drawn == self.count,
            "the views have {drawn} particles instead of {}: {}",
            self.count,
            self.dir.display()
        );
        ensure!(self.canonical_time_secs.is_finite(), "the canonical time is {}", self.canonical_time_secs);
        let share = energies.iter().all(|energy| (0.0..=1.0).contains(energy));
        let sum: f64 = energies.iter().map(|energy| f64::from(*energy)).sum();
        // Each share is rounded to f32.
        ensure!(share && sum <= 1.0 + 1e-4, "energies are not shares of one total (sum {sum}): {}", path.display());
        Ok(())
    }
}
