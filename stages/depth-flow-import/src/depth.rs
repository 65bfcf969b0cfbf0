//! Conversion of decoded depth values to view-space depth in scene units.

use std::path::Path;

use scene::maps::NO_HIT_DEPTH;
use scene::maps::alignment::{Fit, MIN_INLIER_SHARE, MIN_SAMPLES, fit_scale, fit_scale_shift};
use scene::statistics::median;
use scene::{Camera, DepthMap, Error, FloatImage, PointCloud, Result, pixels};

use crate::params::{Alignment, DepthParams};

/// Largest aligned depth, as a multiple of the median depth of the points. Beyond it, inverse depth is noise and
/// rounding around 0, so the depth counts as unknown.
const FARTHEST: f64 = 1000.0;

/// Depth of a view of `camera` from the values decoded from `path`, and the fit to `points` (world) if one was made.
///
/// Values that are zero (for distances), not finite, or beyond [`NO_HIT_DEPTH`] without an alignment are missing. A negative distance or a map without any value is an
/// error.
pub(crate) fn depth_view(
    values: &FloatImage,
    camera: &Camera,
    params: &DepthParams,
    points: Option<&PointCloud>,
    path: &Path,
) -> Result<(DepthMap, Option<Fit>)> {
    let units_per_value = params.units_per_value.unwrap_or(1.0);
    let inverse_depths = params.kind.inverse_depths(values, camera, units_per_value);
    let inverse_depths = inverse_depths.map_err(|error| error.at(path))?;
    if inverse_depths.iter().all(Option::is_none) {
        let hint = "an estimator that failed writes zeros or NaN";
        return Err(Error::new("the depth map has no value").hint(hint).at(path));
    }
    let alignment = params.alignment();
    let (fit, farthest) = if alignment == Alignment::None {
        (None, NO_HIT_DEPTH)
    } else {
        let samples = samples(&inverse_depths, camera, params, points.ok_or_else(|| no_points().at(path))?);
        let fit = if alignment == Alignment::Scale { fit_scale(&samples) } else { fit_scale_shift(&samples) };
        let fit = fit.ok_or_else(|| not_aligned(&samples, &inverse_depths).at(path))?;
        let typical = median(samples.iter().map(|(_, quantity)| params.kind.affine_quantity(*quantity)));
        (Some(fit), FARTHEST * typical.unwrap_or(f64::INFINITY))
    };
    let depth = |value: &Option<f64>| {
        let z = value.map(|value| params.kind.affine_quantity(fit.map_or(value, |fit| fit.apply(value))));
        z.filter(|z| *z > 0.0 && *z < farthest).map_or(0.0, |z| z as f32)
    };
    let depth_view = inverse_depths.iter().map(depth).collect();
    Ok((DepthMap { width: values.width, height: values.height, depth_view }, fit))
}

/// The median relative difference between the depth in the values and that of the points, after an alignment; none if too few
/// points can be compared, or none fits.
pub(crate) fn misfit(
    values: &FloatImage,
    camera: &Camera,
    params: &DepthParams,
    points: &PointCloud,
) -> Result<Option<f64>> {
    let units_per_value = params.units_per_value.unwrap_or(1.0);
    let values = params.kind.inverse_depths(values, camera, units_per_value)?;
    let samples = samples(&values, camera, params, points);
    let fit = match params.alignment() {
        _ if samples.len() < MIN_SAMPLES => return Ok(None),
        Alignment::None => Some(Fit { scale: 1.0, shift: 0.0, inlier_share: 1.0 }),
        Alignment::Scale => fit_scale(&samples),
        Alignment::ScaleShift => fit_scale_shift(&samples),
    };
    let difference =
        |fit: Fit| median(samples.iter().map(|(value, inverse_depth)| (fit.apply(*value) / inverse_depth - 1.0).abs()));
    Ok(fit.and_then(difference))
}

/// Pairs of map value and inverse depth (for affine depth: depth) of a point, one for every pixel with a value and at least one
/// point; of several points in a pixel, the nearest counts.
fn samples(
    inverse_depths: &[Option<f64>],
    camera: &Camera,
    params: &DepthParams,
    points: &PointCloud,
) -> Vec<(f64, f64)> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut nearest = vec![0.0_f64; inverse_depths.len()];
    for point in &points.positions {
        let Some((position, z)) = camera.project(point.map(f64::from).into()) else { continue };
        if let Some(pixel) = pixels::index_at(position, width, height) {
            nearest[pixel] = nearest[pixel].max(1.0 / z);
        }
    }
    let both = inverse_depths.iter().zip(nearest).filter(|(_, point)| *point > 0.0);
    both.filter_map(|(value, point)| Some(((*value)?, params.kind.affine_quantity(1.0 / point)))).collect()
}

fn no_points() -> Error {
    Error::new("the capture has no points to align depth with")
        .hint("import a capture with structure from motion, or depth in scene units with alignment = \"none\"")
}

fn not_aligned(samples: &[(f64, f64)], inverse_depths: &[Option<f64>]) -> Error {
    let known = inverse_depths.iter().flatten().count();
    let message = match samples.len() {
        few if few < MIN_SAMPLES => format!("only {few} points project onto the {known} pixels with a value"),
        many => {
            format!("no scale and shift fits {:.0} % of the {many} points in this view", 100.0 * MIN_INLIER_SHARE)
        }
    };
    Error::new(message).hint("is depth.kind right, and do the poses belong to this view?")
}
