//! The stage: samples particles from training views of a capture.

use std::path::Path;

use anyhow::Context as _;
use captures::CaptureArtifact;
use depth_flow_import::Priors;
use engine::{Failure, FailureKind, JobContext, ParamProblem, Port, Resources, Stage};
use glam::DVec3;
use rayon::prelude::*;
use scene::{Capture, PointCloud, Split};
use serde::Serialize;

use crate::artifact::CanonicalView;
use crate::maps::MotionView;
use crate::momentum::{momentum, surface_point};

use crate::{Instants, Params, Particles, sampling};

/// The stage `momentum-sampling`.
pub struct MomentumSampling;

impl Stage for MomentumSampling {
    type Params = Params;
    type Output = Particles;

    const ID: &'static str = "momentum-sampling";
    const ABOUT: &'static str = "samples particles where optical flow differs from the flow of a static scene";

    fn ports() -> Vec<Port> {
        vec![Port::one::<CaptureArtifact>("capture"), Port::one::<Priors>("priors")]
    }

    fn check_params(params: &Params) -> Vec<ParamProblem> {
        params.problems()
    }

    fn resources(_params: &Params) -> Resources {
        Resources { threads: 0 } // views of a rig are independent
    }

    fn run(context: &JobContext, params: &Params) -> anyhow::Result<Particles> {
        let capture = context.input::<CaptureArtifact>("capture")?.0;
        let priors = context.input::<Priors>("priors")?;
        let dir = context.output_dir();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        let sampled = pool.install(|| sample(&capture, &priors, params, dir))?;
        context.measure("particles", sampled.particles.count)?;
        context.measure("moving", sampled.moving)?;
        Ok(sampled.particles)
    }
}

/// Sampled particles, and how well they cover moving surfaces.
pub(crate) struct Sampled {
    /// The written artifact.
    pub(crate) particles: Particles,
    /// Shares of moving pixels, if the capture has velocity or instance labels.
    pub(crate) moving: Option<MovingShares>,
}

/// Share of moving pixels among the candidates and among the particles, both in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct MovingShares {
    /// Share of the pixels with depth in the canonical views.
    pub(crate) of_area: f64,
    /// Share of the particles.
    pub(crate) of_particles: f64,
}

/// A pixel that may become a particle.
struct Candidate {
    /// Index within the canonical views.
    view: usize,
    position_world: DVec3,
    color: [u8; 3],
    squared_norm: f64,
    moves: Option<bool>,
}

/// Samples particles from the training views of the chosen instants ([`Params::instants`]), with the depth and flow of
/// `priors`, and writes them into the folder `dir`.
pub(crate) fn sample(capture: &Capture, priors: &Priors, params: &Params, dir: &Path) -> anyhow::Result<Sampled> {
    priors.check_against(capture)?;
    let (start_secs, canonical) = canonical_views(capture, params.instants)?;
    let found: Vec<(Vec<Candidate>, Vec<usize>)> =
        canonical.par_iter().map(|&index| candidates(capture, priors, index, params)).collect::<anyhow::Result<_>>()?;
    let mut strides: Vec<usize> = found.iter().flat_map(|(_, strides)| strides.iter().copied()).collect();
    strides.sort_unstable();
    strides.dedup();
    let in_view = |(view, (some, _)): (usize, (Vec<Candidate>, Vec<usize>))| {
        some.into_iter().map(move |it| Candidate { view, ..it })
    };
    // A view without flow does not reveal motion.
    let with_flow = found.into_iter().enumerate().filter(|(_, (_, strides))| !strides.is_empty());
    let candidates: Vec<Candidate> = with_flow.flat_map(in_view).collect();
    if strides.is_empty() || candidates.is_empty() {
        let names: Vec<_> = canonical.iter().map(|index| capture.views[*index].name.as_str()).collect();
        let message = format!("no pixel of {} has both depth and flow", names.join(", "));
        return Err(Failure::new(FailureKind::BadInput, message)
            .hint("momentum sampling requires both in a view that it samples from")
            .into());
    }
    let energies = sampling::energies(&candidates.iter().map(|it| it.squared_norm).collect::<Vec<_>>());
    if energies.iter().all(|energy| *energy == 0.0) {
        tracing::warn!("nothing moves in the sampled views; sampling particles uniformly");
    }
    let order = sampling::draw_order(&energies, params.energy_weight, params.seed);
    let share = params.pixel_share * candidates.len() as f64;
    let count = params.count.min(share.round().max(1.0) as usize);
    let voxel_size = params.voxel_size * capture.scale().unit;
    let drawn = sampling::one_per_voxel(&order, |at| candidates[at].position_world, voxel_size, count);
    let canonical_view = |(view, index): (usize, &usize)| CanonicalView {
        index: *index,
        name: capture.views[*index].name.clone(),
        particles: drawn.iter().filter(|at| candidates[**at].view == view).count(),
    };
    let particles = Particles {
        dir: dir.into(),
        count: drawn.len(),
        canonical_time_secs: start_secs,
        canonical_views: canonical.iter().enumerate().map(canonical_view).collect(),
        strides,
    };
    let points = PointCloud {
        positions: drawn.iter().map(|at| candidates[*at].position_world.as_vec3().to_array()).collect(),
        colors: drawn.iter().map(|at| candidates[*at].color).collect(),
    };
    let drawn_energies: Vec<f32> = drawn.iter().map(|at| energies[*at] as f32).collect();
    particles.save(&points, &drawn_energies)?;
    Ok(Sampled { particles, moving: moving_shares(&candidates, &drawn) })
}

/// The training views of the chosen instants, and the time of the first.
fn canonical_views(capture: &Capture, instants: Instants) -> anyhow::Result<(f64, Vec<usize>)> {
    // Views are ordered by time within a split.
    let training: Vec<_> = capture.views_of(Split::Train).collect();
    let (_, first) = training.first().context("the capture has no training view")?;
    let alone = training.windows(2).all(|pair| pair[0].1.time_secs < pair[1].1.time_secs);
    let all = instants == Instants::All || instants == Instants::Auto && alone;
    let chosen = training.iter().filter(|(_, view)| all || view.time_secs == first.time_secs);
    Ok((first.time_secs, chosen.map(|(index, _)| *index).collect()))
}

/// The candidate pixels of one view, and the strides of their momentum.
fn candidates(
    capture: &Capture,
    priors: &Priors,
    index: usize,
    params: &Params,
) -> anyhow::Result<(Vec<Candidate>, Vec<usize>)> {
    let load = |index: usize| Ok(MotionView::load(priors, index)?);
    let view = load(index)?;
    let momentum = momentum(&view, params, &load)?;
    let image = capture.load_image(&capture.views[index])?;
    let moves = moving_pixels(capture, index)?;
    let candidate = |(pixel, squared_norm): (usize, &Option<f64>)| {
        let [red, green, blue] = image.as_raw()[3 * pixel..][..3] else { unreachable!("three channels") };
        Some(Candidate {
            view: 0,
            position_world: surface_point(&view, pixel)?,
            color: [red, green, blue],
            squared_norm: (*squared_norm)?,
            moves: moves.as_ref().map(|moves| moves[pixel]),
        })
    };
    Ok((momentum.squared_norm.iter().enumerate().filter_map(candidate).collect(), momentum.strides))
}

/// Whether each pixel of a view moves, from velocity or otherwise from instance labels; `None` if the view has neither.
fn moving_pixels(capture: &Capture, index: usize) -> anyhow::Result<Option<Vec<bool>>> {
    let view = &capture.views[index];
    if let Some(velocity) = capture.load_velocity(view)? {
        return Ok(Some(velocity.velocity_world.iter().map(|velocity| *velocity != [0.0; 3]).collect()));
    }
    let mask = capture.load_mask(view)?;
    Ok(mask.map(|mask| mask.labels.iter().map(|label| *label != 0).collect()))
}

/// Shares of moving pixels; `None` unless motion is known for every candidate.
fn moving_shares(candidates: &[Candidate], drawn: &[usize]) -> Option<MovingShares> {
    let all = candidates.iter().map(|candidate| candidate.moves).collect::<Option<Vec<_>>>()?;
    let share = |moving: usize, total: usize| moving as f64 / total as f64;
    Some(MovingShares {
        of_area: share(all.iter().filter(|moves| **moves).count(), all.len()),
        of_particles: share(drawn.iter().filter(|at| all[**at]).count(), drawn.len()),
    })
}
