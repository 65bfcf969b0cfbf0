//! The stage: compares the rendered views of a split with the capture.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use captures::{CaptureArtifact, pixels_per_view, view_count};
use engine::{
    Failure, FailureKind, JobContext, ParamProblem, PlanContext, Port, Progress, Resources, Source, Stage, Work,
};
use rendering::Renders;
use scene::{Split, facts};
use serde::Deserialize as _;

use crate::artifact::{ImageMetrics, METRIC_VERSION, Metrics, mean_trivial_overlaps};
use crate::metrics::score::Score;
use crate::metrics::trivial::Trivial;
use crate::pairs::evaluate_pairs;
use crate::params::{LPIPS_FOLDER, MetricEvaluationParams};
use crate::scoring::masked::Masked;
use crate::scoring::perceptual::{NO_WEIGHTS, Networks};
use crate::scoring::trivial::{self, Truths};
use crate::scoring::{language, perceptual, surfaces, video};
use crate::test_set::TestSet;

/// The engine's name for the folder of LPIPS weights.
const LPIPS_WEIGHTS: &str = "lpips_weights";
/// The engine's name for the folder of features and flows.
const FRAME_FEATURES: &str = "frame_features";

/// The stage that evaluates renders.
pub struct MetricEvaluation;

impl Stage for MetricEvaluation {
    type Params = MetricEvaluationParams;
    type Output = Metrics;

    const ID: &'static str = "metric-evaluation";
    const ABOUT: &'static str = "compares rendered views with the capture's images (PSNR, SSIM, MS-SSIM, LPIPS), exact maps (velocity, flow, depth) and labels (prompts)";

    fn ports() -> Vec<Port> {
        vec![Port::one::<Renders>("renders"), Port::one::<CaptureArtifact>("capture")]
    }

    fn sources(params: &Self::Params) -> Vec<Source> {
        // No recipe has to name the conventional folder, and no evaluation fails without it.
        let is_convention = params.lpips_weights == Path::new(LPIPS_FOLDER);
        let folders =
            [(LPIPS_WEIGHTS, &params.lpips_weights, is_convention), (FRAME_FEATURES, &params.frame_features, false)];
        let given = folders.into_iter().filter(|(_, path, _)| !path.as_os_str().is_empty());
        let of_masks = params.masks.folders().map(|(name, files)| (name.key(), &files.folder, files.allow_missing));
        let source =
            |(name, path, optional): (&'static str, &PathBuf, bool)| Source { name, path: path.clone(), optional };
        given.chain(of_masks).map(source).collect()
    }

    fn check_params(params: &Self::Params) -> Vec<ParamProblem> {
        params.problems()
    }

    /// Pixels that are compared.
    fn work(params: &Self::Params, context: &PlanContext<'_>) -> Option<Work> {
        let (capture, split) = (context.facts("capture")?, context.facts("renders")?.value(facts::SPLIT)?);
        let split = Split::deserialize(split).ok()?;
        let networks = if params.lpips_weights.as_os_str().is_empty() { "" } else { "with LPIPS" };
        Work::of(networks, view_count(capture, split)? * pixels_per_view(capture)?)
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
        let (images, prompts, trivial) = pool.install(|| evaluate(&set, params, &watch))?;
        let metrics = Metrics {
            method: renders.method.clone(),
            protocol: renders.protocol.clone(),
            split: renders.split,
            metric_version: METRIC_VERSION,
            quantise: params.quantise,
            masks: params.masks.used().map(|mask| (mask.name, mask.keeps)).collect(),
            masked: Metrics::masked_means_of(&images, |image| &image.masked),
            means: Metrics::means_of(&images, &params.metrics),
            prompts,
            trivial_prompts: mean_trivial_overlaps(&images),
            trivial,
            n_images: images.len(),
            images,
        };
        metrics.write(context.output_dir())?;
        Ok(metrics)
    }
}

/// The connection of a running evaluation to its job: stop requests, progress, and input folders.
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

    /// Reports progress; fails if the job has to stop.
    fn checkpoint(&self, done: usize, total: usize, message: &str) -> Result<(), Failure> {
        (self.on_progress)(Progress { done: done as u64, total: total as u64, message: message.into() });
        let stopped = || Failure::new(FailureKind::Interrupted, "stopped on request");
        if self.stop.load(Ordering::Relaxed) { Err(stopped()) } else { Ok(()) }
    }
}

/// Computes all metrics of all images, the overlaps per prompt ([`Metrics::prompts`]), and the errors of trivial images.
fn evaluate(
    set: &TestSet<'_>,
    params: &MetricEvaluationParams,
    watch: &Watch<'_>,
) -> anyhow::Result<(Vec<ImageMetrics>, BTreeMap<String, Score>, Trivial)> {
    let pairs = set.pairs();
    let mut images = Vec::with_capacity(pairs.len());
    // Between batches, the job reports progress and may stop. A batch is large enough to keep all threads busy.
    for batch in pairs.chunks(4 * rayon::current_num_threads()) {
        images.extend(evaluate_pairs(batch, params, None)?.0);
        watch.checkpoint(images.len(), pairs.len(), "images evaluated")?;
    }
    let truths = Truths::of_set(set, params.quantise);
    let networks = Networks::open(watch.folder(LPIPS_WEIGHTS), &params.metrics, NO_WEIGHTS)?;
    let masked = Masked { set, params, networks: &networks, folders: watch.folders };
    trivial::add(&mut images, &truths, Some(&masked))?;
    surfaces::add(&mut images, set, params)?;
    video::add(&mut images, set, watch.folder(FRAME_FEATURES), params)?;
    let prompts = language::add(&mut images, set, params)?;
    for (index, image) in images.iter_mut().enumerate() {
        perceptual::add(image, &pairs[index], &networks, params, None)?;
        if masked.is_wanted() {
            image.masked = masked.scores(index, &set.images(index, params)?)?;
        }
        watch.checkpoint(index + 1, pairs.len(), "images evaluated by networks and masks")?;
    }
    let trivial = Metrics::trivial_of(&images, truths.over);
    Ok((images, prompts, trivial))
}
