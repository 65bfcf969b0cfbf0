//! Adds the figures of surfaces, as far as the capture knows them exactly.

use rayon::prelude::*;

use crate::metrics::{Family, Truths, judge_surfaces, psnr_of_moving};
use crate::test_set::TestSet;
use crate::{ImageMetrics, Metric, MetricEvaluationParams};

/// Judges the surfaces of every image of the set.
pub fn add(images: &mut [ImageMetrics], set: &TestSet<'_>, params: &MetricEvaluationParams) -> anyhow::Result<()> {
    if !params.metrics.iter().any(|metric| metric.family() == Family::Surfaces) {
        return Ok(());
    }
    images.par_iter_mut().enumerate().try_for_each(|(index, image)| judge(image, index, set, params))
}

fn judge(
    image: &mut ImageMetrics,
    index: usize,
    set: &TestSet<'_>,
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    let (capture, (rendered, view)) = (set.capture, set.views[index]);
    let truths = Truths {
        depth: capture.load_depth(view)?,
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
        image.values.extend(judge_surfaces(&maps, &truths, &params.metrics));
    }
    Ok(())
}
