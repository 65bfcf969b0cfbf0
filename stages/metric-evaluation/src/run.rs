//! The stage: pairs rendered views with the capture's images and judges them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use engine::{Failure, FailureKind, JobContext, ParamProblem, Port, Resources, Stage};
use rayon::prelude::*;
use rendering::{RenderedView, Renders};
use scene::{Capture, View};

use crate::artifact::empty_set;
use crate::metrics::{Truths, judge, judge_surfaces, mean_squared_error, psnr_of_moving};
use crate::{Background, Image, ImageMetrics, METRIC_VERSION, Metric, MetricEvaluationParams, Metrics, Remark};

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
    const ABOUT: &'static str = "judges rendered views against the capture's images (PSNR, SSIM, MS-SSIM) and exact maps (velocity, flow, depth)";

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
        let pairs = pairs_of(&renders, &capture)?;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        // Between batches the job reports and may stop; a batch keeps every thread busy.
        let batch = 4 * pool.current_num_threads();
        let mut images = Vec::with_capacity(pairs.len());
        for pairs_of_batch in pairs.chunks(batch) {
            if context.should_stop() {
                return Err(context.interrupted());
            }
            let mut judged = pool.install(|| evaluate_pairs(pairs_of_batch, params, None))?.0;
            pool.install(|| {
                judged.par_iter_mut().try_for_each(|image| add_surfaces(image, &renders, &capture, params))
            })?;
            images.extend(judged);
            context.progress(images.len() as u64, pairs.len() as u64, "images judged");
        }
        let metrics = Metrics {
            method: renders.method,
            protocol: renders.protocol,
            split: renders.split,
            metric_version: METRIC_VERSION,
            quantise: params.quantise,
            means: Metrics::means_of(&images, &params.metrics),
            n_images: images.len(),
            images,
        };
        metrics.write(context.output_dir())?;
        Ok(metrics)
    }
}

/// Pairs every view of the rendered split with its render; none may be missing, since the mean is over the split.
fn pairs_of(renders: &Renders, capture: &scene::Capture) -> Result<Vec<Pair>, Failure> {
    if renders.protocol != capture.protocol {
        let message = format!("renders belong to another capture: {}", renders.protocol.line());
        return Err(
            Failure::new(FailureKind::BadInput, message).hint(format!("the capture is {}", capture.protocol.line()))
        );
    }
    let views: Vec<_> = capture.views.iter().filter(|view| view.split == renders.split).collect();
    if views.is_empty() {
        return Err(empty_set("split").at(&capture.dir));
    }
    let mut rendered: BTreeMap<_, _> = renders.views.iter().map(|view| (view.name.as_str(), view)).collect();
    let mut pairs = Vec::with_capacity(views.len());
    for view in views {
        let Some(render) = rendered.remove(view.name.as_str()) else {
            let message = format!("view {} of the capture was not rendered", view.name);
            return Err(Failure::new(FailureKind::BadInput, message).at(&renders.dir));
        };
        pairs.push(Pair {
            name: view.name.clone(),
            time_secs: Some(view.time_secs),
            camera_index: Some(view.camera_index),
            render: renders.image_path(render),
            truth: capture.dir.join(&view.image),
        });
    }
    match rendered.keys().next() {
        None => Ok(pairs),
        Some(name) => {
            let message = format!("rendered view {name} is not in the split of the capture");
            Err(Failure::new(FailureKind::BadInput, message).at(&renders.dir))
        }
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
        remarks,
    };
    Ok((scored, [render.width as u32, render.height as u32]))
}

/// Judges the surfaces of one image, as far as the capture knows them exactly.
fn add_surfaces(
    image: &mut ImageMetrics,
    renders: &Renders,
    capture: &Capture,
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    let view = capture.views.iter().find(|view| view.name == image.name);
    let rendered = renders.views.iter().find(|view| view.name == image.name);
    let (Some(view), Some(rendered)) = (view, rendered) else { return Ok(()) };
    if !params.metrics.iter().any(|metric| metric.is_of_surfaces()) {
        return Ok(());
    }
    let truths = Truths {
        depth: capture.load_depth(view)?,
        velocity: capture.load_velocity(view)?,
        flow: capture.load_flow(view)?,
    };
    if let Some(moving) = truths.moving() {
        add_moving(image, &moving, [renders.image_path(rendered), capture.dir.join(&view.image)], params)?;
    }
    if let Some(maps) = load_maps(renders, rendered, view)? {
        image.values.extend(judge_surfaces(&maps, &truths, &params.metrics));
    }
    Ok(())
}

/// Adds the error on moving surfaces of the render and the true image at `paths`.
fn add_moving(
    image: &mut ImageMetrics,
    moving: &[bool],
    paths: [PathBuf; 2],
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    let [render, truth] = paths.map(|path| Image::read(&path, params.quantise, None));
    let (score, error) = psnr_of_moving(&render?, &truth?, moving);
    image.moving = error;
    if params.metrics.contains(&Metric::PsnrMoving) {
        image.values.insert(Metric::PsnrMoving, score);
    }
    Ok(())
}

/// The surfaces that a render shows, of the view's size.
fn load_maps(
    renders: &Renders,
    rendered: &RenderedView,
    view: &View,
) -> anyhow::Result<Option<rendering::SurfaceMaps>> {
    let maps = renders.load_maps(rendered)?;
    let size = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    match maps {
        Some(maps) if (maps.width, maps.height) != size => {
            let message =
                format!("maps of {} are {}×{} px instead of {}×{}", view.name, maps.width, maps.height, size.0, size.1);
            Err(Failure::new(FailureKind::BadInput, message).at(&renders.dir).into())
        }
        maps => Ok(maps),
    }
}
