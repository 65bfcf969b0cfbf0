//! The stage: reads, aligns and checks maps, and writes them in one format.

use captures::{CaptureArtifact, per_view, record_shift};
use engine::{Facts, Failure, FailureKind, JobContext, ParamProblem, PlanContext, Port, Resources, Source, Stage};
use scene::Capture;
use scene::statistics::median;

use crate::artifact::SPARSE_POINTS;
use crate::from_capture;
use crate::from_files::{Direction, Files, Outcome, Still};
use crate::from_points;
use crate::offset;
use crate::params::MapSource;
use crate::{Params, PriorView, Priors, ViewMaps, facts};

/// Name of the source folder of maps.
const FOLDER: &str = "folder";

/// The stage `depth-flow-import`.
pub struct DepthFlowImport;

impl Stage for DepthFlowImport {
    type Params = Params;
    type Output = Priors;

    const ID: &'static str = "depth-flow-import";
    const ABOUT: &'static str =
        "imports depth, optical flow and normals, aligned with a capture and checked against it";

    fn ports() -> Vec<Port> {
        vec![Port::one::<CaptureArtifact>("capture")]
    }

    fn sources(params: &Params) -> Vec<Source> {
        match params.source {
            MapSource::Capture | MapSource::SparsePoints => Vec::new(),
            MapSource::Files => vec![Source::required(FOLDER, params.folder.clone())],
        }
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn facts(params: &Params, context: &PlanContext<'_>) -> Facts {
        facts::of_priors(params, context)
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 } // views are independent
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<Priors> {
        let capture = context.input::<CaptureArtifact>("capture")?.0;
        match params.source {
            MapSource::Capture => {
                let maps = |index: usize| {
                    Ok((from_capture::maps(&capture, &capture.views[index], params)?, Outcome::default()))
                };
                let (views, _) = write_views(context, &capture, maps)?;
                check_not_empty(&views, &capture)?;
                Ok(Priors::save(context.output_dir(), "capture", views)?)
            }
            MapSource::SparsePoints => {
                let points = from_points::points(&capture)?;
                let maps = |index: usize| {
                    let depth = from_points::depth_view(&points, &capture.views[index].camera);
                    Ok((ViewMaps { depth, ..ViewMaps::default() }, Outcome::default()))
                };
                let (views, _) = write_views(context, &capture, maps)?;
                check_not_empty(&views, &capture)?;
                Ok(Priors::save(context.output_dir(), SPARSE_POINTS, views)?)
            }
            MapSource::Files => {
                let files = Files::find(context.source(FOLDER)?, &capture, params)?;
                let (views, outcomes) = write_views(context, &capture, |index| files.maps(index))?;
                measure(context, &outcomes, files.unused())?;
                judge_names(context, &files)?;
                let source = if files.interpolates() { format!("files+{SPARSE_POINTS}") } else { "files".into() };
                Ok(Priors::save(context.output_dir(), &source, views)?)
            }
        }
    }
}

/// Warns of maps that fit a neighbouring frame clearly better than the frame that their name states.
fn judge_names(context: &JobContext, files: &Files<'_>) -> anyhow::Result<()> {
    let record = |fit: &str, shift| {
        record_shift(context, &format!("{}_better_shifted_by_frames", fit.replace(' ', "_")), fit, shift)
    };
    record("flow fits images", offset::of_flow(files, Direction::Forward)?)?;
    record("backward flow fits images", offset::of_flow(files, Direction::Backward)?)?;
    match files.has_points() {
        true => record("depth fits points", offset::of_depth(files)?)?,
        false => record("depth fits images", offset::of_changes(files, Still::Depth)?)?,
    }
    record("normals fit images", offset::of_changes(files, Still::Normals)?)
}

/// Computes and writes the maps of every view.
fn write_views(
    context: &JobContext,
    capture: &Capture,
    maps: impl Fn(usize) -> anyhow::Result<(ViewMaps, Outcome)> + Sync,
) -> anyhow::Result<(Vec<PriorView>, Vec<Outcome>)> {
    let dir = context.output_dir();
    let write = |index: usize| {
        let (view, (maps, outcome)) = (&capture.views[index], maps(index)?);
        Ok((Priors::write_view(dir, &view.name, view.camera, &maps)?, outcome))
    };
    Ok(per_view(context, capture.views.len(), write)?.into_iter().unzip())
}

/// Fails if no view has depth or flow.
fn check_not_empty(views: &[PriorView], capture: &Capture) -> anyhow::Result<()> {
    let any = views.iter().any(|view| view.depth.is_some() || view.flow.is_some());
    if any {
        return Ok(());
    }
    let hint =
        "enable `truths` in scene-synthesis to write them, or set source = \"files\" to import an estimator's output";
    Err(Failure::new(FailureKind::BadInput, "the capture has no depth and no flow").hint(hint).at(&capture.dir).into())
}

/// Records the quality of the import; fails if every flow map is zero.
fn measure(context: &JobContext, outcomes: &[Outcome], unused: usize) -> anyhow::Result<()> {
    let middle = |values: Vec<f64>| median(values.into_iter());
    let count = |test: fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| test(outcome)).count();
    let fits = || outcomes.iter().filter_map(|outcome| outcome.fit);
    context.measure("files_without_a_view", unused)?;
    context.measure("flow_kept_share_median", middle(outcomes.iter().filter_map(|o| o.flow_kept).collect()))?;
    context.measure("flow_maps_that_lead_to_no_training_view", count(|outcome| outcome.flow_leads_nowhere))?;
    context.measure("flow_maps_that_are_zero", count(|outcome| outcome.flow_is_zero))?;
    context.measure("alignment_scale_median", middle(fits().map(|fit| fit.scale).collect()))?;
    context.measure("alignment_inlier_share_min", fits().map(|fit| fit.inlier_share).min_by(f64::total_cmp))?;
    let maps = count(|outcome| outcome.flow_kept.is_some());
    if maps > 0 && count(|outcome| outcome.flow_is_zero) == maps {
        let failure = Failure::new(FailureKind::BadInput, "every flow map is zero everywhere");
        return Err(failure.hint("check the output of the flow estimator").into());
    }
    Ok(())
}
