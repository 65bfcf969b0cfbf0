//! From the values of a file to view-space depth in scene units.

use std::path::Path;

use scene::{Camera, DepthMap, Error, FloatImage, PointCloud, Result};

use crate::alignment::{Fit, MIN_INLIER_SHARE, MIN_SAMPLES, fit_scale, fit_scale_shift, median};
use crate::params::{Alignment, DepthKind, DepthParams};
use crate::raster::pixel_centers;

/// What is farther than this multiple of the median distance of the points has no known depth: its aligned inverse depth
/// is rounding and noise around 0.
const FARTHEST: f64 = 1000.0;

/// Depth of a view of `camera` from the decoded values of `path`, and the fit to `points` (world) where one was made.
///
/// Values that are zero (distances) or not finite are missing; a negative distance and a map without any value are
/// errors.
pub fn depth_view(
    values: &FloatImage,
    camera: &Camera,
    params: &DepthParams,
    points: Option<&PointCloud>,
    path: &Path,
) -> Result<(DepthMap, Option<Fit>)> {
    let inverse_depths = inverse_depths(values, camera, params).map_err(|error| error.at(path))?;
    if inverse_depths.iter().all(Option::is_none) {
        let hint = "an estimator that fails writes zeros or NaN";
        return Err(Error::new("a depth map without any value").hint(hint).at(path));
    }
    let alignment = params.alignment();
    let (fit, farthest) = if alignment == Alignment::None {
        (None, f64::INFINITY)
    } else {
        let samples = samples(&inverse_depths, camera, points.ok_or_else(|| no_points().at(path))?);
        let fit = if alignment == Alignment::Scale { fit_scale(&samples) } else { fit_scale_shift(&samples) };
        let fit = fit.ok_or_else(|| not_aligned(&samples, &inverse_depths).at(path))?;
        let typical = median(samples.iter().map(|(_, inverse_depth)| 1.0 / inverse_depth));
        (Some(fit), FARTHEST * typical.unwrap_or(f64::INFINITY))
    };
    let depth = |value: &Option<f64>| {
        let inverse_depth = value.map(|value| fit.map_or(value, |fit| fit.apply(value)));
        let known = inverse_depth.filter(|inverse_depth| inverse_depth * farthest > 1.0);
        known.map_or(0.0, |inverse_depth| (1.0 / inverse_depth) as f32)
    };
    let depth_view = inverse_depths.iter().map(depth).collect();
    Ok((DepthMap { width: values.width, height: values.height, depth_view }, fit))
}

/// Inverse z per pixel, in the map's own scale; `None` where the file has no value.
pub fn inverse_depths(values: &FloatImage, camera: &Camera, params: &DepthParams) -> Result<Vec<Option<f64>>> {
    let units = params.units_per_value.unwrap_or(1.0);
    let centers = pixel_centers(values.width, values.height);
    let inverse_depth = |(value, center): (&f32, glam::DVec2)| {
        let value = f64::from(*value);
        let z = match params.kind {
            DepthKind::InverseDepth => return Ok(value.is_finite().then_some(value)),
            DepthKind::Z => value * units,
            DepthKind::RayDistance => value * units / camera.ray_view(center).length(),
        };
        match value {
            value if value < 0.0 => Err(Error::new(format!("depth {value} is not a distance"))
                .hint("is it inverse depth, or are the axes those of OpenGL?")),
            value if value > 0.0 && value.is_finite() => Ok(Some(1.0 / z)),
            _ => Ok(None),
        }
    };
    values.values.iter().zip(centers).map(inverse_depth).collect()
}

/// The map's value and the inverse depth of the nearest of the points in each pixel that has one.
fn samples(inverse_depths: &[Option<f64>], camera: &Camera, points: &PointCloud) -> Vec<(f64, f64)> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut nearest = vec![0.0_f64; inverse_depths.len()];
    for point in &points.positions {
        let Some((pixel, z)) = camera.project(point.map(f64::from).into()) else { continue };
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < f64::from(width) && pixel.y < f64::from(height);
        if inside {
            let at = pixel.y as usize * width as usize + pixel.x as usize;
            nearest[at] = nearest[at].max(1.0 / z);
        }
    }
    let both = inverse_depths.iter().zip(nearest).filter(|(_, point)| *point > 0.0);
    both.filter_map(|(value, point)| Some(((*value)?, point))).collect()
}

fn no_points() -> Error {
    Error::new("the capture has no points to align depth with")
        .hint("import a capture with structure from motion, or depth in scene units with alignment = \"none\"")
}

fn not_aligned(samples: &[(f64, f64)], inverse_depths: &[Option<f64>]) -> Error {
    let known = inverse_depths.iter().flatten().count();
    let message = match samples.len() {
        few if few < MIN_SAMPLES => format!("only {few} points fall on the {known} pixels with a value"),
        many => {
            format!("no scale and shift fits {:.0} % of the {many} points in this view", 100.0 * MIN_INLIER_SHARE)
        }
    };
    Error::new(message).hint("is the kind of depth right, and do the poses belong to this view?")
}
