//! The stage: fills the moving pixels of every training view.

use captures::{CaptureArtifact, better_shift, per_view, record_shift};
use depth_flow_import::Priors;
use engine::{Facts, JobContext, ParamProblem, PlanContext, Port, Resources, Source, Stage};
use layer_split::Layers;
use scene::{Capture, Split, facts};

use crate::artifact::BackgroundView;
use crate::imported::Frames;
use crate::params::FillSource;
use crate::propagate;
use crate::static_view::StaticView;
use crate::{Background, FilledView, Params};

/// Name of the source folder of inpainted frames.
const FOLDER: &str = "folder";
/// Name of the source folder of their depth maps.
const DEPTH_FOLDER: &str = "depth_folder";

/// The stage `inpaint-import`.
pub struct InpaintImport;

impl Stage for InpaintImport {
    type Params = Params;
    type Output = Background;

    const ID: &'static str = "inpaint-import";
    const ABOUT: &'static str =
        "replaces moving pixels with the static scene behind them, from other views or inpainted frames";

    fn ports() -> Vec<Port> {
        vec![Port::one::<CaptureArtifact>("capture"), Port::one::<Layers>("layers"), Port::optional::<Priors>("priors")]
    }

    fn sources(params: &Params) -> Vec<Source> {
        if params.source == FillSource::Propagate {
            return Vec::new();
        }
        let frames = Source::required(FOLDER, params.folder.clone());
        let depths = params.depth_folder.iter().map(|path| Source::required(DEPTH_FOLDER, path.clone()));
        [frames].into_iter().chain(depths).collect()
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    /// Predicts whether the filled images have depth, which they have if the views have it, and passes on whether anything
    /// moves.
    fn facts(_params: &Params, context: &PlanContext<'_>) -> Facts {
        let known = |port: &str, fact| context.facts(port).and_then(|facts| facts.flag(fact));
        let depth = known(if context.is_wired("priors") { "priors" } else { "capture" }, facts::DEPTH);
        let facts = [(facts::DEPTH, depth), (facts::MOVING, known("layers", facts::MOVING))];
        let with = |known: Facts, (fact, flag): (&str, Option<bool>)| match flag {
            Some(flag) => known.with(fact, flag),
            None => known,
        };
        facts.into_iter().fold(Facts::default(), with)
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 } // views are independent
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<Background> {
        let capture = context.input::<CaptureArtifact>("capture")?.0;
        let layers = context.input::<Layers>("layers")?;
        layers.check_against(&capture)?;
        let priors = context.optional_input::<Priors>("priors")?;
        if let Some(priors) = &priors {
            priors.check_against(&capture)?;
        }
        // Views without a mask are neither sources nor filled.
        let has_mask = |index: &usize| layers.views[*index].moving.is_some();
        let views: Vec<usize> = capture.views_of(Split::Train).map(|(index, _)| index).filter(has_mask).collect();
        let load = |index: usize| StaticView::load(&capture, &layers, priors.as_ref(), index, params.margin_px);
        let source = match params.source {
            FillSource::Propagate => "propagate",
            FillSource::Files => "files",
        };
        let filled = match params.source {
            FillSource::Propagate => {
                let sources = spread(&views, params.max_sources).map(load).collect::<anyhow::Result<Vec<_>>>()?;
                let fill = |index: usize| Ok(propagate::fill(&load(index)?, &sources, &capture));
                write(context, &capture, &views, &fill)?
            }
            FillSource::Files => {
                let depths = params.depth_folder.as_ref().map(|_| context.source(DEPTH_FOLDER)).transpose()?;
                let frames = Frames::find(context.source(FOLDER)?, depths, &capture, params)?;
                let shift = better_shift(&capture, |view, file| match views.contains(&view) {
                    true => frames.misfit(&load(view)?, file),
                    false => Ok(None),
                })?;
                let measurement = "frames_fit_views_better_shifted_by_frames";
                record_shift(context, measurement, "inpainted frames fit the views", shift)?;
                let fill = |index: usize| frames.fill(index, &load(index)?);
                write(context, &capture, &views, &fill)?
            }
        };
        let background = Background::save(context.output_dir(), source, filled)?;
        context.measure("unfilled_share", background.unfilled_share())?;
        context.measure("filled_views", views.len())?;
        Ok(background)
    }
}

/// Writes every view of the capture; only `views` are filled.
fn write(
    context: &JobContext,
    capture: &Capture,
    views: &[usize],
    fill: &(dyn Fn(usize) -> anyhow::Result<FilledView> + Sync),
) -> anyhow::Result<Vec<BackgroundView>> {
    let dir = context.output_dir();
    per_view(context, capture.views.len(), |index| {
        let view = &capture.views[index];
        let size = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let filled = views.contains(&index).then(|| fill(index)).transpose()?;
        Ok(Background::write_view(dir, &view.name, size, filled.as_ref())?)
    })
}

/// At most `limit` of the views, evenly spaced.
fn spread(views: &[usize], limit: usize) -> impl Iterator<Item = usize> {
    let count = views.len().min(limit);
    (0..count).map(move |at| views[at * views.len() / count])
}
