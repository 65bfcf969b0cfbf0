//! Adds metrics of surfaces, if the capture has exact maps.

use rayon::prelude::*;

use crate::artifact::ImageMetrics;
use crate::metrics::metric::{Family, Metric};
use crate::metrics::surfaces::{Truths, psnr_of_moving, scores_without_motion, silhouette_iou, surface_scores};
use crate::params::MetricEvaluationParams;
use crate::test_set::TestSet;

/// Adds surface metrics to all images of the set.
pub(crate) fn add(
    images: &mut [ImageMetrics],
    set: &TestSet<'_>,
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    if !params.metrics.iter().any(|metric| metric.family() == Family::Surfaces) {
        return Ok(());
    }
    let unit = set.capture.scale().unit;
    images.par_iter_mut().enumerate().try_for_each(|(index, image)| add_to_image(image, index, set, params, unit))
}

/// The pixels of an image of the set whose true surface moves; `None` if the capture has no velocities.
pub(crate) fn moving(set: &TestSet<'_>, index: usize) -> anyhow::Result<Option<Vec<bool>>> {
    let velocity = set.capture.load_velocity(set.views[index].1)?;
    let truths = Truths { unit: set.capture.scale().unit, velocity, depth: None, empty: None, flow: None };
    Ok(truths.moving())
}

fn add_to_image(
    image: &mut ImageMetrics,
    index: usize,
    set: &TestSet<'_>,
    params: &MetricEvaluationParams,
    unit: f64,
) -> anyhow::Result<()> {
    let (capture, (rendered, view)) = (set.capture, set.views[index]);
    let truths = Truths {
        unit,
        depth: capture.load_depth(view)?,
        empty: set.empty_pixels(view)?,
        velocity: capture.load_velocity(view)?,
        flow: capture.load_flow(view)?,
    };
    if let Some(moving) = truths.moving() {
        let [render, truth] = set.images(index, params)?;
        let (score, error) = psnr_of_moving(&render, &truth, &moving);
        image.moving = error;
        if params.metrics.contains(&Metric::PsnrMoving) {
            image.values.insert(Metric::PsnrMoving, score);
        }
    }
    if let Some(maps) = set.renders.load_maps(rendered)? {
        set.check_size(view, (maps.width, maps.height))?;
        image.values.extend(surface_scores(&maps, &truths, &params.metrics));
        image.without_motion = scores_without_motion(&truths, &params.metrics);
        let labels = if truths.velocity.is_none() { capture.load_mask(view)? } else { None };
        if let Some(labels) = labels.filter(|_| params.metrics.contains(&Metric::SilhouetteIou)) {
            image.values.insert(Metric::SilhouetteIou, silhouette_iou(&maps, &labels));
        }
    }
    Ok(())
}
