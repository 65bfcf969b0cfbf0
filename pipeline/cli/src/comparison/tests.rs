use metric_evaluation::{Metric, Score};
use table_generation::Machine;

use super::*;

fn run(row: &str, scene: &str, seed: &str, psnr: Option<f64>) -> Run {
    let figures = psnr.map(|value| (Column::PSNR, Score::Value(value))).into_iter().collect();
    let measured = Run { row: row.into(), scene: scene.into(), seed: seed.into(), figures, ..Run::default() };
    with_height(measured, 100)
}

/// The run, measured on images of 100 × `height` pixels.
fn with_height(run: Run, height: u32) -> Run {
    let [dataset, split, resize, background, time] = ["d", "s", "none", "white", "t"].map(str::to_owned);
    let protocol = scene::Protocol { dataset, split, width: 100, height, resize, background, time };
    Run { protocol: Some(protocol), judged_by: Some("test".into()), ..run }
}

fn side(row: &str, values: [f64; 3]) -> Vec<Run> {
    ["a", "b", "c"].into_iter().zip(values).map(|(scene, psnr)| run(row, scene, "0", Some(psnr))).collect()
}

#[test]
fn pairs_give_mean_interval_and_wins() {
    let compared = compare(&side("m", [20.0, 30.0, 25.0]), &side("m", [21.0, 32.0, 24.0]), &[]).unwrap();
    assert_eq!(compared.protocols[0].rows.len(), 1);
    let found = compared.protocols[0].rows[0].metrics[&Column::PSNR];
    // Differences 1, 2, −1: mean 2/3, s = √(7/3); t(0.975, 2) = 4.302653 (any table).
    let half = 4.302_653 * (7.0 / 3.0_f64).sqrt() / 3.0_f64.sqrt();
    assert!((found.difference - 2.0 / 3.0).abs() < 1e-12 && (found.mean_a, found.better, found.worse) == (25.0, 2, 1));
    let [low, high] = found.interval.unwrap();
    assert!((low - (2.0 / 3.0 - half)).abs() < 1e-4 && (high - (2.0 / 3.0 + half)).abs() < 1e-4, "{low} {high}");
    assert_eq!(found.scope(), "3 scenes (one seed)");
    let single = compare(&side("m", [1.0; 3])[..1], &side("m", [2.0; 3])[..1], &[]).unwrap();
    let found = single.protocols[0].rows[0].metrics[&Column::PSNR];
    assert_eq!((found.interval, found.scope()), (None, "1 seed".into()));
}

#[test]
fn results_without_values_differ_from_equal_results() {
    let whole = side("m", [20.0, 30.0, 25.0]);
    let failed: Vec<Run> = ["a", "b", "c"].map(|scene| run("m", scene, "0", None)).to_vec();
    let compared = compare(&whole, &failed, &[]).unwrap();
    assert!(!compared.has_values() && compared.protocols[0].rows[0].lost[&Column::PSNR].len() == 3);
    assert!(compare(&whole, &whole, &[]).unwrap().has_values());
}

#[test]
fn runs_of_a_scene_are_averaged_before_the_interval() {
    let of = |row: &str, psnr: [f64; 4]| -> Vec<Run> {
        let places = [("a", "0"), ("a", "1"), ("b", "0"), ("b", "1")];
        places.into_iter().zip(psnr).map(|((scene, seed), psnr)| run(row, scene, seed, Some(psnr))).collect()
    };
    let before = [of("m", [20.0; 4]), of("n", [20.0; 4])].concat();
    let after = [of("m", [21.0, 21.2, 23.0, 23.2]), of("n", [21.1, 21.3, 23.1, 23.3])].concat();
    let compared = compare(&before, &after, &[]).unwrap();
    // Two scenes: m gains 1.1 and 3.1 dB, all 1.15 and 3.15; t(0.975, 1) = 12.706 (any table), s/√2 = 1.
    let all = compared.protocols[0].all.as_ref().unwrap();
    for (row, gain, pairs) in [(&compared.protocols[0].rows[0], 2.1, 4), (all, 2.15, 8)] {
        let found = row.metrics[&Column::PSNR];
        let [low, high] = found.interval.unwrap();
        assert!((found.difference - gain).abs() < 1e-9 && (found.pairs, found.better) == (pairs, pairs));
        assert!((low - (gain - 12.706)).abs() < 1e-2 && (high - (gain + 12.706)).abs() < 1e-2, "{low} {high}");
    }
    // One scene: its seeds, over the rows.
    let one = |runs: &[Run]| runs.iter().filter(|run| run.scene == "a").cloned().collect::<Vec<_>>();
    let compared = compare(&one(&before), &one(&after), &[]).unwrap();
    let [low, high] = compared.protocols[0].all.as_ref().unwrap().metrics[&Column::PSNR].interval.unwrap();
    assert!((high - low - 2.0 * 12.706 * 0.1).abs() < 1e-2, "{low} {high}");
}

#[test]
fn a_seed_that_lacks_a_scene_is_left_out_as_in_tables() {
    let of = |gain: f64| -> Vec<Run> {
        let places = [("a", "0"), ("a", "1"), ("b", "0"), ("b", "1"), ("a", "2")];
        places.into_iter().map(|(scene, seed)| run("m", scene, seed, Some(20.0 + gain))).collect()
    };
    let compared = compare(&of(0.0), &of(1.0), &[]).unwrap();
    let row = &compared.protocols[0].rows[0];
    let found = row.metrics[&Column::PSNR];
    assert_eq!((found.pairs, found.over, found.n, found.scope()), (4, Unit::Scenes, 2, "2 scenes".into()));
    assert_eq!(row.left_out[&Column::PSNR], ["m on a, seed 2"]);
    let one_scene = compare(&of(0.0)[..2], &of(1.0)[..2], &[]).unwrap();
    let found = one_scene.protocols[0].rows[0].metrics[&Column::PSNR];
    assert_eq!((found.over, found.n, found.scope()), (Unit::Seeds, 2, "2 seeds".into()));
    assert!(one_scene.protocols[0].rows[0].left_out.is_empty());
}

#[test]
fn rows_pair_by_name_by_option_or_as_the_only_ones() {
    let both = [side("m", [1.0; 3]), side("n", [3.0; 3])].concat();
    let compared = compare(&both, &both, &[]).unwrap();
    assert_eq!(compared.protocols[0].rows.iter().map(ComparedRow::name).collect::<Vec<_>>(), ["m", "n"]);
    let named = compare(&both, &both, &[("m".into(), "n".into())]).unwrap();
    assert_eq!(
        (named.protocols[0].rows[0].name(), named.protocols[0].rows[0].metrics[&Column::PSNR].difference),
        ("m → n".into(), 2.0)
    );
    assert_eq!((named.only_in_a.len(), named.only_in_b.len()), (3, 3));
    let only = compare(&side("m", [1.0; 3]), &side("n", [3.0; 3]), &[]).unwrap();
    assert_eq!(only.protocols[0].rows[0].metrics[&Column::PSNR].pairs, 3);
    assert!(compare(&both, &side("o", [1.0; 3]), &[]).unwrap().protocols.is_empty());
}

#[test]
fn another_protocol_is_refused_and_the_difference_named() {
    let with_height = |height: u32| vec![with_height(run("m", "a", "0", Some(20.0)), height)];
    assert!(compare(&with_height(100), &with_height(100), &[]).is_ok());
    let refused = compare(&with_height(100), &with_height(200), &[]).unwrap_err().to_string();
    assert!(refused.contains("] d · s split · 100×100") && refused.contains("] d · s split · 100×200"), "{refused}");
    assert!(!refused.contains("A: test"), "{refused}");
}

#[test]
fn values_of_several_protocols_share_no_mean() {
    let both = [run("m", "a", "0", Some(20.0)), with_height(run("m", "b", "0", Some(40.0)), 50)];
    let compared = compare(&both, &both, &[]).unwrap();
    let means: Vec<f64> = compared.protocols.iter().map(|under| under.rows[0].metrics[&Column::PSNR].mean_a).collect();
    assert_eq!(means, [20.0, 40.0]);
    assert!(compared.protocols[1].protocol.contains("] d · s split · 100×50"), "{:?}", compared.protocols);
    let unmeasured = Run { protocol: None, judged_by: None, ..run("m", "b", "0", None) };
    let lost = compare(&both, &[both[0].clone(), unmeasured], &[]).unwrap();
    assert_eq!(
        lost.protocols[1].rows[0].lost[&Column::PSNR].len(),
        1,
        "a failed run belongs to its partner's protocol"
    );
}

#[test]
fn a_drop_beyond_the_limit_and_a_missing_value_are_violations() {
    let (before, after) = (side("m", [20.0, 20.0, 20.0]), side("m", [19.9, 20.0, 19.8]));
    let compared = compare(&before, &after, &[]).unwrap();
    let limit = |amount| [(Column::PSNR, amount)];
    assert_eq!(compared.violations(&limit(Amount::Absolute(0.11))), Vec::<String>::new());
    assert!(compared.violations(&limit(Amount::Absolute(0.09)))[0].contains("worse by 0.1000"));
    assert_eq!(compared.violations(&limit(Amount::Percent(1.0))), Vec::<String>::new());
    assert_eq!(compare(&after, &before, &[]).unwrap().violations(&limit(Amount::Absolute(0.0))), Vec::<String>::new());
    let lost = [&after[..2], &[run("m", "c", "0", None)]].concat();
    let violations = compare(&before, &lost, &[]).unwrap().violations(&limit(Amount::Absolute(1.0)));
    assert_eq!(violations, ["psnr is missing in B: m on c, seed 0: not measured"]);
    assert!(
        compared.violations(&[(Column::Metric(Metric::Ssim), Amount::Absolute(1.0))])[0]
            .contains("ssim cannot be checked")
    );
}

#[test]
fn values_that_only_b_has_are_listed() {
    let (whole, diverged) = (side("m", [20.0, 30.0, 25.0]), run("m", "c", "0", None));
    let before = [&whole[..2], &[diverged]].concat();
    let row = |a: &[Run], b: &[Run]| compare(a, b, &[]).unwrap().protocols[0].rows[0].clone();
    let found = row(&before, &whole);
    assert_eq!(found.metrics[&Column::PSNR].pairs, 2);
    assert_eq!(found.gained[&Column::PSNR], ["m on c, seed 0: not measured"]);
    assert!(found.lost.is_empty() && row(&whole, &before).gained.is_empty() && row(&whole, &whole).gained.is_empty());
}

#[test]
fn runs_that_b_lacks_are_violations() {
    let limits = [(Column::PSNR, Amount::Absolute(0.0))];
    let violations = |a: &[Run], b: &[Run], rows: &[(String, String)]| compare(a, b, rows).unwrap().violations(&limits);
    let whole = [side("m", [20.0; 3]), side("n", [30.0; 3])].concat();
    assert_eq!(violations(&whole, &whole, &[]), Vec::<String>::new());
    let scene = ["psnr is missing in B: n on c, seed 0: no such run"];
    assert_eq!(violations(&whole, &whole[..5], &[]), scene, "a scene was dropped");
    assert_eq!(violations(&whole, &whole[..3], &[]).len(), 3, "a method was dropped");
    assert_eq!(violations(&whole[..5], &whole, &[]), Vec::<String>::new(), "B has more");
    // Rows that are not named do not count, and neither does a run that failed in A.
    let named = [("m".to_owned(), "m".to_owned())];
    assert_eq!(violations(&whole, &whole[..3], &named), Vec::<String>::new());
    assert_eq!(violations(&whole, &whole[..2], &named), ["psnr is missing in B: m on c, seed 0: no such run"]);
    let failed = [&whole[..2], &[run("m", "c", "0", None)]].concat();
    assert_eq!(violations(&failed, &whole[..2], &[]), Vec::<String>::new());
}

#[test]
fn times_of_different_machines_are_left_out() {
    let timed = |threads: u64| {
        let mut run = run("m", "a", "0", Some(20.0));
        run.figures.insert(Column::TrainingSecs, Score::Value(3.0));
        let machine = Machine { device: "cpu".into(), threads: Some(threads), ..Machine::default() };
        run.machines = [("training".to_string(), machine)].into();
        vec![run]
    };
    let same = compare(&timed(2), &timed(2), &[]).unwrap();
    assert!(same.without_times.is_none() && same.protocols[0].rows[0].metrics.contains_key(&Column::TrainingSecs));
    let other = compare(&timed(2), &timed(4), &[]).unwrap();
    assert!(other.without_times.unwrap().contains("4 threads"));
    assert!(!other.protocols[0].rows[0].metrics.contains_key(&Column::TrainingSecs));
}

#[test]
fn rows_that_a_side_does_not_have_are_named() {
    let (a, b) = (side("static3dgs most=4", [1.0; 3]), side("mcgs", [1.0; 3]));
    let check = |row_a: &str, row_b: &str| check_rows(&a, &b, &[(row_a.into(), row_b.into())]);
    assert!(check("static3dgs most=4", "mcgs").is_ok());
    let wrong = [("static3dgs most=1", "mcgs"), ("static3dgs most=4", "scgs")].map(|(a, b)| check(a, b).unwrap_err());
    insta::assert_snapshot!(wrong.map(|error| error.to_string()).join("\n"), @r"
    error: A has no row `static3dgs most=1`
    hint: did you mean `static3dgs most=4`? allowed: static3dgs most=4
    error: B has no row `scgs`
    hint: did you mean `mcgs`? allowed: mcgs
    ");
}
