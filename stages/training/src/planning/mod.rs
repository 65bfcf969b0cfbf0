//! Decisions about a training while its recipe is planned: its effects, the optional inputs that they read, and the
//! shared phase that it can continue from.

mod coarse;
#[cfg(test)]
mod tests;
mod work;

use std::collections::BTreeMap;
use std::path::Path;

use engine::{Decision, Facts, ParamProblem, PlanContext, Resolution};
use scene::Capture;
use serde_json::Value;

use crate::data::facts_of;
use crate::effects::{CAPTURE, Choice, Effects, NOTHING_LEFT_OUT, VIEW_DEPENDENT_COLOR, known_inputs};
use crate::methods;
use crate::params::TrainingParams;

pub(crate) use coarse::check_start;
pub use work::model_work;
pub(crate) use work::training_work;

/// The port of the model that a training continues.
pub(crate) const START: &str = "start";

/// Resolves the effects of a training to an explicit list, which is part of its key.
pub(crate) fn resolve(
    mut params: TrainingParams,
    context: &PlanContext<'_>,
) -> Result<Resolution<TrainingParams>, Vec<ParamProblem>> {
    let mut effects = params.registration().effects();
    let constant_color = without_harmonics(&params)?;
    if constant_color.is_some() {
        effects.retain(|effect| effect.name != VIEW_DEPENDENT_COLOR.name);
    }
    let shares_phase = coarse::offered(&params).is_some();
    if shares_phase {
        // Effects of later phases are dropped, and with them their inputs.
        effects.retain(|effect| effect.name == VIEW_DEPENDENT_COLOR.name);
        params.shared.effects = params.shared.effects.among(&effects);
    }
    let known = known_inputs(context);
    let mut choice = params.shared.effects.choose(&effects, &known)?;
    let repeats = repeats_the_whole(&params, &choice);
    if choice.on.contains(&params.shared.without) {
        let left_out = std::mem::replace(&mut params.shared.without, NOTHING_LEFT_OUT.into());
        choice = choice.without(&left_out, &effects, &known)?;
    }
    if !choice.on.contains(VIEW_DEPENDENT_COLOR.name) {
        params.shared.harmonics.degree = 0;
    }
    params.shared.effects = Effects::Named(choice.on);
    let mut decisions = choice.decisions;
    if shares_phase {
        params = without_the_rest(params);
    }
    let (start, sharing) = chosen_start(&params, context);
    decisions.extend(constant_color.into_iter().chain(sharing));
    let chosen = start.map(|start| (START, start)).into_iter().collect();
    Ok(Resolution { params, unread: choice.unread, chosen, decisions, repeats })
}

/// Why a training that leaves something out would equal the whole training; `None` if it does not.
fn repeats_the_whole(params: &TrainingParams, choice: &Choice) -> Option<String> {
    let without = params.shared.without.as_str();
    let losses = params.registration().losses;
    let acts = || losses.iter().any(|loss| loss.name == without && choice.has_loss(loss));
    let is_whole = without == NOTHING_LEFT_OUT || choice.on.contains(without) || acts();
    (!is_whole).then(|| format!("the method has no part {without}"))
}

/// The parameters of a shared phase without those that only later phases read, so a change of these does not retrain
/// it.
fn without_the_rest(params: TrainingParams) -> TrainingParams {
    let Ok(defaults) = TrainingParams::of(&params.method) else { return params };
    let mut lean = TrainingParams { settings: defaults.settings, ..params.clone() };
    for (phase, steps) in &mut lean.shared.iterations {
        if Some(phase) != lean.shared.stop_after.as_ref() {
            *steps = defaults.shared.iterations.get(phase).copied().unwrap_or(*steps);
        }
    }
    // The phase may depend on some of the method's own settings; then none of them are dropped.
    if coarse::recipe(&lean) == coarse::recipe(&params) { lean } else { params }
}

/// Resolves the parameters for a capture without optional inputs, outside of any recipe.
pub fn resolve_for(params: TrainingParams, capture: &Capture) -> Result<TrainingParams, Vec<ParamProblem>> {
    let inputs = BTreeMap::from([(CAPTURE.to_string(), vec![facts_of(capture)])]);
    let context = PlanContext { data_root: Path::new(""), inputs };
    Ok(resolve(params, &context)?.params)
}

/// Static facts of the model: its method, the expected number of Gaussians, and the recipe of its shared phase, if it is
/// the model of one.
pub(crate) fn facts(params: &TrainingParams) -> Facts {
    let known = Facts::default().with(METHOD, params.method.as_str()).with(GAUSSIANS, work::gaussians(params));
    coarse::offered(params).map_or(known.clone(), |recipe| known.with(COARSE, recipe))
}

/// Name of the fact that holds the method of a model.
const METHOD: &str = "method";
/// Name of the fact that holds the number of Gaussians that a training is expected to end with.
const GAUSSIANS: &str = "expected gaussians";
/// Name of the fact that holds the recipe of a shared phase.
const COARSE: &str = "coarse phase";

/// The index of the model on the port `start` that is exactly what this training would begin with, and the decision to
/// use it. If only a model of the same base with other parameters is offered, the decision lists the differences.
fn chosen_start(params: &TrainingParams, context: &PlanContext<'_>) -> (Option<usize>, Option<Decision>) {
    let decision = |on, reason| Some(Decision { effect: "shared coarse phase".into(), on, reason });
    let begins_alike = || {
        methods::find(&params.method)
            .is_ok_and(|entry| matches!(entry.coarse(&params.shared, &params.settings), Ok(Some(_))))
    };
    if params.shared.budget_secs.is_some() && begins_alike() {
        return (None, decision(false, "with a budget, every training finds its own schedule".into()));
    }
    let Some(own) = coarse::recipe(params).filter(|_| params.shared.stop_after.is_none()) else { return (None, None) };
    let offered = context.inputs.get(START).into_iter().flatten().map(|facts| facts.value(COARSE));
    let offered: Vec<(usize, &Value)> = offered.enumerate().filter_map(|(at, recipe)| Some((at, recipe?))).collect();
    if let Some((at, _)) = offered.iter().find(|(_, recipe)| **recipe == own) {
        return (Some(*at), decision(true, "trained once for all methods with the same first phase".into()));
    }
    let nearest = offered.iter().find(|(_, recipe)| recipe["base"] == own["base"]);
    (None, nearest.and_then(|(_, recipe)| decision(false, coarse::differences(recipe, &own).join(", "))))
}

/// The decision against view-dependent colours, if the recipe sets the degree of the harmonics to 0.
fn without_harmonics(params: &TrainingParams) -> Result<Option<Decision>, Vec<ParamProblem>> {
    let has_effect = params.registration().has_harmonics();
    if params.shared.harmonics.degree > 0 || !has_effect {
        return Ok(None);
    }
    let name = VIEW_DEPENDENT_COLOR.name;
    let asked = match &params.shared.effects {
        Effects::Auto => false,
        Effects::Named(names) => [name, &format!("+{name}")].iter().any(|asked| names.contains(*asked)),
    };
    if asked {
        let message = format!("the effect `{name}` cannot be simulated: harmonics.degree is 0");
        let hint = Some("set harmonics.degree to 1, 2 or 3".into());
        return Err(vec![ParamProblem { key: "effects".into(), message, hint }]);
    }
    Ok(Some(Decision { effect: name.into(), on: false, reason: "harmonics.degree is 0".into() }))
}
