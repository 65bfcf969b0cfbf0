//! What a training makes of what is known while the recipe is planned: which effects it simulates, and which optional
//! inputs it therefore reads.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;

use engine::{Decision, Facts, ParamProblem, PlanContext, Resolution};
use scene::Capture;
use serde_json::Value;

use crate::coarse;
use crate::dataset;
use crate::effects::{CAPTURE, Effects, VIEW_DEPENDENT_COLOR, known_inputs};
use crate::inputs::START;
use crate::methods;
use crate::params::TrainingParams;

/// The training with its effects chosen: an explicit list, which is what its key holds.
pub fn resolve(
    mut params: TrainingParams,
    context: &PlanContext<'_>,
) -> Result<Resolution<TrainingParams>, Vec<ParamProblem>> {
    let mut effects = methods::find(&params.method).expect("checked when read").effects();
    let constant_color = without_harmonics(&params)?;
    if constant_color.is_some() {
        effects.retain(|effect| effect.name != VIEW_DEPENDENT_COLOR.name);
    }
    let shares_phase = coarse::offered(&params).is_some();
    if shares_phase {
        // What only later phases simulate is not asked for here, nor are its inputs.
        effects.retain(|effect| effect.name == VIEW_DEPENDENT_COLOR.name);
        params.shared.effects = params.shared.effects.among(&effects);
    }
    let choice = params.shared.effects.choose(&effects, &known_inputs(context))?;
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
    Ok(Resolution { params, unread: choice.unread, chosen, decisions })
}

/// A shared phase without what only later phases read, so that a change there does not train it again.
fn without_the_rest(params: TrainingParams) -> TrainingParams {
    let Ok(defaults) = TrainingParams::of(&params.method) else { return params };
    let mut lean = TrainingParams { settings: defaults.settings, ..params.clone() };
    for (phase, steps) in &mut lean.shared.iterations {
        if Some(phase) != lean.shared.stop_after.as_ref() {
            *steps = defaults.shared.iterations.get(phase).copied().unwrap_or(*steps);
        }
    }
    // The base says what its phase reads; a method may hold that it reads some of its own settings.
    if coarse::recipe(&lean) == coarse::recipe(&params) { lean } else { params }
}

/// The training of a capture outside any recipe: nothing is wired but the capture itself.
pub fn resolve_for(params: TrainingParams, capture: &Capture) -> Result<TrainingParams, Vec<ParamProblem>> {
    let inputs = BTreeMap::from([(CAPTURE.to_string(), vec![dataset::facts_of(capture)])]);
    let context = PlanContext { data_root: Path::new(""), inputs };
    Ok(resolve(params, &context)?.params)
}

/// What is known of the model: which shared phase it is, if it is one.
pub fn facts(params: &TrainingParams) -> Facts {
    coarse::offered(params).map_or_else(Facts::default, |recipe| Facts::default().with(COARSE, recipe))
}

/// The fact that a model is a shared phase: its recipe.
const COARSE: &str = "coarse phase";

/// Which of the models on the port `start` is exactly what this training would begin with, and the decision to take it.
/// Where one of the same base differs, the training does that phase itself, and the decision says in what.
fn chosen_start(params: &TrainingParams, context: &PlanContext<'_>) -> (Option<usize>, Option<Decision>) {
    let decision = |on, reason| Some(Decision { effect: "shared coarse phase".into(), on, reason });
    let begins_alike = || methods::find(&params.method).is_ok_and(|entry| matches!(entry.coarse(params), Ok(Some(_))));
    if params.shared.budget_secs.is_some() && begins_alike() {
        return (None, decision(false, "with a budget, every training finds its own schedule".into()));
    }
    let Some(own) = coarse::recipe(params).filter(|_| params.shared.stop_after.is_none()) else { return (None, None) };
    let offered = context.inputs.get(START).into_iter().flatten().map(|facts| facts.value(COARSE));
    let offered: Vec<(usize, &Value)> = offered.enumerate().filter_map(|(at, recipe)| Some((at, recipe?))).collect();
    if let Some((at, _)) = offered.iter().find(|(_, recipe)| **recipe == own) {
        return (Some(*at), decision(true, "trained once for all methods that begin alike".into()));
    }
    let nearest = offered.iter().find(|(_, recipe)| recipe["base"] == own["base"]);
    (None, nearest.and_then(|(_, recipe)| decision(false, coarse::differences(recipe, &own).join(", "))))
}

/// The decision against view-dependent colours that the degree of the harmonics already is.
fn without_harmonics(params: &TrainingParams) -> Result<Option<Decision>, Vec<ParamProblem>> {
    let has_effect = methods::find(&params.method).expect("checked when read").has_harmonics();
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
