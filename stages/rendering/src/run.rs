//! The stage: renders the views of a capture from a trained model.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use captures::CaptureArtifact;
use engine::{Facts, Failure, FailureKind, JobContext, PlanContext, Port, Resources, Stage, Work};
use scene::{Capture, View, facts, image_file};
use shaders::arrays::bytes::Bytes;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Device;
use training::{Model, Player, compute_on, model_work};

use crate::artifact::{RenderedView, Renders};
use crate::delivery::deliver;
use crate::frame_rate::{self, FrameRate, FrameTimes};
use crate::params::{Maps, RenderingParams};
use crate::quantize::image_of;
use crate::semantics::semantics;
use crate::surfaces::surfaces;

/// The stage that renders views from a model and measures frame rates.
pub struct Rendering;

impl Stage for Rendering {
    type Params = RenderingParams;
    type Output = Renders;

    const ID: &'static str = "rendering";
    const ON_DEVICE: bool = true;
    const ABOUT: &'static str = "renders a capture's views from a trained model and measures frame rates";

    fn ports() -> Vec<Port> {
        vec![Port::one::<Model>("model"), Port::one::<CaptureArtifact>("capture")]
    }

    fn facts(params: &RenderingParams, _context: &PlanContext<'_>) -> Facts {
        let split = serde_json::to_value(params.split).expect("a name is JSON");
        Facts::default().with(facts::SPLIT, split)
    }

    fn work(params: &RenderingParams, context: &PlanContext<'_>) -> Option<Work> {
        model_work(context.facts("model")?, context.facts("capture")?, params.split)
    }

    fn resources(_params: &RenderingParams) -> Resources {
        Resources { threads: 0 }
    }

    fn run(context: &JobContext, params: &RenderingParams) -> anyhow::Result<Renders> {
        let mut model = context.input::<Model>("model")?;
        replace(&mut model, &params.tensors)?;
        let capture = context.input::<CaptureArtifact>("capture")?.0;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        let out = context.output_dir();
        let render_on = |device| pool.install(|| render(&model, &capture, params, device, out));
        let (renders, times) = compute_on(&context.device, render_on)?;
        let FrameTimes { raster_secs, motion_secs, delivered_secs } = times;
        let with_motion = raster_secs.iter().zip(&motion_secs).map(|(raster, motion)| raster + motion);
        context.measure("fps_model", FrameRate::of(with_motion))?;
        context.measure("fps_raster", FrameRate::of(raster_secs))?;
        context.measure("fps_delivered", FrameRate::of(delivered_secs))?;
        context.measure("resolution", [renders.protocol.width, renders.protocol.height])?;
        context.measure("device", Device::open(&context.device)?.name())?;
        context.measure("threads", pool.current_num_threads())?;
        Ok(renders)
    }
}

/// Replaces values of the model's tensors.
pub(crate) fn replace(model: &mut Model, tensors: &BTreeMap<String, Vec<f32>>) -> anyhow::Result<()> {
    for (name, values) in tensors {
        let bad = |message: String| Failure::new(FailureKind::BadInput, message);
        let Some(tensor) = model.tensors.get_mut(name) else {
            let names: Vec<&str> = model.tensors.keys().map(String::as_str).collect();
            let hint = format!("it has {}", names.join(", "));
            return Err(bad(format!("the model has no tensor `{name}`")).hint(hint).into());
        };
        if tensor.values.len() != values.len() {
            let counts = (tensor.values.len(), values.len());
            return Err(bad(format!("tensor `{name}` has {} values, not {}", counts.0, counts.1)).into());
        }
        tensor.values.clone_from(values);
    }
    Ok(())
}

/// Renders the views of a split into `out` and times frames of them.
pub(crate) fn render(
    model: &Model,
    capture: &Capture,
    params: &RenderingParams,
    device: Device,
    out: &Path,
) -> anyhow::Result<(Renders, FrameTimes)> {
    let player = Player::new(model)?.on(device);
    let views: Vec<&View> = capture.views_of(params.split).map(|(_, view)| view).collect();
    if views.is_empty() {
        let message = format!("capture {} has no {} views", capture.name, params.split.name());
        return Err(Failure::new(FailureKind::BadInput, message).at(&capture.dir).into());
    }
    std::fs::create_dir_all(out.join("images"))?;
    let start = |view: &&View| player.start_frame(view.time_secs, &PinholeCamera::from(&view.camera));
    let finish = |view: &View, frame| write_view(view, player.finish_frame(frame)?, out);
    let mut rendered = deliver(views.iter().copied(), start, |frame| frame.wait(), finish)?;
    for (view, rendered) in views.iter().zip(&mut rendered) {
        let knows_surfaces = view.depth.is_some() || view.velocity.is_some() || view.flow.is_some();
        if wanted(params.maps, knows_surfaces || view.mask.is_some()) {
            let file = map_file(out, "maps", view)?;
            surfaces(&player, view, capture.time_map.frame_secs)?.write(&out.join(&file))?;
            rendered.maps = Some(file);
        }
        let semantics = if wanted(params.maps, view.mask.is_some()) { semantics(&player, view)? } else { None };
        if let Some(semantics) = semantics {
            let file = map_file(out, "semantics", view)?;
            semantics.write(&out.join(&file))?;
            rendered.semantics = Some(file);
        }
    }
    let moments: Vec<_> = views.iter().map(|view| (view.time_secs, PinholeCamera::from(&view.camera))).collect();
    let times = frame_rate::measure(&player, &moments)?;
    let renders = Renders {
        dir: out.to_path_buf(),
        method: model.header.method.clone(),
        protocol: capture.protocol.clone(),
        split: params.split,
        prompts: player.prompt_names().to_vec(),
        views: rendered,
        n_gaussians: model.header.n_gaussians,
        model_size_bytes: model.size_bytes(),
    };
    renders.save(out)?;
    Ok((renders, times))
}

/// Whether to render the maps of a view, given whether their ground truth is known.
fn wanted(maps: Maps, is_known: bool) -> bool {
    match maps {
        Maps::Known => is_known,
        Maps::All => true,
        Maps::None => false,
    }
}

/// The file for maps of one kind, relative to `out`; its folder is created.
fn map_file(out: &Path, kind: &str, view: &View) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(out.join(kind))?;
    Ok(Path::new(kind).join(format!("{}.exr", view.name)))
}

/// Writes the image of a view, whose colours must be finite.
fn write_view(view: &View, colors: Bytes, out: &Path) -> anyhow::Result<RenderedView> {
    if !colors.are_finite {
        let message = format!("the render of view {} has non-finite values", view.name);
        return Err(Failure::new(FailureKind::Diverged, message).into());
    }
    let image = Path::new("images").join(format!("{}.png", view.name));
    image_file::write_rgb(&out.join(&image), &image_of(&PinholeCamera::from(&view.camera), colors.values))?;
    let View { name, camera_index, frame_index, time_secs, .. } = view.clone();
    Ok(RenderedView { name, camera_index, frame_index, time_secs, image, maps: None, semantics: None })
}
