//! Adds the figures of surfaces, as far as the capture knows them exactly.

use rayon::prelude::*;
use rendering::RenderedView;
use scene::View;

use crate::metrics::{Truths, judge_surfaces, psnr_of_moving};
use crate::test_set::TestSet;
use crate::{Image, ImageMetrics, Metric, MetricEvaluationParams};

/// Judges the surfaces of every image of the set.
pub fn add(images: &mut [ImageMetrics], set: &TestSet<'_>, params: &MetricEvaluationParams) -> anyhow::Result<()> {
    if !params.metrics.iter().any(|metric| metric.is_of_surfaces()) {
        return Ok(());
    }
    let views = set.views.par_iter();
    images.par_iter_mut().zip(views).try_for_each(|(image, (rendered, view))| judge(image, set, rendered, view, params))
}

fn judge(
    image: &mut ImageMetrics,
    set: &TestSet<'_>,
    rendered: &RenderedView,
    view: &View,
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    let capture = set.capture;
    let truths = Truths {
        depth: capture.load_depth(view)?,
        velocity: capture.load_velocity(view)?,
        flow: capture.load_flow(view)?,
    };
    if let Some(moving) = truths.moving() {
        let paths = [set.renders.image_path(rendered), capture.dir.join(&view.image)];
        let [render, truth] = paths.map(|path| Image::read(&path, params.quantise, None));
        let (score, error) = psnr_of_moving(&render?, &truth?, &moving);
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
