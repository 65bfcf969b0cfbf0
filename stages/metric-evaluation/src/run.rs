//! The stage: pairs rendered views with the capture's images and judges them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use captures::CaptureArtifact;
use engine::{Failure, FailureKind, JobContext, ParamProblem, Port, Progress, Resources, Source, Stage};
use rayon::prelude::*;
use rendering::Renders;

use crate::artifact::empty_set;
use crate::judges::perceptual::Networks;
use crate::judges::{language, masked, perceptual, surfaces, video};
use crate::metrics::{judge, mean_squared_error};
use crate::test_set::TestSet;
use crate::{Background, Image, ImageMetrics, METRIC_VERSION, MetricEvaluationParams, Metrics, Remark, Score};

/// Names under which the engine hands over folders.
const LPIPS_WEIGHTS: &str = "lpips_weights";
const MASK_FOLDER: &str = "mask_folder";
const FRAME_FEATURES: &str = "frame_features";

/// The stage `metric-evaluation`.
pub struct MetricEvaluation;

impl Stage for MetricEvaluation {
    type Params = MetricEvaluationParams;
    type Output = Metrics;

    const ID: &'static str = "metric-evaluation";
    const ABOUT: &'static str = "judges rendered views against the capture's images (PSNR, SSIM, MS-SSIM, LPIPS), exact maps (velocity, flow, depth) and labels (prompts)";

    fn ports() -> Vec<Port> {
        vec![Port::one::<Renders>("renders"), Port::one::<CaptureArtifact>("capture")]
    }

    fn sources(params: &Self::Params) -> Vec<Source> {
        let folders = [
            (LPIPS_WEIGHTS, &params.lpips_weights),
            (MASK_FOLDER, &params.mask_folder),
            (FRAME_FEATURES, &params.frame_features),
        ];
        let given = folders.into_iter().filter(|(_, path)| !path.as_os_str().is_empty());
        given.map(|(name, path)| Source { name, path: path.clone() }).collect()
    }

    fn check_params(params: &Self::Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn resources(_params: &Self::Params) -> Resources {
        Resources { threads: 0 }
    }

    fn run(context: &JobContext, params: &Self::Params) -> anyhow::Result<Metrics> {
        let renders: Renders = context.input("renders")?;
        let capture: CaptureArtifact = context.input("capture")?;
        let set = TestSet::new(&renders, &capture)?;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        let watch = Watch { stop: &context.stop, on_progress: &*context.on_progress, folders: &context.sources };
        let (images, prompts) = pool.install(|| judge_all(&set, params, &watch))?;
        let metrics = Metrics {
            method: renders.method.clone(),
            protocol: renders.protocol.clone(),
            split: renders.split,
            metric_version: METRIC_VERSION,
            quantise: params.quantise,
            mask: params.mask,
            mask_keeps: params.mask_keeps,
            means: Metrics::means_of(&images, &params.metrics),
            prompts,
            n_images: images.len(),
            images,
        };
        metrics.write(context.output_dir())?;
        Ok(metrics)
    }
}

/// Whom a judgement asks and tells while it runs.
struct Watch<'a> {
    stop: &'a AtomicBool,
    on_progress: &'a (dyn Fn(Progress) + Send + Sync),
    /// Absolute paths of the folders that the parameters name.
    folders: &'a BTreeMap<String, PathBuf>,
}

impl Watch<'_> {
    fn folder(&self, name: &str) -> Option<&Path> {
        self.folders.get(name).map(PathBuf::as_path)
    }

    fn go_on(&self, done: usize, total: usize, message: &str) -> Result<(), Failure> {
        (self.on_progress)(Progress { done: done as u64, total: total as u64, message: message.into() });
        let stopped = || Failure::new(FailureKind::Interrupted, "stopped on request");
        if self.stop.load(Ordering::Relaxed) { Err(stopped()) } else { Ok(()) }
    }
}

/// Every figure of every image of the set, and the overlaps of prompts ([`Metrics::prompts`]).
fn judge_all(
    set: &TestSet<'_>,
    params: &MetricEvaluationParams,
    watch: &Watch<'_>,
) -> anyhow::Result<(Vec<ImageMetrics>, BTreeMap<String, Score>)> {
    let pairs = set.pairs();
    let mut images = Vec::with_capacity(pairs.len());
    // Between batches the job reports and may stop; a batch keeps every thread busy.
    for batch in pairs.chunks(4 * rayon::current_num_threads()) {
        images.extend(evaluate_pairs(batch, params, None)?.0);
        watch.go_on(images.len(), pairs.len(), "images judged")?;
    }
    surfaces::add(&mut images, set, params)?;
    video::add(&mut images, set, watch.folder(FRAME_FEATURES), params)?;
    let prompts = language::add(&mut images, set, params)?;
    let networks = Networks::open(watch.folder(LPIPS_WEIGHTS), &params.metrics)?;
    for (index, image) in images.iter_mut().enumerate() {
        perceptual::add(image, &pairs[index], &networks, params, None)?;
        if masked::is_wanted(params) {
            masked::add(image, index, set, watch.folder(MASK_FOLDER), &networks, params)?;
        }
        watch.go_on(index + 1, pairs.len(), "images judged by networks and masks")?;
    }
    Ok((images, prompts))
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
