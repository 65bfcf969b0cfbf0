//! The splats of both layers at a time.

use shaders::arrays::rows::{concat_columns, row_dot, scale_rows};
use shaders::pointwise::{add, scale, sub};
use shaders::rasteriser::slicing4d::SlicedVars;
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape, Var};

use super::layers::{BACKGROUND, FOREGROUND, UNITS_PER_CLIP};
use super::settings::{Settings, Switches};
use crate::bases::gaussians::static_splats;
use crate::bases::primitives4d;
use crate::method::Moment;
use crate::model::Variables;

/// The moving surfels at a time, placed by equations 2 to 6.
pub(crate) fn moving<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    moment: &Moment<'_>,
    settings: &Settings,
    switches: &Switches,
) -> (SplatVars, SlicedVars) {
    let var = |attribute: &str| model.get(&format!("{FOREGROUND}.{attribute}"));
    let log_scales = concat_columns(tape, &[var("log_scales"), var("log_thicknesses")]);
    let chosen = model.find(UNITS_PER_CLIP).map(|units| tape.value(units).as_slice()[0].to_f64());
    let time = chosen.unwrap_or(moment.scene.unit_world) * moment.time;
    let sliced = primitives4d::slice(tape, &primitives4d::parameters(model, FOREGROUND, log_scales), time);
    let mut positions = var("positions");
    if !settings.zero_offset {
        let mut displacements = sliced.displacements;
        if switches.constraint {
            displacements = within_view_plane(tape, displacements, var("birth_axes"), settings.depth_share);
        }
        positions = add(tape, positions, displacements);
    }
    let splats = SplatVars {
        positions,
        shape: ShapeVars::Factor(sliced.factors),
        opacity_logits: sliced.opacity_logits,
        sh: var("sh_dc"),
    };
    (splats, sliced)
}

/// The static layer, which does not depend on time.
pub(crate) fn static_layer<T: Real>(tape: &mut Tape<T>, model: &Variables) -> SplatVars {
    let Some(thicknesses) = model.find(&format!("{BACKGROUND}.log_thicknesses")) else {
        return static_splats(tape, model, BACKGROUND, 0);
    };
    let var = |attribute: &str| model.get(&format!("{BACKGROUND}.{attribute}"));
    let log_scales = concat_columns(tape, &[var("log_scales"), thicknesses]);
    SplatVars {
        positions: var("positions"),
        shape: ShapeVars::ScaleRotation { log_scales, rotations: var("rotations") },
        opacity_logits: var("opacity_logits"),
        sh: var("sh_dc"),
    }
}

/// Δ − (1 − ε)(n·Δ)n for displacements Δ [M, 3] and unit viewing directions n [M, 3]: equations 4 to 6 without the
/// translation, which displacements do not have.
pub(crate) fn within_view_plane<T: Real>(tape: &mut Tape<T>, displacements: Var, axes: Var, depth_share: f64) -> Var {
    let along = row_dot(tape, displacements, axes);
    let removed = scale_rows(tape, axes, along);
    let removed = scale(tape, removed, 1.0 - depth_share);
    sub(tape, displacements, removed)
}
