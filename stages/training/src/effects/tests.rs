use std::collections::{BTreeMap, BTreeSet};

use engine::Facts;
use scene::facts;

use super::choice::KnownInputs;
use super::*;

const EFFECTS: [Effect; 5] = [
    Effect::new("motion", "described", &[Need::Times(2), Need::Motion]),
    Effect::new("jerk", "described", &[Need::Times(4), Need::Effect("motion")]),
    Effect::new("flow", "described", &[Need::Flow, Need::Depth]),
    Effect::new("layers", "described", &[Need::Layers]),
    Effect::new("focus", "described", &[]).off_by_default(),
];

fn named(names: &[&str]) -> Effects {
    Effects::Named(names.iter().map(|name| name.to_string()).collect())
}

fn capture(times: u64, moving: bool) -> Facts {
    Facts::default().with(facts::TIMES, times).with(facts::MOVING, moving)
}

fn priors(depth: bool, flow: bool) -> Facts {
    Facts::default().with(facts::DEPTH, depth).with(facts::FLOW, flow)
}

/// "name on: reason" for each effect; problems are an error.
fn choose(effects: &Effects, known: &[(&'static str, &Facts)]) -> Result<Vec<String>, Vec<String>> {
    let known: KnownInputs<'_> = known.iter().copied().collect();
    let choice = effects.choose(&EFFECTS, &known).map_err(|problems| messages(&problems))?;
    let line = |decision: &engine::Decision| {
        format!("{} {}: {}", decision.effect, if decision.on { "on" } else { "off" }, decision.reason)
    };
    let on: BTreeSet<String> =
        choice.decisions.iter().filter(|decision| decision.on).map(|decision| decision.effect.clone()).collect();
    assert_eq!(choice.on, on);
    Ok(choice.decisions.iter().map(line).collect())
}

fn messages(problems: &[engine::ParamProblem]) -> Vec<String> {
    problems.iter().map(|problem| problem.message.clone()).collect()
}

#[test]
fn auto_enables_effects_whose_needs_are_met() {
    let (scene, maps) = (capture(3, true), priors(true, false));
    let expected = [
        "motion on: 3 times, something moves",
        "jerk off: 3 times where 4 are needed",
        "flow off: `priors` has no flow",
        "layers off: nothing is wired to `layers`",
        "focus off: off unless named in the recipe",
    ];
    assert_eq!(choose(&Effects::Auto, &[(CAPTURE, &scene), (PRIORS, &maps)]).unwrap(), expected);
    let maps = priors(true, true);
    let still = choose(&Effects::Auto, &[(CAPTURE, &capture(9, false)), (PRIORS, &maps)]).unwrap();
    assert_eq!(
        still[..3],
        ["motion off: nothing moves", "jerk off: motion is off", "flow on: `priors` has flow, `priors` has depth"]
    );
}

#[test]
fn unknown_needs_count_as_met() {
    let unknown = Facts::default();
    let found = choose(&Effects::Auto, &[(CAPTURE, &unknown), (PRIORS, &unknown)]).unwrap();
    assert_eq!(found[0], "motion on: number of times not known before import, motion not known before import");
    assert_eq!(
        found[2],
        "flow on: flow on `priors` not known before import, depth on `priors` not known before import"
    );
}

#[test]
fn lists_are_exact_and_changes_modify_auto() {
    let (scene, maps) = (capture(9, false), priors(true, true));
    let known = [(CAPTURE, &scene), (PRIORS, &maps)];
    let list = choose(&named(&["motion", "focus"]), &known).unwrap();
    assert_eq!(list[0], "motion on: requested, although nothing moves");
    assert_eq!(
        list[2..],
        ["flow off: left out by the recipe", "layers off: left out by the recipe", "focus on: requested"]
    );
    let changed = choose(&named(&["+focus", "-flow"]), &known).unwrap();
    assert_eq!(changed[0], "motion off: nothing moves");
    assert_eq!((changed[2].as_str(), changed[4].as_str()), ("flow off: left out by the recipe", "focus on: requested"));
    assert!(choose(&named(&[]), &known).unwrap().iter().all(|line| line.ends_with("off: left out by the recipe")));
}

#[test]
fn auto_effects_equal_the_same_effects_named() {
    let (scene, maps) = (capture(9, true), priors(true, true));
    let known: KnownInputs<'_> = BTreeMap::from([(CAPTURE, &scene), (PRIORS, &maps)]);
    let auto = Effects::Auto.choose(&EFFECTS, &known).unwrap();
    let again = Effects::Named(auto.on.clone()).choose(&EFFECTS, &known).unwrap();
    assert_eq!((&auto.on, &auto.unread), (&again.on, &again.unread));
    assert_eq!(auto.unread, BTreeSet::from([FEATURES, PARTICLES, LAYERS, BACKGROUND]));
}

#[test]
fn a_named_effect_without_its_input_is_a_problem() {
    let scene = capture(9, true);
    let known = [(CAPTURE, &scene)];
    let problem = choose(&named(&["motion", "flow"]), &known).unwrap_err();
    assert_eq!(problem, ["the effect `flow` cannot be simulated: nothing is wired to `priors`"]);
    let blind = priors(true, false);
    let problem = choose(&named(&["+flow"]), &[(CAPTURE, &scene), (PRIORS, &blind)]).unwrap_err();
    assert_eq!(problem, ["the effect `flow` cannot be simulated: `priors` has no flow"]);
    let problem = choose(&named(&["jerk"]), &known).unwrap_err();
    assert_eq!(problem, ["the effect `jerk` cannot be simulated: motion is off"]);
}

#[test]
fn unknown_names_and_mixed_lists_are_problems() {
    let problems = |names: &[&str]| messages(&named(names).problems("vcgs", &EFFECTS));
    assert_eq!(problems(&["motion", "flwo"]), ["vcgs has no effect `flwo`"]);
    assert_eq!(problems(&["motion", "-flow"]), ["a list of names cannot also change the automatic choice"]);
    assert_eq!(problems(&["+flow", "-flow"]), ["`flow` is both added and removed"]);
    assert!(problems(&["+flow", "-motion"]).is_empty() && Effects::Auto.problems("vcgs", &EFFECTS).is_empty());
    let hint = named(&["flwo"]).problems("vcgs", &EFFECTS)[0].hint.clone().unwrap();
    assert_eq!(
        hint,
        "it has: motion (described), jerk (described), flow (described), layers (described), focus (described)"
    );
    assert_eq!(named(&["flow"]).problems("vcgs", &[])[0].hint.as_deref(), Some("vcgs has no effects"));
}

#[test]
fn outcomes_depend_only_on_the_list_and_the_data() {
    let scene = Facts::default().with(facts::TIMES, 9);
    let known: KnownInputs<'_> = BTreeMap::from([(CAPTURE, &scene)]);
    let outcome = |effects: &Effects| {
        let line = |decision: engine::Decision| (decision.effect, decision.on, decision.reason);
        outcomes(effects, &EFFECTS, &known).into_iter().map(line).collect::<Vec<_>>()
    };
    let found = outcome(&named(&["motion"]));
    assert_eq!(found[0], ("motion".into(), true, "9 times".into()));
    assert_eq!(found[1], ("jerk".into(), false, "left out".into()));
    assert_eq!(found[2], ("flow".into(), false, "left out".into()));
    assert_eq!(outcome(&named(&[]))[0].2, "left out");
    assert_eq!(outcome(&named(&["flow"]))[2], ("flow".into(), true, "simulated".into()));
}
