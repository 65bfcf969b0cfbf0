//! The two layers of a scene: their initial surfels and their tensors.

use engine::{Failure, FailureKind};
use glam::{DQuat, DVec3};
use scene::gaussians::SH_C0;
use scene::{DepthMap, LabelMap, facts};
use shaders::tape::{Real, Tensor};

use super::settings::{Settings, Switches};
use super::surfels::{DepthImage, Surfel, uncovered, without_duplicates, wxyz};
use crate::bases::gaussians::logit;
use crate::bases::primitives4d::{Moving, insert_moving};
use crate::bases::seeds::Seed;
use crate::data::{BackgroundView, Dataset, LoadedView, evenly_thinned};
use crate::effects::{BACKGROUND as BACKGROUND_PORT, PRIORS};
use crate::method::{Start, too_large};
use crate::methods::RequiredInput;
use crate::model::ModelState;

/// Population of the static layer.
pub(crate) const BACKGROUND: &str = "background";
/// Population of the moving layer, the 4D surfels.
pub(crate) const FOREGROUND: &str = "foreground";

/// The depth that places surfels.
pub(crate) const DEPTH: RequiredInput = RequiredInput {
    what: "depth",
    port: PRIORS,
    fact: facts::DEPTH,
    effect: None,
    hint: "wire a depth-flow-import job to the port priors, or add a recipe that does to `extends`: \"builtin:synthetic\", or \
           \"builtin:video\" for an import",
};
/// The depth that places surfels of inpainted images.
pub(crate) const INPAINTED_DEPTH: RequiredInput = RequiredInput {
    what: "the depth of inpainted images",
    port: BACKGROUND_PORT,
    fact: facts::DEPTH,
    effect: Some("inpainting"),
    hint: "wire a depth-flow-import job to the port priors of inpaint-import, or switch off \"inpainting\"",
};

/// [1]: units of time per clip in a model with seeds; not trained. In other models, a clip has
/// [`SceneFacts::unit_world`](crate::data::SceneFacts::unit_world) units.
pub(crate) const UNITS_PER_CLIP: &str = "clock.units_per_clip";

/// The share of seeds that move by at most one scene unit in a unit of time.
const FAST: f64 = 0.9;

/// Initial opacity of the surfels of pixels (Yu et al. 2025, WonderWorld).
const INITIAL_OPACITY: f64 = 0.15;

/// Surfels of the static layer: those of the first view, then from every view those that the previous views do not
/// cover.
pub(crate) fn background_surfels(
    start: &Start<'_>,
    settings: &Settings,
    switches: &Switches,
) -> anyhow::Result<Vec<Surfel>> {
    let (mut surfels, mut normals_hold): (Vec<Surfel>, bool) = (Vec::new(), false);
    for view in &start.dataset.train {
        let filled = if switches.inpainting { Some(filled_view(start, view)?) } else { None };
        let depth_image = depth_image(start, view, filled)?;
        normals_hold |= depth_image.normals_hold();
        let is_static = static_pixels(start, view, switches)?;
        let is_new = match surfels.is_empty() {
            true => vec![],
            false => uncovered(&surfels, &depth_image, start.scene()).map_err(too_large)?,
        };
        let wanted =
            |at: usize| is_static.as_ref().is_none_or(|mask| mask[at]) && is_new.get(at).is_none_or(|&new| new);
        surfels.extend(depth_image.surfels(view.time, settings.pixel_stride, wanted));
    }
    let surfels = thinned(without_duplicates(surfels), settings.max_count);
    if surfels.is_empty() {
        return Err(bad_input("no pixel is static", "check the port layers, or switch off \"layer-split\"").into());
    }
    if !normals_hold {
        let message =
            "the normals on the port priors hold in no pixel, because inpainted images have another depth everywhere";
        let hint = "wire the depth-flow-import job to the port priors of both inpaint-import and the training";
        return Err(bad_input(message, hint).into());
    }
    Ok(surfels)
}

/// Surfels of the moving layer from every view; each is born at its view's time and moves perpendicular to
/// the view's axis.
pub(crate) fn foreground_surfels(
    start: &Start<'_>,
    settings: &Settings,
    switches: &Switches,
) -> anyhow::Result<Vec<Surfel>> {
    let mut surfels = Vec::new();
    for view in &start.dataset.train {
        let depth_image = depth_image(start, view, None)?;
        let moving = if switches.layer_split { Some(moving_of(start, view)?) } else { None };
        let wanted = |at: usize| moving.is_none_or(|mask| mask.labels[at] != 0);
        surfels.extend(depth_image.surfels(view.time, settings.pixel_stride, wanted));
    }
    let surfels = thinned(surfels, settings.max_count);
    if surfels.is_empty() {
        return Err(bad_input("no pixel moves", "check the port layers, or switch off \"motion\"").into());
    }
    Ok(surfels)
}

/// At most `max_count` surfels, evenly chosen and widened to cover the same area.
fn thinned(surfels: Vec<Surfel>, max_count: usize) -> Vec<Surfel> {
    let factor = (surfels.len() as f64 / max_count as f64).max(1.0).sqrt();
    let mut kept = evenly_thinned(surfels, max_count);
    kept.iter_mut().for_each(|surfel| surfel.scales = surfel.scales.map(|scale| factor * scale));
    kept
}

/// Mask of the pixels of a view that show only the static layer; `None` for all pixels.
pub(crate) fn static_pixels(
    start: &Start<'_>,
    view: &LoadedView,
    switches: &Switches,
) -> anyhow::Result<Option<Vec<bool>>> {
    let is_zero = |map: &LabelMap| map.labels.iter().map(|&label| label == 0).collect();
    Ok(match (switches.inpainting, switches.layer_split) {
        (true, _) => Some(is_zero(&filled_view(start, view)?.unfilled)),
        (false, true) => Some(is_zero(moving_of(start, view)?)),
        (false, false) => None,
    })
}

/// The inpainted view, with moving objects removed.
pub(crate) fn filled_view<'a>(start: &Start<'a>, view: &LoadedView) -> anyhow::Result<&'a BackgroundView> {
    let found = start.supplements.background.get(view.index).and_then(Option::as_ref);
    let hint = "wire an inpaint-import job to the port background, or switch off \"inpainting\"";
    let filled = found.ok_or_else(|| missing("inpainted image", start.dataset, view, hint))?;
    check_size("inpainted image", filled.image.dimensions().into(), start.dataset, view)?;
    check_size("unfilled part", [filled.unfilled.width, filled.unfilled.height], start.dataset, view)?;
    if let Some(depth) = &filled.depth {
        check_size("inpainted depth", [depth.width, depth.height], start.dataset, view)?;
    }
    Ok(filled)
}

fn depth_of<'a>(start: &Start<'a>, view: &LoadedView) -> anyhow::Result<&'a DepthMap> {
    let found = start.supplements.view(view.index).and_then(|priors| priors.depth.as_ref());
    let depth = found.ok_or_else(|| missing(DEPTH.what, start.dataset, view, DEPTH.hint))?;
    check_size("depth", [depth.width, depth.height], start.dataset, view)?;
    Ok(depth)
}

fn moving_of<'a>(start: &Start<'a>, view: &LoadedView) -> anyhow::Result<&'a LabelMap> {
    let hint = "wire a layer-split job to the port layers, or switch off \"layer-split\"";
    let found = start.supplements.moving(view.index);
    let mask = found.ok_or_else(|| missing("moving part", start.dataset, view, hint))?;
    check_size("moving part", [mask.width, mask.height], start.dataset, view)?;
    Ok(mask)
}

fn check_size(what: &str, [width, height]: [u32; 2], dataset: &Dataset, view: &LoadedView) -> anyhow::Result<()> {
    let (found, expected) = ([width as usize, height as usize], [view.camera.width, view.camera.height]);
    if found != expected {
        let name = &dataset.capture.views[view.index].name;
        let message = format!("{what} of view {name} has {found:?} pixels, its image {expected:?}");
        return Err(bad_input(&message, "import both at one size").into());
    }
    Ok(())
}

/// The image of a view with its depth or, if `filled` is given, the inpainted image with the depth of the inpainted
/// image.
fn depth_image<'a>(
    start: &Start<'a>,
    view: &'a LoadedView,
    filled: Option<&'a BackgroundView>,
) -> anyhow::Result<DepthImage<'a>> {
    let own = depth_of(start, view)?;
    let lacks_depth = || missing("depth of the inpainted image", start.dataset, view, INPAINTED_DEPTH.hint);
    let (pixels, depth) = match filled {
        Some(filled) => (filled.image.as_raw(), filled.depth.as_ref().ok_or_else(lacks_depth)?),
        None => (&view.pixels, own),
    };
    let normals = start.supplements.view(view.index).and_then(|priors| priors.normals.as_ref());
    let normals = normals.map(|normals| (normals, own));
    Ok(DepthImage { camera: &start.dataset.capture.views[view.index].camera, pixels, depth, normals })
}

fn missing(what: &str, dataset: &Dataset, view: &LoadedView, hint: &str) -> Failure {
    bad_input(&format!("vcgs needs the {what} of view {}", dataset.capture.views[view.index].name), hint)
}

fn bad_input(message: &str, hint: &str) -> Failure {
    Failure::new(FailureKind::BadInput, message).hint(hint)
}

/// Adds the tensors of the static layer.
pub(crate) fn insert_background<T: Real>(state: &mut ModelState<T>, surfels: &[Surfel]) {
    insert_surfels(state, BACKGROUND, surfels, INITIAL_OPACITY);
    insert(state, BACKGROUND, "rotations", &[4], surfels, |surfel| wxyz(surfel.rotation).to_vec());
}

/// Adds the tensors of the moving layer; `deviation_time` is the initial standard deviation in time as a share of the clip,
/// which lasts `units_per_clip` units of time.
pub(crate) fn insert_foreground<T: Real>(
    state: &mut ModelState<T>,
    surfels: &[Surfel],
    deviation_time: f64,
    units_per_clip: f64,
) {
    insert_surfels(state, FOREGROUND, surfels, INITIAL_OPACITY);
    let mut insert = |attribute: &str, row: &[usize], values: &dyn Fn(&Surfel) -> Vec<f64>| {
        insert(state, FOREGROUND, attribute, row, surfels, values);
    };
    // Equal left and right quaternions rotate only space, so nothing moves initially.
    insert("rotations_left", &[4], &|surfel| wxyz(surfel.rotation).to_vec());
    insert("rotations_right", &[4], &|surfel| wxyz(surfel.rotation).to_vec());
    insert("log_scales_time", &[1], &|_| vec![(units_per_clip * deviation_time).ln()]);
    insert("times", &[1], &|surfel| vec![units_per_clip * surfel.birth_time]);
    insert("birth_axes", &[3], &|surfel| surfel.birth_axis.to_array().to_vec());
}

/// Adds the tensors of the moving layer from seeds: surfels that face the camera of their view and begin with a velocity.
///
/// Rotations in four dimensions mix lengths and times, so the unit of time is chosen such that most seeds ([`FAST`])
/// move by at most one scene unit in it, and that the median ratio of temporal to spatial standard deviation is at
/// least 2.
pub(crate) fn insert_seeds<T: Real>(state: &mut ModelState<T>, seeds: &[Seed], opacity: f64) -> anyhow::Result<()> {
    if seeds.is_empty() {
        return Err(bad_input("no pixel moves", "check the port layers, or switch off \"motion\"").into());
    }
    let surfel = |seed: &Seed| Surfel {
        position: seed.position,
        rotation: DQuat::from_rotation_arc(DVec3::Z, -seed.axis),
        scales: [seed.scale; 2],
        color: seed.color.map(|value| f64::from(value) / 255.0),
        birth_time: seed.life.birth(),
        birth_axis: seed.axis,
    };
    let surfels: Vec<Surfel> = seeds.iter().map(surfel).collect();
    insert_surfels(state, FOREGROUND, &surfels, opacity);
    insert(state, FOREGROUND, "birth_axes", &[3], &surfels, |surfel| surfel.birth_axis.to_array().to_vec());
    let units_per_clip = {
        let at = |share: f64, value: &dyn Fn(&Seed) -> f64| {
            let mut values: Vec<f64> = seeds.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            values[(share * (values.len() - 1) as f64) as usize]
        };
        let speed = at(FAST, &|seed| seed.mean_velocity().length());
        speed.max(2.0 * at(0.5, &|seed| seed.scale / seed.life.deviation()))
    };
    state.insert(UNITS_PER_CLIP, Tensor::from_vec([1], vec![T::from_f64(units_per_clip)]));
    let moving: Vec<Moving> = seeds.iter().map(|seed| seed.in_space_time(units_per_clip, -seed.axis)).collect();
    insert_moving(state, FOREGROUND, &moving);
    Ok(())
}

fn insert_surfels<T: Real>(state: &mut ModelState<T>, population: &str, surfels: &[Surfel], opacity: f64) {
    let mut insert = |attribute: &str, row: &[usize], values: &dyn Fn(&Surfel) -> Vec<f64>| {
        insert(state, population, attribute, row, surfels, values);
    };
    insert("positions", &[3], &|surfel| surfel.position.to_array().to_vec());
    insert("log_scales", &[2], &|surfel| surfel.scales.map(f64::ln).to_vec());
    insert("log_thicknesses", &[1], &|surfel| vec![surfel.thickness().ln()]);
    insert("opacity_logits", &[1], &|_| vec![logit(opacity)]);
    insert("sh_dc", &[1, 3], &|surfel| surfel.color.map(|value| (value - 0.5) / f64::from(SH_C0)).to_vec());
}

fn insert<T: Real>(
    state: &mut ModelState<T>,
    population: &str,
    attribute: &str,
    row: &[usize],
    surfels: &[Surfel],
    values: impl Fn(&Surfel) -> Vec<f64>,
) {
    let data = surfels.iter().flat_map(values).map(T::from_f64).collect();
    state.insert(format!("{population}.{attribute}"), Tensor::from_vec([&[surfels.len()], row].concat(), data));
}
