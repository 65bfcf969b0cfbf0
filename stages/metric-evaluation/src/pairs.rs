//! Comparison of pairs of images.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use engine::{Failure, FailureKind};
use rayon::prelude::*;

use crate::artifact::{ImageMetrics, Remark, empty_set};
use crate::image_file::{Background, Image};
use crate::metrics::image_scores;
use crate::metrics::psnr::mean_squared_error;
use crate::metrics::trivial::Moments;
use crate::params::MetricEvaluationParams;

/// A render and its ground truth.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pair {
    /// Name of the view.
    pub(crate) name: String,
    /// Time of the view in seconds, if known.
    pub(crate) time_secs: Option<f64>,
    /// Index of the camera in a rig, if known.
    pub(crate) camera_index: Option<u32>,
    /// Path of the render.
    pub(crate) render: PathBuf,
    /// Path of the ground truth.
    pub(crate) truth: PathBuf,
}

/// Evaluates all pairs in parallel. Returns the scores in the given order, and the common width and height.
///
/// # Errors
/// No pairs; an unreadable or transparent image; different sizes within a pair or between pairs (a protocol has one size).
pub(crate) fn evaluate_pairs(
    pairs: &[Pair],
    params: &MetricEvaluationParams,
    background: Option<Background>,
) -> Result<(Vec<ImageMetrics>, [u32; 2]), Failure> {
    let scored: Vec<_> =
        pairs.par_iter().map(|pair| evaluate_pair(pair, params, background)).collect::<Result<_, _>>()?;
    let (_, size) = scored.first().ok_or_else(|| empty_set("set"))?;
    let size = *size;
    for ((_, other), pair) in scored.iter().zip(pairs) {
        if *other != size {
            let [width, height] = size;
            let message =
                format!("the image is {}×{} px, but {} is {width}×{height}", other[0], other[1], pairs[0].name);
            let hint = "a protocol has one size: evaluate images of different sizes separately";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(&pair.render));
        }
    }
    Ok((scored.into_iter().map(|(image, _)| image).collect(), size))
}

fn evaluate_pair(
    pair: &Pair,
    params: &MetricEvaluationParams,
    background: Option<Background>,
) -> Result<(ImageMetrics, [u32; 2]), Failure> {
    let render = Image::read(&pair.render, params.quantise, background)?;
    let truth = Image::read(&pair.truth, params.quantise, background)?;
    if (render.width, render.height) != (truth.width, truth.height) {
        let message = format!(
            "the render is {}×{} px, but its ground truth is {}×{}",
            render.width, render.height, truth.width, truth.height
        );
        let hint = "render at the size of the ground truth; resizing here would change the protocol";
        return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(&pair.render));
    }
    let mut remarks = BTreeSet::new();
    remarks.extend(render.is_constant().then_some(Remark::ConstantRender));
    remarks.extend(truth.is_constant().then_some(Remark::ConstantTruth));
    remarks.extend((render == truth).then_some(Remark::Identical));
    let scored = ImageMetrics {
        name: pair.name.clone(),
        time_secs: pair.time_secs,
        camera_index: pair.camera_index,
        mse: mean_squared_error(&render, &truth),
        render_variance: Moments::of(&render).variance.iter().sum::<f64>() / 3.0,
        truth: Moments::of(&truth),
        mean_image_mse: None,
        without_motion: BTreeMap::new(),
        background_share: None,
        values: image_scores(&render, &truth, &params.metrics),
        masked: BTreeMap::new(),
        masked_mean_image: BTreeMap::new(),
        moving: None,
        moving_mean_image: None,
        prompt_ious: BTreeMap::new(),
        trivial_ious: BTreeMap::new(),
        remarks,
    };
    Ok((scored, [render.width as u32, render.height as u32]))
}
