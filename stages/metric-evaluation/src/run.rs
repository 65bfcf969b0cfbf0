//! The stage: pairs rendered views with the capture's images and judges them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use engine::{Failure, FailureKind, JobContext, ParamProblem, Port, Resources, Stage};
use rayon::prelude::*;
use rendering::Renders;

use crate::artifact::empty_set;
use crate::metrics::{judge, mean_squared_error};
use crate::test_set::TestSet;
use crate::{Background, Image, ImageMetrics, METRIC_VERSION, MetricEvaluationParams, Metrics, Remark};
use crate::{language, surfaces};

/// The stage `metric-evaluation`.
pub struct MetricEvaluation;

engine::artifact! {
    /// The capture whose images are the truth.
    pub struct TrueImages(scene::Capture) = "capture" @ scene::capture::SCHEMA;
}

impl Stage for MetricEvaluation {
    type Params = MetricEvaluationParams;
    type Output = Metrics;

    const ID: &'static str = "metric-evaluation";
    const ABOUT: &'static str = "judges rendered views against the capture's images (PSNR, SSIM, MS-SSIM), exact maps (velocity, flow, depth) and labels (prompts)";

    fn ports() -> Vec<Port> {
        vec![Port::one::<Renders>("renders"), Port::one::<TrueImages>("capture")]
    }

    fn check_params(params: &Self::Params) -> Vec<ParamProblem> {
        let problem = ParamProblem {
            key: "metrics".into(),
            message: "no metric to compute".into(),
            hint: Some("leave the key out to compute all".into()),
        };
        if params.metrics.is_empty() { vec![problem] } else { Vec::new() }
    }

    fn resources(_params: &Self::Params) -> Resources {
        Resources { threads: 0 }
    }

    fn run(context: &JobContext, params: &Self::Params) -> anyhow::Result<Metrics> {
        let renders: Renders = context.input("renders")?;
        let capture: TrueImages = context.input("capture")?;
        let set = TestSet::new(&renders, &capture)?;
        let pairs = set.pairs();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        // Between batches the job reports and may stop; a batch keeps every thread busy.
        let batch = 4 * pool.current_num_threads();
        let mut images = Vec::with_capacity(pairs.len());
        for pairs_of_batch in pairs.chunks(batch) {
            if context.should_stop() {
                return Err(context.interrupted());
            }
            images.extend(pool.install(|| evaluate_pairs(pairs_of_batch, params, None))?.0);
            context.progress(images.len() as u64, pairs.len() as u64, "images judged");
        }
        let prompts = pool.install(|| {
            surfaces::add(&mut images, &set, params)?;
            language::add(&mut images, &set, params)
        })?;
        let metrics = Metrics {
            method: renders.method.clone(),
            protocol: renders.protocol.clone(),
            split: renders.split,
            metric_version: METRIC_VERSION,
            quantise: params.quantise,
            means: Metrics::means_of(&images, &params.metrics),
            prompts,
            n_images: images.len(),
            images,
        };
        metrics.write(context.output_dir())?;
        Ok(metrics)
    }
}

/// A render and the image that it should be.
#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    /// The view's name.
    pub name: String,
    /// When the image was taken, where that is known.
    pub time_secs: Option<f64>,
    /// Which camera of the rig, where that is known.
    pub camera_index: Option<u32>,
    /// The image to judge.
    pub render: PathBuf,
    /// The image that it should be.
    pub truth: PathBuf,
}

/// Judges every pair, in parallel; returns the scores in the given order and the images' common width and height.
///
/// # Errors
/// No pairs; an unreadable or transparent image; sizes that differ within a pair or between pairs (a protocol has one
/// size).
pub fn evaluate_pairs(
    pairs: &[Pair],
    params: &MetricEvaluationParams,
    background: Option<Background>,
) -> Result<(Vec<ImageMetrics>, [u32; 2]), Failure> {
    let judged: Vec<_> =
        pairs.par_iter().map(|pair| evaluate_pair(pair, params, background)).collect::<Result<_, _>>()?;
    let (_, size) = judged.first().ok_or_else(|| empty_set("set"))?;
    let size = *size;
    for ((_, other), pair) in judged.iter().zip(pairs) {
        if *other != size {
            let [width, height] = size;
            let message = format!("image is {}×{} px, but {} is {width}×{height}", other[0], other[1], pairs[0].name);
            let hint = "a protocol has one size: judge images of different sizes separately";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(&pair.render));
        }
    }
    Ok((judged.into_iter().map(|(image, _)| image).collect(), size))
}

fn evaluate_pair(
    pair: &Pair,
    params: &MetricEvaluationParams,
    background: Option<Background>,
) -> Result<(ImageMetrics, [u32; 2]), Failure> {
    let render = Image::read(&pair.render, params.quantise, background)?;
    let truth = Image::read(&pair.truth, params.quantise, background)?;
    if (render.width, render.height) != (truth.width, truth.height) {
        let message =
            format!("render is {}×{} px, its true image {}×{}", render.width, render.height, truth.width, truth.height);
        let hint = "render at the size of the true images; resizing here would change the protocol";
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
        values: judge(&render, &truth, &params.metrics),
        moving: None,
        prompt_ious: BTreeMap::new(),
        remarks,
    };
    Ok((scored, [render.width as u32, render.height as u32]))
}
