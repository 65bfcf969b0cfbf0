//! Scenes of the CMU Panoptic Studio (Joo et al. 2015): the clips that Dynamic 3D Gaussians (Luiten et al. 2024) ships, and
//! full-size clips of the studio's own toolbox.

mod sports;
mod studio;

use std::path::Path;

use crate::error::Result;
use crate::params::Params;
use crate::source::SourceCapture;

/// The name of the benchmark in protocols.
const DATA_SET: &str = "cmu-panoptic";

/// Whether `dir` has one of the two layouts.
pub(crate) fn is_present(dir: &Path) -> bool {
    sports::is_present(dir) || studio::calibration(dir).is_some()
}

/// Reads the cameras and the names of the frames; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    if sports::is_present(dir) { sports::read(dir, params) } else { studio::read(dir, params) }
}
