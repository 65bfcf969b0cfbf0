//! From the values of a file to unit normals in the camera's frame.

use std::path::Path;

use glam::{DVec3, Vec3};
use scene::{Camera, Error, FloatImage, NormalMap, Result};

use crate::params::{Axes, NormalParams};
use crate::raster::pixel_centers;

/// Shorter vectors mark missing normals; estimators do not normalise exactly, and 8 bits round.
const SHORTEST: f32 = 0.5;
/// If more normals than this look away from the camera, the axes are other ones than declared.
const MAX_AWAY_SHARE: f64 = 0.25;

/// Normals of a view from the decoded values of `path`; values of PNG files (`is_png`) map [0, 1] to [-1, 1].
pub fn normals_view(
    values: &FloatImage,
    camera: &Camera,
    params: &NormalParams,
    is_png: bool,
    path: &Path,
) -> Result<NormalMap> {
    let sign = match params.axes {
        Axes::Opencv => Vec3::ONE,
        Axes::Opengl => Vec3::new(1.0, -1.0, -1.0),
    };
    let unit = |value: &[f32]| {
        let stored = Vec3::new(value[0], value[1], value[2]);
        let vector = sign * if is_png { 2.0 * stored - 1.0 } else { stored };
        if vector.is_finite() && vector.length() >= SHORTEST { vector.normalize() } else { Vec3::ZERO }
    };
    let normals: Vec<Vec3> = values.values.chunks_exact(3).map(unit).collect();
    let known = normals.iter().filter(|normal| **normal != Vec3::ZERO).count();
    if known == 0 {
        return Err(Error::new("a map without any normal").at(path));
    }
    let centers = pixel_centers(values.width, values.height);
    let looks_away = |(normal, center): &(&Vec3, _)| DVec3::from(**normal).dot(camera.ray_view(*center)) > 0.0;
    let away = normals.iter().zip(centers).filter(looks_away).count();
    if away as f64 > MAX_AWAY_SHARE * known as f64 {
        let message = format!("{away} of {known} normals look away from the camera");
        return Err(Error::new(message)
            .hint("normals.axes is \"opencv\" (right, down, forward) or \"opengl\"")
            .at(path));
    }
    let normals_view = normals.iter().map(Vec3::to_array).collect();
    Ok(NormalMap { width: values.width, height: values.height, normals_view })
}
