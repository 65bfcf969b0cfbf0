//! The stage: reads a capture, and either refuses it or converts its images.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use captures::{CaptureArtifact, video};
use engine::{
    Facts, Failure, FailureKind, JobContext, ParamProblem, PlanContext, Port, Progress, Resolution, Resources, Source,
    Stage, Work,
};
use image::DynamicImage;
use rayon::prelude::*;
use scene::float_image::{FloatImage, ResizeFilter};
use scene::mask_file::MaskValues;
use scene::protocol::Preset;
use scene::{Camera, Capture, CaptureInfo, CaptureWriter, PointCloud, Protocol};

use crate::cloud_file::CloudSource;
use crate::error::{Result, bad};
use crate::facts;
use crate::files;
use crate::frame_image::for_each_image;
use crate::mask_polarity::SetPixels;
use crate::params::{Params, Resize};
use crate::pixels::{self, Labels};
use crate::recognise::read;
use crate::source::{Frame, SourceCapture};
use crate::triangulate::{Triangulation, triangulate};

/// The engine's name for the capture's folder.
const SOURCE: &str = "source";

/// The stage that imports captures.
pub struct SfmImport;

impl Stage for SfmImport {
    type Params = Params;
    type Output = CaptureArtifact;

    const ID: &'static str = "sfm-import";
    const ABOUT: &'static str = "imports a capture with known poses: D-NeRF/Blender, nerfstudio, COLMAP, TUM RGB-D, ScanNet, VGGT, MegaSaM, MonST3R, Nerfies/HyperNeRF/DyCheck, LLFF, or a rig (Neural 3D Video, Immersive Light Field Video, EasyVolcap, CMU Panoptic, Technicolor)";

    fn ports() -> Vec<Port> {
        Vec::new()
    }

    fn sources(params: &Params) -> Vec<Source> {
        vec![Source::required(SOURCE, params.source.clone())]
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn facts(params: &Params, context: &PlanContext<'_>) -> Facts {
        facts::of_capture(&context.data_root.join(&params.source), params)
    }

    /// Refuses a width that would enlarge the images, where the capture's files state their size.
    fn resolve(
        params: Params,
        context: &PlanContext<'_>,
    ) -> std::result::Result<Resolution<Params>, Vec<ParamProblem>> {
        let native = params.width.and_then(|_| facts::native_size(&context.data_root.join(&params.source), &params));
        match native.map(|native| facts::target_size(native, params.width)) {
            Some(Err(Failure { message, hint, .. })) => Err(vec![ParamProblem { key: "width".into(), message, hint }]),
            _ => Ok(Resolution::unchanged(params)),
        }
    }

    fn work(params: &Params, context: &PlanContext<'_>) -> Option<Work> {
        facts::work(&context.data_root.join(&params.source), params)
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 } // image decoding dominates and scales with threads
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<CaptureArtifact> {
        let mut source = read(context.source(SOURCE)?, params)?;
        refuse(&source)?;
        if source.frames.iter().any(|frame| frame.in_video().is_some()) {
            context.measure("decoder", video::version()?)?;
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        let (on_progress, stop, output_dir) = (&context.on_progress, &context.stop, context.output_dir());
        let frames = source.frames.len() as u64;
        let on_searched = |searched, views| {
            let message = format!("points of the first instant, {searched} of {views} views");
            on_progress(Progress { done: 0, total: frames, message });
            if stop.load(Ordering::Relaxed) { Err(stopped().into()) } else { Ok(()) }
        };
        let triangulation = pool.install(|| search_points(&mut source, &on_searched))?;
        context.measure("triangulation", triangulation)?;
        let labels = pool.install(|| read_labels(&mut source))?;
        for warning in &source.warnings {
            tracing::warn!("{}: {warning}", source.name);
        }
        context.measure("warnings", &source.warnings)?;
        context.measure("structure_from_motion", source.quality)?;
        let on_view = |done: u64, total: u64| {
            on_progress(Progress { done, total, message: "images".into() });
            !stop.load(Ordering::Relaxed)
        };
        let capture = pool.install(|| convert(&source, labels, params, output_dir, &on_view))?;
        Ok(CaptureArtifact(capture))
    }
}

/// Imports the capture in `dir` into the folder `output_dir`, without a job.
pub fn import(dir: &Path, params: &Params, output_dir: &Path) -> anyhow::Result<Capture> {
    let mut source = read(dir, params)?;
    refuse(&source)?;
    search_points(&mut source, &|_, _| Ok(()))?;
    let labels = read_labels(&mut source)?;
    convert(&source, labels, params, output_dir, &|_, _| true)
}

/// Adds triangulated points if the capture needs them, and returns a measure of their fit. `on_view` may end the search.
fn search_points(
    source: &mut SourceCapture,
    on_view: &(dyn Fn(usize, usize) -> anyhow::Result<()> + Sync),
) -> anyhow::Result<Option<Triangulation>> {
    let Some(CloudSource::Sweep(depth_view)) = source.cloud else { return Ok(None) };
    let found = triangulate(&source.frames, depth_view, on_view)?;
    let (points, triangulation) = found.map_or((Vec::new(), None), |(points, how)| (points, Some(how)));
    if points.is_empty() {
        source.warnings.push(
            "no points were found in the training views of the first instant: initial points will be random".into(),
        );
    }
    source.points.extend(points);
    Ok(triangulation)
}

/// The labels that the values of all masks stand for. Adds a warning if they mark nothing.
fn read_labels(source: &mut SourceCapture) -> Result<Labels> {
    let masks = source.frames.par_iter().filter_map(|frame| frame.mask.as_deref());
    let values = masks.map(pixels::mask_values).try_reduce(MaskValues::default, |all, more| Ok(all.and(more)))?;
    let has_masks = !values.levels.is_empty();
    let labels = match source.set_pixels {
        SetPixels::Static => Labels::of_static_values(&values),
        _ => Labels::of_values(&values),
    };
    if has_masks && labels.class_names.is_empty() {
        let example = source.frames.iter().find_map(|frame| frame.mask.as_deref()).map(files::name);
        source.warnings.push(format!(
            "all masks are empty, e.g. {}: no pixel has a label, so that nothing moves for layer-split and no metric measures the \
             subject",
            example.unwrap_or_default()
        ));
    }
    Ok(labels)
}

/// Fails with the first problem and the number of other problems.
fn refuse(source: &SourceCapture) -> Result<()> {
    let mut problems = source.problems();
    if problems.is_empty() {
        return Ok(());
    }
    let others = problems.len() - 1;
    let mut first = problems.swap_remove(0);
    if others > 0 {
        first.message = format!("{} (and {others} more; `pipeline inspect` lists all problems)", first.message);
    }
    Err(first)
}

/// Writes all views and points. It stops as soon as `on_view(done, total)` returns false.
fn convert(
    source: &SourceCapture,
    labels: Labels,
    params: &Params,
    output_dir: &Path,
    on_view: &(dyn Fn(u64, u64) -> bool + Sync),
) -> anyhow::Result<Capture> {
    let conversion = Conversion::plan(source, labels, params)?;
    let info = conversion.info(source, params);
    check_protocol(&info.protocol, params)?;
    let mut writer = CaptureWriter::create(output_dir, info).map_err(not_written)?;
    if !source.points.is_empty() {
        let positions = source.points.iter().map(|(position, _)| position.map(|value| value as f32)).collect();
        let colors = source.points.iter().map(|(_, rgb)| *rgb).collect();
        writer.write_points(&PointCloud { positions, colors }).map_err(not_written)?;
    }
    let (done, total, is_visible) = (AtomicU64::new(0), source.frames.len() as u64, AtomicBool::new(false));
    let frames: Vec<&Frame> = source.frames.iter().collect();
    for_each_image(&frames, |frame, image| {
        let view = conversion.view(frame, image)?;
        if view.alpha.as_ref().is_none_or(|alpha| alpha.as_raw().iter().any(|alpha| *alpha > 0)) {
            is_visible.store(true, Ordering::Relaxed);
        }
        writer.write_view(&view).map_err(not_written)?;
        let go_on = on_view(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        if go_on { Ok(()) } else { Err(stopped().into()) }
    })?;
    if !is_visible.into_inner() {
        let hint = "check the alpha channel, e.g. of a matte that failed; images without one are opaque";
        return Err(bad(format!("all {total} images are fully transparent")).hint(hint).into());
    }
    Ok(writer.finish()?)
}

fn stopped() -> Failure {
    Failure::new(FailureKind::Interrupted, "stopped on request")
}

/// Refuses a capture whose protocol differs from the one that the recipe names.
fn check_protocol(protocol: &Protocol, params: &Params) -> Result<()> {
    let Some(preset) = Preset::named(&params.protocol) else { return Ok(()) };
    let differences = protocol.differences(&preset.protocol());
    if differences.is_empty() {
        return Ok(());
    }
    let message = format!("the capture does not have the protocol {}: {}", preset.name, differences.join(", "));
    Err(bad(message).hint("change width, resize, background, test_split or protocol"))
}

/// Classifies a failed write as a failure of the machine, because the input has been checked.
fn not_written(error: scene::Error) -> Failure {
    let cause = error.source.map(|cause| format!(" ({cause})")).unwrap_or_default();
    let message = format!("{}{cause}", error.message);
    Failure { kind: FailureKind::World, message, hint: error.hint, path: error.path }
}

/// The settings that all images of a capture share.
struct Conversion {
    native: (u32, u32),
    size: (u32, u32),
    filter: Resize,
    background: [f32; 3],
    any_alpha: bool,
    labels: Labels,
}

impl Conversion {
    fn plan(source: &SourceCapture, labels: Labels, params: &Params) -> Result<Self> {
        let first = source.frames.first().ok_or_else(|| bad("the capture has no frames"))?;
        let native = (first.lens.intrinsics.width, first.lens.intrinsics.height);
        let size = facts::target_size(native, params.width)?;
        let alphas = source.frames.par_iter().map(Frame::has_alpha);
        let any_alpha = alphas.collect::<Result<Vec<_>>>()?.contains(&true);
        Ok(Self { native, size, filter: params.filter(), background: params.background.rgb(), any_alpha, labels })
    }

    fn info(&self, source: &SourceCapture, params: &Params) -> CaptureInfo {
        let resize = match (self.size == self.native, self.filter) {
            (true, _) => "none",
            (false, Resize::Area) => "area",
            (false, Resize::Lanczos3) => "lanczos3",
        };
        CaptureInfo {
            name: source.name.clone(),
            pose_source: source.format.name().into(),
            protocol: Protocol {
                dataset: source.dataset.into(),
                split: source.split_rule.clone(),
                width: self.size.0,
                height: self.size.1,
                resize: resize.into(),
                background: if self.any_alpha { params.background.name() } else { "none" }.into(),
                time: source.time_rule.clone(),
            },
            background: self.background,
            time_map: source.time_map,
            class_names: self.labels.class_names.clone(),
            bounds_world: source.bounds_world(),
        }
    }

    /// Converts one image: composites and rounds at native size, undistorts, resizes, and rounds again.
    fn view(&self, frame: &Frame, image: DynamicImage) -> Result<scene::Frame> {
        let native = frame.camera()?;
        let (width, height) = self.size;
        let (image, alpha) = pixels::composited(image, self.background).map_err(|failure| failure.at(&frame.image))?;
        let filter = match self.filter {
            Resize::Area => ResizeFilter::Area,
            Resize::Lanczos3 => ResizeFilter::Lanczos3,
        };
        let finish = |image: FloatImage| {
            pixels::undistorted(image, &frame.lens, &native.intrinsics).resized(width, height, filter)
        };
        let blame = |error: scene::Error| bad(error.message).at(&frame.image);
        let mask = frame.mask.as_ref();
        let mask = mask.map(|path| self.labels.read(path, &frame.lens, &native.intrinsics, self.size));
        let depth = frame.depth.as_ref();
        let depth = depth.map(|file| file.read(&frame.lens, &native.intrinsics, self.size));
        Ok(scene::Frame {
            name: frame.name.clone(),
            split: frame.split,
            camera: if self.size == self.native { native } else { Camera::resized(&native, width, height) },
            camera_index: frame.camera_index,
            frame_index: frame.frame_index,
            time_secs: frame.time_secs,
            image: finish(image).to_rgb8().map_err(blame)?,
            alpha: alpha.map(|alpha| finish(alpha).to_grey8()).transpose().map_err(blame)?,
            depth: depth.transpose()?,
            flow: None,
            mask: mask.transpose()?,
            velocity: None,
        })
    }
}
