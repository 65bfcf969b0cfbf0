use std::collections::BTreeMap;
use std::path::Path;

use engine::{Facts, PlanContext, Resolution};
use scene::facts;
use serde_json::{Value, json};

use super::*;
use crate::methods;

fn params(value: Value) -> TrainingParams {
    serde_json::from_value(value).unwrap()
}

/// Facts of a capture on the port `capture` and of models on the port `start`.
fn context(capture: Facts, start: &[Facts]) -> PlanContext<'static> {
    let inputs = BTreeMap::from([("capture".to_string(), vec![capture]), (START.to_string(), start.to_vec())]);
    PlanContext { data_root: Path::new("unused"), inputs }
}

fn static_scene() -> Facts {
    Facts::default().with(facts::TIMES, 9).with(facts::MOVING, false).with(facts::VIEW_DEPENDENT, false)
}

fn effects(resolution: &Resolution<TrainingParams>) -> Value {
    serde_json::to_value(&resolution.params.shared.effects).unwrap()
}

#[test]
fn colours_without_view_dependence_have_no_harmonics() {
    let resolved = resolve(params(json!({})), &context(static_scene(), &[])).unwrap();
    assert_eq!((effects(&resolved), resolved.params.shared.harmonics.degree), (json!([]), 0));
    assert_eq!(resolved.decisions[0].reason, "colours do not depend on the view");
    let unknown = resolve(params(json!({})), &context(Facts::default(), &[])).unwrap();
    assert_eq!((effects(&unknown), unknown.params.shared.harmonics.degree), (json!(["view-dependent-color"]), 3));
    let low = resolve(params(json!({ "harmonics": { "degree": 1 } })), &context(Facts::default(), &[])).unwrap();
    assert_eq!(low.params.shared.harmonics.degree, 1);
}

#[test]
fn automatic_and_named_effects_give_one_training() {
    for capture in [static_scene(), Facts::default()] {
        for method in methods::registry() {
            let auto = json!({ "method": method.name });
            let resolved = resolve(params(auto), &context(capture.clone(), &[])).unwrap();
            let named = json!({ "method": method.name, "effects": effects(&resolved) });
            let again = resolve(params(named), &context(capture.clone(), &[])).unwrap();
            assert_eq!(again.params, resolved.params, "{}", method.name);
            // Resolved parameters do not change.
            assert_eq!(
                resolve(resolved.params.clone(), &context(capture.clone(), &[])).unwrap().params,
                resolved.params
            );
        }
    }
}

#[test]
fn a_loss_that_cannot_act_is_left_out_with_the_reason() {
    let idle = |method: &str, times: u64, effects: Value| {
        let capture = Facts::default().with(facts::TIMES, times).with(facts::MOVING, true);
        let table = json!({ "method": method, "effects": effects });
        let decisions = resolve(params(table), &context(capture, &[])).unwrap().decisions;
        let found = decisions.into_iter().find(|decision| decision.effect == "temporal_smoothness");
        found.map(|decision| (decision.on, decision.reason))
    };
    // 9 times: 3 texels along time; 8 times: 2.
    let reason = "nothing to smooth, 2 texels along time where 3 are needed";
    for method in ["deformable4dgs", "phys4dgs", "l4dgs"] {
        assert_eq!(idle(method, 9, json!("auto")), None, "{method}");
        assert_eq!(idle(method, 8, json!("auto")), Some((false, reason.into())), "{method}");
        assert_eq!(idle(method, 8, json!(["-motion"])), None, "{method} without its effect");
    }
    assert_eq!(idle("modecgs", 8, json!("auto")), None, "its other field has 5 texels");
}

#[test]
fn a_method_without_its_required_input_is_refused() {
    let with_priors = |table: Value, priors: &[Facts]| {
        let mut context = context(Facts::default(), &[]);
        context.inputs.insert("priors".into(), priors.to_vec());
        resolve(params(table), &context).map_err(|problems| problems[0].clone())
    };
    let problem = with_priors(json!({ "method": "vcgs" }), &[]).unwrap_err();
    let hint = problem.hint.as_deref().unwrap_or_default();
    assert!(hint.starts_with("wire a depth-flow-import job to the port priors, or add a recipe that does"), "{hint}");
    assert_eq!(problem.key, "method");
    assert_eq!(problem.message, "vcgs needs depth, but nothing is wired to the port `priors`");
    assert!(with_priors(json!({ "method": "vcgs" }), &[Facts::default()]).is_ok());
    assert!(with_priors(json!({ "method": "vcgs", "vcgs": { "background": "gaussians" } }), &[]).is_ok());
    assert!(with_priors(json!({ "method": "l4dgs" }), &[]).is_ok());
    let without_depth = Facts::default().with(facts::DEPTH, false);
    let problem = with_priors(json!({ "method": "vcgs" }), &[without_depth]).unwrap_err();
    assert_eq!(problem.message, "vcgs needs depth, but the artifact on the port `priors` does not have it");
}

#[test]
fn l4dgs_reads_masks_whenever_they_are_wired() {
    let resolved = |method: &str, is_wired: bool| {
        let mut context = context(Facts::default(), &[]);
        context.inputs.insert("priors".into(), vec![Facts::default().with(facts::DEPTH, true)]);
        context.inputs.insert("layers".into(), if is_wired { vec![Facts::default()] } else { Vec::new() });
        resolve(params(json!({ "method": method })), &context).unwrap()
    };
    let [with, without] = [true, false].map(|is_wired| resolved("l4dgs", is_wired));
    assert!(!with.unread.contains("layers"), "{:?}", with.unread);
    assert_eq!(with.params, without.params, "masks decide about no effect");
    assert!(resolved("deformable4dgs", true).unread.contains("layers"));
}

#[test]
fn inpainted_images_without_depth_are_refused_only_where_it_places_surfels() {
    let with = |depth: Facts, table: Value| {
        let mut context = context(Facts::default(), &[]);
        let known = Facts::default().with(facts::DEPTH, true);
        context.inputs.extend([("priors", known), ("layers", Facts::default()), ("background", depth)].map(
            |(port, facts)| (port.to_owned(), vec![facts]), //
        ));
        let params = params(merge(json!({ "method": "vcgs" }), table));
        resolve(params, &context).map_err(|problems| problems[0].clone())
    };
    let lacks = || Facts::default().with(facts::DEPTH, false);
    let problem = with(lacks(), json!({})).unwrap_err();
    assert_eq!(
        problem.message,
        "vcgs needs the depth of inpainted images, but the artifact on the port `background` does not have it"
    );
    assert!(problem.hint.unwrap().contains("port priors of inpaint-import"));
    assert!(with(lacks(), json!({ "effects": ["-inpainting"] })).is_ok());
    assert!(with(lacks(), json!({ "vcgs": { "background": "gaussians" } })).is_ok());
    assert!(with(Facts::default(), json!({})).is_ok(), "not known before import");
}

/// A training that leaves out a part, on a scene without known facts.
fn without(method: &str, part: &str) -> Resolution<TrainingParams> {
    resolve(params(json!({ "method": method, "without": part })), &context(Facts::default(), &[])).unwrap()
}

#[test]
fn a_training_without_an_effect_is_one_with_the_others() {
    let resolved = without("mcgs", "physics");
    let named = json!({ "method": "mcgs", "effects": ["-physics"] });
    let named = resolve(params(named), &context(Facts::default(), &[])).unwrap();
    assert_eq!((&resolved.params, resolved.repeats), (&named.params, None));
    let reason = resolved.decisions.iter().find(|decision| decision.effect == "physics").unwrap();
    assert_eq!((reason.on, reason.reason.as_str()), (false, "left out"));
    let of_motion = without("mcgs", "motion");
    assert_eq!(effects(&of_motion), json!(["view-dependent-color"]));
    assert!(of_motion.decisions.iter().any(|decision| decision.reason == "motion is left out"));
}

#[test]
fn a_training_without_what_it_lacks_repeats_the_whole() {
    assert_eq!(without("mcgs", "spatial_smoothness").repeats.unwrap(), "the method has no part spatial_smoothness");
    assert!(without("static3dgs", "motion").repeats.is_some());
    let loss = without("deformable4dgs", "spatial_smoothness");
    assert_eq!((loss.params.shared.without.as_str(), loss.repeats), ("spatial_smoothness", None));
}

#[test]
fn degree_zero_disables_the_colour_effect() {
    let zero = |effects: Value| {
        resolve(params(json!({ "harmonics": { "degree": 0 }, "effects": effects })), &context(Facts::default(), &[]))
    };
    let resolved = zero(json!("auto")).unwrap();
    let color = resolved.decisions.iter().find(|decision| decision.effect == "view-dependent-color").unwrap();
    assert_eq!((effects(&resolved), color.reason.as_str()), (json!([]), "harmonics.degree is 0"));
    for named in [json!(["view-dependent-color"]), json!(["+view-dependent-color"])] {
        assert!(zero(named).unwrap_err()[0].message.contains("harmonics.degree is 0"));
    }
}

#[test]
fn a_start_is_chosen_only_if_it_matches_exactly() {
    let coarse = |change: Value| {
        let mut table = json!({ "method": "deformable4dgs", "stop_after": "coarse" });
        table.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        facts(&resolve(params(table), &context(Facts::default(), &[])).unwrap().params)
    };
    let start = |method: &str, offered: &[Facts]| {
        let resolved = resolve(params(json!({ "method": method })), &context(Facts::default(), offered)).unwrap();
        let sharing = resolved.decisions.iter().find(|decision| decision.effect == "shared coarse phase").cloned();
        (resolved.chosen.get(START).copied(), sharing.map(|decision| (decision.on, decision.reason)))
    };
    let (equal, other) = (coarse(json!({})), coarse(json!({ "seed": 7, "iterations": { "coarse": 9, "fine": 1 } })));
    let (chosen, decision) = start("deformable4dgs", &[other.clone(), Facts::default(), equal.clone()]);
    assert_eq!((chosen, decision.unwrap().0), (Some(2), true));
    let differences = "iterations.coarse 9 → 3000, seed 7 → 0".to_string();
    assert_eq!(start("deformable4dgs", &[other]), (None, Some((false, differences))));
    // Parameters of later phases do not matter.
    assert_eq!(coarse(json!({ "iterations": { "fine": 5 }, "deformable4dgs": { "width": 8 } })), equal);
    assert_eq!(coarse(json!({ "effects": ["+skip-still"] })), equal, "its inputs are not required either");
    let with_budget = coarse(json!({ "effects": ["+skip-still"], "budget_secs": 60.0 }));
    assert_eq!(start("deformable4dgs", &[with_budget]), (None, None), "of unknown length, with the same inputs");
    // Methods without a shared phase get no decision, and a completely trained model is not a start.
    assert_eq!(start("static3dgs", &[equal]), (None, None));
    assert_eq!(start("deformable4dgs", &[coarse(json!({ "stop_after": null }))]), (None, None));
}

#[test]
fn the_latest_phase_that_is_offered_is_chosen() {
    let offer = |change: Value| {
        let mut table = json!({ "method": "l4dgs", "stop_after": "teacher" });
        table.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        let resolved = resolve(params(table), &context(Facts::default(), &[])).unwrap();
        (facts(&resolved.params), resolved.params)
    };
    let coarse = json!({ "method": "deformable4dgs", "stop_after": "coarse" });
    let coarse = facts(&resolve(params(coarse), &context(Facts::default(), &[])).unwrap().params);
    let (taught, lean) = offer(json!({}));
    let chosen = |change: Value| {
        let mut table = json!({ "method": "l4dgs" });
        table.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        let offered = [coarse.clone(), taught.clone()];
        resolve(params(table), &context(Facts::default(), &offered)).unwrap().chosen.get(START).copied()
    };
    assert_eq!(chosen(json!({})), Some(1));
    // What only `fine` reads, a loss of it included, does not change the teacher.
    let later =
        json!({ "l4dgs": { "semantic_rate": 0.1, "shares": { "static_semantics": 2.0 } }, "without": "time_to_one" });
    assert_eq!((chosen(later.clone()), offer(later)), (Some(1), (taught.clone(), lean)));
    assert_eq!(chosen(json!({ "l4dgs": { "teacher": { "iterations": 9 } } })), Some(0));
    assert_eq!(chosen(json!({ "without": "reconstruction" })), Some(0), "the teacher's own loss");
    // Without a loss that reads the teacher there is none.
    assert_eq!(chosen(json!({ "effects": ["motion", "dynamic-depth", "view-dependent-color"] })), Some(0));
    assert_eq!(chosen(json!({ "seed": 1 })), None);
}

/// The steps that the work of a training counts, on images of 10 × 10 pixels.
fn counted_steps(table: Value) -> f64 {
    let capture = Facts::default().with(facts::WIDTH, 10).with(facts::HEIGHT, 10);
    let params = params(table);
    let batch = params.shared.batch as f64;
    training_work(&params, &context(capture, &[])).unwrap().amounts[0] / (100.0 * batch)
}

#[test]
fn the_work_of_a_training_counts_the_phases_that_it_runs() {
    let mcgs = |nodes: &str| json!({ "method": "mcgs", "effects": ["motion"], "mcgs": { "nodes_from": nodes } });
    assert_eq!([counted_steps(mcgs("gaussians")), counted_steps(mcgs("candidates"))], [30_000.0, 40_000.0]);
    // The teacher's steps do not shrink with the schedule.
    let l4dgs = |effects: Value| json!({ "method": "l4dgs", "effects": effects, "schedule_scale": 0.01 });
    let teacher = TrainingParams::of("l4dgs").unwrap().settings["teacher"]["iterations"].as_f64().unwrap();
    let motion = counted_steps(l4dgs(json!(["motion"])));
    assert_eq!(counted_steps(l4dgs(json!(["motion", "static-semantics"]))), motion + teacher);
    let coarse = json!({ "method": "deformable4dgs", "effects": ["motion"], "stop_after": "coarse" });
    assert_eq!(counted_steps(coarse), 3000.0);
}
