//! Decisions about a training while its recipe is planned: its effects, the optional inputs that they read, and the
//! shared phase that it can continue from.

#[cfg(test)]
mod tests;
mod work;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use engine::{Decision, Facts, ParamProblem, PlanContext, Resolution};
use scene::Capture;
use scene::facts::TIMES;
use serde_json::Value;

use crate::data::facts_of;
use crate::effects::{CAPTURE, Choice, Effects, NOTHING_LEFT_OUT, VIEW_DEPENDENT_COLOR, known_inputs};
use crate::method::SharedPhase;
use crate::methods::RequiredInput;
use crate::params::TrainingParams;
use crate::shared::merge;
use crate::sharing::{self, Shareable};

pub use work::model_work;
pub(crate) use work::training_work;

/// The port of the model that a training continues.
pub(crate) const START: &str = "start";

/// Resolves the effects of a training to an explicit list, which is part of its key.
pub(crate) fn resolve(
    mut params: TrainingParams,
    context: &PlanContext<'_>,
) -> Result<Resolution<TrainingParams>, Vec<ParamProblem>> {
    require_inputs(&params, &BTreeSet::new(), context)?;
    let mut effects = params.registration().effects();
    let constant_color = without_harmonics(&params)?;
    if constant_color.is_some() {
        effects.retain(|effect| effect.name != VIEW_DEPENDENT_COLOR.name);
    }
    let last_phase = sharing::last_phase(&params);
    if let Some(phase) = &last_phase {
        // Effects of later phases are dropped, and with them their inputs.
        effects.retain(|effect| effect.name == VIEW_DEPENDENT_COLOR.name || phase.effects.contains(&effect.name));
        params.shared.effects = params.shared.effects.among(&effects);
    }
    let known = known_inputs(context);
    let mut choice = params.shared.effects.choose(&effects, &known)?;
    let repeats = repeats_the_whole(&params, &choice);
    if choice.on.contains(&params.shared.without) {
        let left_out = std::mem::replace(&mut params.shared.without, NOTHING_LEFT_OUT.into());
        choice = choice.without(&left_out, &effects, &known)?;
    }
    require_inputs(&params, &choice.on, context)?;
    if !choice.on.contains(VIEW_DEPENDENT_COLOR.name) {
        params.shared.harmonics.degree = 0;
    }
    let idle = idle_loss(&params, &choice, context);
    params.shared.effects = Effects::Named(choice.on);
    let mut decisions = choice.decisions;
    if let Some(phase) = &last_phase {
        params = without_the_rest(params, phase);
    }
    let (start, sharing) = chosen_start(&params, context);
    decisions.extend(constant_color.into_iter().chain(idle).chain(sharing));
    let chosen = start.map(|start| (START, start)).into_iter().collect();
    Ok(Resolution { params, unread: choice.unread, chosen, decisions, repeats })
}

/// Refuses a training that lacks a required input of its method, given the effects in `on`: nothing is wired to the
/// port, or the artifact on it is known not to have the input. A port that `context` does not list, e.g. outside of
/// recipes, is not checked.
fn require_inputs(
    params: &TrainingParams,
    on: &BTreeSet<String>,
    context: &PlanContext<'_>,
) -> Result<(), Vec<ParamProblem>> {
    let reason = |input: &RequiredInput| {
        if context.inputs.get(input.port).is_some_and(Vec::is_empty) {
            return Some(format!("nothing is wired to the port `{}`", input.port));
        }
        let has_it = context.facts(input.port).and_then(|facts| facts.flag(input.fact));
        (has_it == Some(false)).then(|| format!("the artifact on the port `{}` does not have it", input.port))
    };
    let is_read = |input: &RequiredInput| input.effect.is_none_or(|effect| on.contains(effect));
    let inputs = params.registration().required_inputs(&params.settings);
    match inputs.into_iter().filter(is_read).find_map(|input| Some((reason(&input)?, input))) {
        None => Ok(()),
        Some((reason, RequiredInput { what, hint, .. })) => {
            let message = format!("{} needs {what}, but {reason}", params.method);
            Err(vec![ParamProblem { key: "method".into(), message, hint: Some(hint.into()) }])
        }
    }
}

/// The decision against a loss of the choice that cannot act in the scene.
fn idle_loss(params: &TrainingParams, choice: &Choice, context: &PlanContext<'_>) -> Option<Decision> {
    let time_count = context.facts(CAPTURE)?.count(TIMES)? as usize;
    let (loss, reason) = params.registration().idle_loss(&params.settings, time_count)?;
    choice.has_loss(&loss).then(|| Decision { effect: loss.name.into(), on: false, reason })
}

/// Why a training with `without` would repeat the full training, because it lacks that part anyway; `None` if it would
/// not.
fn repeats_the_whole(params: &TrainingParams, choice: &Choice) -> Option<String> {
    let without = params.shared.without.as_str();
    let losses = params.registration().losses;
    let acts = || losses.iter().any(|loss| loss.name == without && choice.has_loss(loss));
    let is_whole = without == NOTHING_LEFT_OUT || choice.on.contains(without) || acts();
    (!is_whole).then(|| format!("the method has no part {without}"))
}

/// The parameters of a shared phase without those that only later phases read, so a change of these does not retrain
/// it.
fn without_the_rest(params: TrainingParams, phase: &SharedPhase) -> TrainingParams {
    let Ok(defaults) = TrainingParams::of(&params.method) else { return params };
    let settings = merge(defaults.settings, phase.settings.clone());
    let mut lean = TrainingParams { settings, ..params };
    for (name, steps) in &mut lean.shared.iterations {
        if !phase.iterations.contains_key(name.as_str()) {
            *steps = defaults.shared.iterations.get(name).copied().unwrap_or(*steps);
        }
    }
    if !phase.losses.contains(&lean.shared.without.as_str()) {
        lean.shared.without = NOTHING_LEFT_OUT.into();
    }
    lean
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
    sharing::offered(params).map_or(known.clone(), |shared| known.with(SHARED_PHASE, shared.recipe))
}

/// Name of the fact that holds the method of a model.
const METHOD: &str = "method";
/// Name of the fact that holds the number of Gaussians that a training is expected to end with.
const GAUSSIANS: &str = "expected gaussians";
/// Name of the fact that holds the recipe of a shared phase.
const SHARED_PHASE: &str = "shared phase";

/// The index of the model on the port `start` that equals this training's model at the end of its latest possible
/// shared phase, and the decision to continue from it. If no offered model is equal, there is no index, and the
/// decision lists the differences from the first one with the same base and phase, if any.
fn chosen_start(params: &TrainingParams, context: &PlanContext<'_>) -> (Option<usize>, Option<Decision>) {
    let decision = |phase: &str, on, reason| Some(Decision { effect: format!("shared {phase} phase"), on, reason });
    if params.shared.budget_secs.is_some() {
        let reason = "with a budget, every training finds its own schedule";
        let phases = params.registration().shared_phases(&params.shared, &params.settings).unwrap_or_default();
        return (None, phases.first().and_then(|first| decision(first.phase, false, reason.into())));
    }
    let stops_at = params.shared.stop_after.as_deref();
    let earlier = |shared: &Shareable| stops_at != Some(shared.phase.phase);
    let own: Vec<Shareable> = sharing::shareable(params).into_iter().take_while(earlier).collect();
    let offered = context.inputs.get(START).into_iter().flatten().map(|facts| facts.value(SHARED_PHASE));
    let offered: Vec<(usize, &Value)> = offered.enumerate().filter_map(|(at, recipe)| Some((at, recipe?))).collect();
    for Shareable { phase, recipe } in own.iter().rev() {
        if let Some((at, _)) = offered.iter().find(|(_, offer)| *offer == recipe) {
            let reason = "trained once for all trainings with the same phases up to its end".into();
            return (Some(*at), decision(phase.phase, true, reason));
        }
    }
    let Some(first) = own.first() else { return (None, None) };
    let nearest = offered.iter().find(|(_, offer)| ["base", "phase"].iter().all(|key| offer[key] == first.recipe[key]));
    let differences = |offer: &Value| sharing::differences(offer, &first.recipe).join(", ");
    (None, nearest.and_then(|(_, offer)| decision(first.phase.phase, false, differences(offer))))
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
