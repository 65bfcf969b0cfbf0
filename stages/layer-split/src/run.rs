//! The stage: one mask per view, from the best evidence available.

use captures::{CaptureArtifact, per_view, record_shift};
use depth_flow_import::Priors;
use engine::{
    Facts, Failure, FailureKind, JobContext, ParamProblem, PlanContext, Port, Resolution, Resources, Source, Stage,
};
use scene::{Capture, Mask, facts};

use crate::params::{LayerSource, Polarity};
use crate::{Layers, Params, from_files, median, offset, residual};

/// Name of the source folder of masks.
const FOLDER: &str = "folder";
/// The source of masks in files.
const FILES: &str = "files";
/// The source of masks that are part of the capture.
const MASKS: &str = "masks";

/// The stage `layer-split`.
pub struct LayerSplit;

impl Stage for LayerSplit {
    type Params = Params;
    type Output = Layers;

    const ID: &'static str = "layer-split";
    const ABOUT: &'static str =
        "masks the moving pixels of every view, from given masks, exact velocity, residual flow or temporal medians";

    fn ports() -> Vec<Port> {
        vec![Port::one::<CaptureArtifact>("capture"), Port::optional::<Priors>("priors")]
    }

    fn sources(params: &Params) -> Vec<Source> {
        match params.source {
            LayerSource::Files => vec![Source::required(FOLDER, params.folder.clone())],
            LayerSource::Auto | LayerSource::ResidualFlow | LayerSource::TemporalMedian => Vec::new(),
        }
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    /// Passes on whether anything moves in the capture.
    fn facts(_params: &Params, context: &PlanContext<'_>) -> Facts {
        let moving = context.facts("capture").and_then(|capture| capture.flag(facts::MOVING));
        moving.map_or_else(Facts::default, |moving| Facts::default().with(facts::MOVING, moving))
    }

    /// Priors are not read if the capture or the masks suffice.
    fn resolve(params: Params, context: &PlanContext<'_>) -> Result<Resolution<Params>, Vec<ParamProblem>> {
        let has = |fact| context.facts("capture").and_then(|capture| capture.flag(fact)) == Some(true);
        let decided = match params.source {
            LayerSource::Auto => has(facts::VELOCITY) || has(facts::MASKS),
            LayerSource::Files | LayerSource::TemporalMedian => true,
            LayerSource::ResidualFlow => false,
        };
        let unread = if decided { ["priors"].into() } else { Default::default() };
        Ok(Resolution { unread, ..Resolution::unchanged(params) })
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 } // views are independent
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<Layers> {
        let capture = context.input::<CaptureArtifact>("capture")?.0;
        let priors = context.optional_input::<Priors>("priors")?;
        if let Some(priors) = &priors {
            priors.check_against(&capture)?;
        }
        let (source, masks) = masks(context, &capture, priors.as_ref(), params)?;
        if [FILES, MASKS].contains(&source) {
            let measurement = "masks_fit_images_better_shifted_by_frames";
            record_shift(context, measurement, "masks fit the images", offset::of_masks(&capture, &masks)?)?;
        }
        let write = |index: usize| {
            let view = &capture.views[index];
            let size = (view.camera.intrinsics.width, view.camera.intrinsics.height);
            let labels = masks[index].as_ref().map(Mask::to_labels);
            Ok(Layers::write_view(context.output_dir(), &view.name, size, labels.as_ref())?)
        };
        let views = (0..masks.len()).map(write).collect::<anyhow::Result<_>>()?;
        let layers = Layers::save(context.output_dir(), source, views)?;
        let moving_share = layers.moving_share();
        if let Some(advice) = polarity_advice(moving_share, source, params.polarity) {
            tracing::warn!("{:.0} % of the pixels move: {advice}", 100.0 * moving_share);
        }
        context.measure("moving_share", moving_share)?;
        context.measure("views_without_a_mask", masks.iter().filter(|mask| mask.is_none()).count())?;
        Ok(layers)
    }
}

/// Share of moving pixels above which the polarity of masks is doubtful.
const MOSTLY_MOVING: f64 = 0.6;

/// What to do if the share of moving pixels makes the polarity of masks doubtful. A recipe may state that set pixels move.
pub(crate) fn polarity_advice(moving_share: f64, source: &str, polarity: Polarity) -> Option<&'static str> {
    let is_of_capture = source.ends_with(MASKS);
    if !(moving_share > MOSTLY_MOVING) || !(is_of_capture || source == FILES) {
        return None;
    }
    match polarity {
        Polarity::SetMoves => None,
        Polarity::SetRests if is_of_capture => Some(
            "if set pixels of the masks move, or if they are COLMAP's masks, which the import inverts, remove \
             polarity = \"set-rests\"",
        ),
        Polarity::SetRests => Some("if set pixels of the masks move, remove polarity = \"set-rests\""),
        Polarity::Auto if is_of_capture => Some(
            "if the masks of the capture mark what is static, invert their files; polarity = \"set-rests\" would leave the labels \
             that metrics read unchanged",
        ),
        Polarity::Auto => Some("if masks mark what is static (e.g. those of COLMAP), set polarity = \"set-rests\""),
    }
}

/// Computes the masks of all views, `None` for views without evidence, and names the source that decided.
fn masks(
    context: &JobContext,
    capture: &Capture,
    priors: Option<&Priors>,
    params: &Params,
) -> anyhow::Result<(&'static str, Vec<Option<Mask>>)> {
    let count = capture.views.len();
    let has_flow =
        priors.is_some_and(|priors| priors.views.iter().any(|view| view.flow.is_some() && view.depth.is_some()));
    let has_masks = capture.views.iter().any(|view| view.mask.is_some());
    let prior_velocity = |priors: &Priors| priors.views.iter().any(|view| view.velocity.is_some());
    let has_velocity = capture.views.iter().any(|view| view.velocity.is_some()) || priors.is_some_and(prior_velocity);
    let known = |index: usize| known_motion(capture, priors, index, params.polarity);
    match (params.source, has_velocity, has_masks, priors.filter(|_| has_flow)) {
        (LayerSource::Files, ..) => Ok((FILES, from_files::masks(context, context.source(FOLDER)?, capture, params)?)),
        (LayerSource::TemporalMedian, ..) => Ok(("temporal-median", median::masks(context, capture, params)?)),
        (LayerSource::Auto, true, true, _) => Ok(("velocity+masks", per_view(context, count, known)?)),
        (LayerSource::Auto, true, false, _) => Ok(("velocity", per_view(context, count, known)?)),
        (LayerSource::Auto, false, true, _) => {
            Ok((MASKS, from_files::checked(per_view(context, count, known)?, &capture.dir)?))
        }
        (_, _, _, Some(priors)) => Ok(("residual-flow", from_flow(context, capture, priors, params)?)),
        (_, _, _, None) => Err(no_evidence(params.source, capture).into()),
    }
}

/// The failure of a capture without any usable source.
fn no_evidence(source: LayerSource, capture: &Capture) -> Failure {
    let message = match source {
        LayerSource::ResidualFlow => "residual flow needs depth and flow",
        _ => "nothing determines what moves: no masks in the capture, no velocity, and no flow with depth",
    };
    let hint = "wire a depth-flow-import with depth and flow to the port priors, or set source = \"files\"";
    Failure::new(FailureKind::BadInput, message).hint(hint).at(&capture.dir)
}

/// The moving pixels according to exact velocity or to the mask of the capture, or to either if both exist.
fn known_motion(
    capture: &Capture,
    priors: Option<&Priors>,
    index: usize,
    polarity: Polarity,
) -> anyhow::Result<Option<Mask>> {
    let view = &capture.views[index];
    let velocity = match priors.map(|priors| priors.load_velocity(index)).transpose()?.flatten() {
        Some(velocity) => Some(velocity),
        None => capture.load_velocity(view)?,
    };
    let by_velocity = velocity.map(|map| Mask {
        width: map.width,
        height: map.height,
        inside: map.velocity_world.iter().map(|velocity| *velocity != [0.0; 3]).collect(),
    });
    let moves = |label: &u8| (*label != 0) == (polarity != Polarity::SetRests);
    let by_label = capture.load_mask(view)?.map(|map| Mask {
        width: map.width,
        height: map.height,
        inside: map.labels.iter().map(moves).collect(),
    });
    Ok(match (by_velocity, by_label) {
        (Some(velocity), Some(label)) => Some(velocity.or(&label)),
        (velocity, label) => velocity.or(label),
    })
}

/// Segments residual flow in every view that has flow and depth. A view without its own mask takes that of another
/// view, warped by the flow.
fn from_flow(
    context: &JobContext,
    capture: &Capture,
    priors: &Priors,
    params: &Params,
) -> anyhow::Result<Vec<Option<Mask>>> {
    let split = |index: usize| {
        let Some((flow, depth)) = priors.load_flow(index)?.zip(priors.load_depth(index)?) else { return Ok(None) };
        let mask = residual::moving(&flow, &depth, &capture.views[index].camera, params);
        let carried = flow.view_to.map(|to| (to, residual::carried(&mask, &flow)));
        Ok(Some((mask, carried)))
    };
    let found = per_view(context, capture.views.len(), split)?;
    let mut masks: Vec<Option<Mask>> = found.iter().map(|found| Some(found.as_ref()?.0.clone())).collect();
    for (to, mask) in found.into_iter().flatten().filter_map(|found| found.1) {
        masks[to].get_or_insert(mask);
    }
    Ok(masks)
}
