//! Conversion of decoded normals to unit vectors in the camera's frame.

use std::path::Path;

use glam::{DVec3, Vec3};
use scene::{Camera, Error, FloatImage, NormalMap, Result, pixels};

use crate::params::{Axes, NormalParams};

/// Minimum length of a stored normal; shorter vectors mark missing ones. Below 1, because estimators do not normalise
/// exactly and 8 bits round.
const SHORTEST: f32 = 0.5;
/// Largest share of normals that may point away from the camera before the declared axes count as wrong.
const MAX_AWAY_SHARE: f64 = 0.25;

/// Normals of a view from the values decoded from `path`. Values of PNG files (`is_png`) are mapped from [0, 1] to [-1,
/// 1].
pub(crate) fn normals_view(
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
        return Err(Error::new("the normal map has no value").at(path));
    }
    let centers = pixels::centers(values.width, values.height);
    let faces_away = |(normal, center): &(&Vec3, _)| DVec3::from(**normal).dot(camera.ray_view(*center)) > 0.0;
    let away = normals.iter().zip(centers).filter(faces_away).count();
    if away as f64 > MAX_AWAY_SHARE * known as f64 {
        let message = format!("{away} of {known} normals point away from the camera");
        return Err(Error::new(message)
            .hint("set normals.axes to \"opencv\" (right, down, forward) or \"opengl\" (right, up, backward)")
            .at(path));
    }
    let normals_view = normals.iter().map(Vec3::to_array).collect();
    Ok(NormalMap { width: values.width, height: values.height, normals_view })
}
