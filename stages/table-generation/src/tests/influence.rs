//! The influence of losses and effects: what is inert, and what is not.

use std::collections::BTreeMap;

use super::content::section;
use super::*;
use crate::collect::LossInfluence;

/// A loss with the given shares by group, that takes 12 s of a training of about 100 s.
fn loss(name: &str, effect: Option<&str>, shares: &[(&str, Option<f64>)]) -> LossInfluence {
    let shares: BTreeMap<String, Option<f64>> = shares.iter().map(|(group, share)| ((*group).into(), *share)).collect();
    let samples = 4 * usize::from(name != "acceleration");
    let stays = (name == "jerk").then(|| "published".into());
    LossInfluence { loss: name.into(), effect: effect.map(str::to_owned), stays, shares, samples, secs: Some(12.0) }
}

/// A run of `phys4dgs` that leaves out a part, with the effects of the whole.
fn variant(without: Option<&str>, seed: u32, psnr: f64) -> Run {
    let mut run = run("trex", "phys4dgs", seed, psnr);
    run.variant = Some(without.map_or("whole".into(), |part| format!("without {part}")));
    run.row = format!("phys4dgs without={}", without.unwrap_or("nothing"));
    run.effects = ["flow", "motion", "velocity"].map(String::from).into();
    run.influence = vec![
        loss("flow", Some("flow"), &[("positions", Some(2e-9)), ("network.trunk", Some(1e-8))]),
        loss("temporal", Some("velocity"), &[("network.velocity", None)]),
        loss("velocity", Some("velocity"), &[("positions", Some(1e-5)), ("network.velocity", Some(0.7))]),
        loss("acceleration", None, &[]),
        loss("jerk", None, &[]),
    ];
    run
}

/// Whole trainings and trainings without a part, whose PSNR differs by `change` and a spread over three seeds.
fn with_and_without(part: &str, change: f64) -> Vec<Run> {
    let seeds = || [(0, 0.01), (1, -0.02), (2, 0.015)].into_iter();
    let whole = seeds().map(|(seed, _)| variant(None, seed, 30.0 + f64::from(seed)));
    let without = seeds().map(|(seed, noise)| variant(Some(part), seed, 30.0 + f64::from(seed) + noise + change));
    whole.chain(without).collect()
}

fn influence_of<'r>(report: &'r Report, part: &str) -> &'r crate::influence::Influence {
    let row = &report.groups[0].rows[0];
    row.influence.iter().find(|influence| influence.part == part).expect("a part of the row")
}

#[test]
fn a_faint_loss_is_inert_and_a_loss_that_acts_is_not() {
    let report = report(vec![variant(None, 0, 30.0)]);
    let inert = ["flow", "jerk"].map(|part| influence_of(&report, part).is_inert);
    assert_eq!(inert, [true; 2], "a gradient below the threshold everywhere, and none at all");
    let acting = ["temporal", "velocity", "acceleration", "motion"].map(|part| influence_of(&report, part).is_inert);
    assert_eq!(acting, [false; 4], "alone in a group, strong in one, never sampled, and not measured");
    insta::assert_snapshot!(section(&report, "influence"));
}

#[test]
fn an_effect_refers_to_its_losses() {
    let mut run = variant(None, 0, 30.0);
    run.influence.push(loss("smoothness", Some("motion"), &[("positions", Some(0.1))]));
    let table = section(&report(vec![run]), "influence");
    assert!(table.contains("| motion (effect) | see its losses | – |"), "{table}");
}

#[test]
fn a_measured_difference_outweighs_a_faint_gradient() {
    let acts = report(with_and_without("flow", -0.5));
    assert!(!influence_of(&acts, "flow").is_inert, "leaving it out costs half a decibel");
    let left_out = influence_of(&acts, "flow").left_out[&Column::PSNR];
    assert!((left_out.mean + 0.4983).abs() <= 1e-3 && left_out.half_width.is_some_and(|width| width < 0.1));
    assert!(influence_of(&report(with_and_without("flow", 0.0)), "flow").is_inert);
}

#[test]
fn a_loss_with_a_gradient_is_inert_if_leaving_it_out_changes_nothing() {
    let idle = report(with_and_without("velocity", 0.0));
    assert!(influence_of(&idle, "velocity").is_inert);
    assert!(section(&idle, "influence").contains("inert: leaving it out changes nothing"));
    assert!(!influence_of(&report(with_and_without("velocity", -0.5)), "velocity").is_inert);
}

#[test]
fn a_part_is_left_out_at_the_same_values_of_further_axes() {
    let at = |scale: &str, change: f64| {
        let scaled = |run: Run| Run {
            row: format!("{} scale={scale}", run.row),
            axes: [("scale".to_owned(), scale.to_owned())].into(),
            ..run
        };
        with_and_without("motion", change).into_iter().map(scaled).collect::<Vec<_>>()
    };
    let report = report([at("1", -1.0), at("2", -3.0)].concat());
    let of_scale = |scale: &str| {
        let name = format!("phys4dgs without=nothing scale={scale}");
        let row = report.groups[0].rows.iter().find(|row| row.name == name).expect("a row");
        let motion = row.influence.iter().find(|influence| influence.part == "motion").expect("a part");
        motion.left_out[&Column::PSNR].mean.round()
    };
    assert_eq!(["1", "2"].map(of_scale), [-1.0, -3.0]);
}

#[test]
fn an_effect_is_inert_only_if_that_was_measured() {
    let idle = report(with_and_without("motion", 0.0));
    assert!(influence_of(&idle, "motion").is_inert);
    assert!(!influence_of(&report(with_and_without("motion", -3.0)), "motion").is_inert);
    let one_seed: Vec<Run> = with_and_without("motion", 0.0).into_iter().filter(|run| run.seed == "0").collect();
    assert!(!influence_of(&report(one_seed), "motion").is_inert, "one seed shows nothing");
    let rows = &idle.groups[0].rows;
    assert!(rows[1].influence.is_empty(), "a training without a part has no table of its own");
}

#[test]
fn an_inert_effect_of_a_method_says_why_it_stays() {
    let of_mcgs = |mut run: Run| {
        run.method = "mcgs".into();
        run.kept_effects.insert("attention".into(), "equations 14 and 15".into());
        run.effects = ["attention", "motion"].map(String::from).into();
        run
    };
    let verdict = |change: f64| {
        let runs = with_and_without("attention", change).into_iter().map(of_mcgs).collect();
        let table = section(&report(runs), "influence");
        table.lines().find(|line| line.contains("attention (effect)")).expect("a row").to_owned()
    };
    let inert = verdict(0.0);
    assert!(
        inert.contains("inert: leaving it out changes nothing") && inert.contains("kept: equations 14 and 15"),
        "{inert}"
    );
    assert!(!verdict(-3.0).contains("kept"), "an effect that acts needs no reason");
}

#[test]
fn seconds_of_an_effect_need_times_of_one_machine() {
    let mut runs = with_and_without("motion", -3.0);
    let secs = |runs: &[Run]| {
        let report = report(runs.to_vec());
        let motion = influence_of(&report, "motion");
        ([motion.secs, motion.secs_share].map(|value| value.is_some()), section(&report, "influence"))
    };
    let (measured, text) = secs(&runs);
    assert!(measured == [true; 2] && !text.contains("several kinds of machines"), "{text}");
    runs[0].machines = [("training".to_owned(), machine("Processor 2"))].into();
    let (measured, text) = secs(&runs);
    assert!(measured == [false; 2] && text.contains("so the seconds of effects are left out"), "{text}");
}

#[test]
fn a_part_that_acts_on_a_task_is_not_inert() {
    let error = Column::Metric(Metric::VelocityError);
    let with_errors = |change: f64| {
        let mut runs = with_and_without("motion", 0.0);
        for (index, run) in runs.iter_mut().enumerate() {
            let change = if run.row.ends_with("motion") { change + 0.001 * index as f64 } else { 0.0 };
            run.figures.insert(error, Score::Value(0.5 + change));
        }
        report(runs)
    };
    let acts = with_errors(0.3);
    let motion = influence_of(&acts, "motion");
    assert!(!motion.is_inert, "PSNR alone would call it inert");
    assert!((motion.left_out[&error].mean - 0.304).abs() <= 1e-9, "{:?}", motion.left_out);
    let table = section(&acts, "influence");
    let row = table.lines().find(|line| line.contains("motion (effect)")).expect("a row");
    assert!(table.contains("left out: Δ velocity error") && row.contains("+0.304 ± 0.002"), "{table}");
    assert!(influence_of(&with_errors(-0.004), "motion").is_inert);
}
