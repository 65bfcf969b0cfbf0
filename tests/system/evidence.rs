//! Guarantees for readers of results: a committed table is reproduced or the check fails, and only comparable results
//! are compared.

use crate::product::{Ended, World};

/// Options that restrict the recipe to one method.
const ONLY_DYNAMIC: [&str; 2] = ["-s", "axes.method=[\"deformable4dgs\"]"];

/// An override with which the few iterations of these tests end in clearly worse, but not degenerate images.
const FEW_POINTS: &str = "nodes.train.params.initial_points.random_count=40";

fn with<'a>(arguments: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    [arguments, more].concat()
}

#[test]
fn a_committed_table_is_reproduced_and_a_loss_that_is_broken_is_noticed() {
    let world = World::tiny();
    let file = world.path("table.toml").display().to_string();
    let table = |option: &str, more: &[&str]| -> Ended {
        world.call("table", &with(&[option, &file], &with(&ONLY_DYNAMIC, more)))
    };
    let early = table("--write-check", &[]);
    assert_eq!(early.code, 4, "there is no result to write: {}", early.stderr);
    world.call("run", &ONLY_DYNAMIC).ok();
    table("--write-check", &[]).ok();
    let output = table("--check", &[]).ok();
    assert!(output.contains("within tolerance"), "{output}");

    // A weight of zero removes the loss, like a bug could.
    let broken = ["-s", "nodes.train.params.deformable4dgs.spatial_smoothness=0.0"];
    assert_eq!(table("--check", &broken).code, 4, "the table is out of date");
    world.call("run", &with(&ONLY_DYNAMIC, &broken)).ok();
    let output = table("--check", &broken);
    assert_eq!(output.code, 11, "{}", output.stdout);
    assert!(output.stdout.contains("loss spatial_smoothness is missing"), "{}", output.stdout);
    let sparse = ["-s", FEW_POINTS];
    world.call("run", &with(&ONLY_DYNAMIC, &sparse)).ok();
    let output = table("--check", &sparse);
    assert!(output.code == 11 && output.stdout.contains(": psnr is "), "{}", output.stdout);

    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, text.replace("swinging-arm", "static-blocks")).unwrap();
    let output = table("--check", &[]);
    assert_eq!(output.code, 11);
    assert!(output.stdout.contains("is missing") && output.stdout.contains("is not in the file"), "{}", output.stdout);
}

#[test]
fn results_compare_in_pairs_under_one_protocol_only() {
    let world = World::tiny();
    world.call("run", &[]).ok();
    let kept = world.path("kept.json").display().to_string();
    std::fs::write(&kept, world.call("table", &["--format", "json"]).ok()).unwrap();
    let compare = |arguments: &[&str]| world.call("compare", &with(&[&kept], arguments));
    let same = compare(&["--fail-if-worse", "0.0dB", "--fail-if-worse", "training_secs=0%"]).ok();
    assert!(same.contains("| deformable4dgs | PSNR (dB) | 2 |") && same.contains("| all |"), "{same}");
    let without = compare(&["--metric", "lpips_alex", "--metric", "psnr", "--metric", "tof"]).ok();
    assert!(without.contains("note: no pair of runs has lpips_alex or tof in A and B\n"), "{without}");
    assert!(!same.contains("no pair of runs has"), "{same}");
    let between = compare(&["--rows", "deformable4dgs=static3dgs"]).ok();
    assert!(between.contains("deformable4dgs → static3dgs") && between.contains("2 runs only in A"), "{between}");

    // Compare the changed recipe (A) with the kept file (B).
    world.call("run", &["-s", FEW_POINTS]).ok();
    let report = world.path("store/results/tiny/report").display().to_string();
    let worse = Ended::of({
        let mut command = world.command("compare", &[&report, "--fail-if-worse", "0.1dB", "--json"]);
        command.current_dir(world.path(""));
        command
    });
    assert_eq!(worse.code, 11, "{}", worse.stderr);
    let output: serde_json::Value = serde_json::from_str(&worse.stdout).unwrap();
    assert!(output["violations"][0].as_str().unwrap().contains("psnr went from"), "{output}");

    let smaller = ["-s", "nodes.capture.params.width=24"];
    world.call("run", &smaller).ok();
    let refused = world.call("compare", &[&report]);
    assert_eq!(refused.code, 3, "{}", refused.stdout);
    for expected in ["different protocols", "32×32", "24×32"] {
        assert!(refused.stderr.contains(expected), "no {expected} in {}", refused.stderr);
    }
}

#[test]
fn replicates_set_seeds_and_a_budget_applies_to_every_training() {
    let world = World::tiny();
    let plan = world.call("plan", &["--replicates", "3"]).ok();
    for seed in 0..3 {
        assert!(plan.contains(&format!("train/swinging-arm/static3dgs/{seed}")), "{plan}");
    }
    assert!(!plan.contains("static3dgs/3"), "{plan}");
    let job = "train/swinging-arm/deformable4dgs/0";
    let explained = world.call("explain", &[job, "--budget", "90s"]).ok();
    assert!(explained.lines().any(|line| line.contains("budget_secs") && line.contains("90")), "{explained}");
    let plan = world.call("plan", &["--budget", "90s"]).ok();
    assert!(!plan.contains("coarse/"), "a schedule that is unknown yet cannot be shared:\n{plan}");

    let over = "[nodes.coarse]\nover = [\"scene\"]\n[nodes.teacher]\nover = [\"scene\"]\n[nodes.train]\nover = [\"scene\", \"method\"]\n\
                [nodes.train.params]\nseed = 0";
    let seedless = World::with_edit("[nodes.train.params]", over);
    seedless.call("plan", &[]).ok();
    let refused = seedless.call("plan", &["--replicates", "3"]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
}

#[test]
fn precision_adds_seeds_until_intervals_are_narrow_or_eight_are_used() {
    let world = World::tiny();
    let one_scene = ["-s", "axes.scene=[\"swinging-arm\"]"];
    let run = |precision: &str| world.call("run", &with(&one_scene, &["--precision", precision]));
    let wide = run("1000");
    assert!(wide.code == 0 && wide.stderr.contains("3 seeds: the widest interval is"), "{}", wide.stderr);
    assert!(wide.stderr.contains("precise enough") && !wide.stderr.contains("4 seeds"), "{}", wide.stderr);
    let names_the_run = |line: &str| {
        line.contains("see pipeline table") && line.contains("axes.scene=") && line.contains("--replicates 3")
    };
    assert!(wide.stderr.lines().any(names_the_run), "{}", wide.stderr);
    let narrow = run("1e-9").stderr;
    for seeds in 3..8 {
        let adds = |line: &str| line.starts_with(&format!("{seeds} seeds:")) && line.ends_with("adding a seed");
        assert!(narrow.lines().any(adds), "no seed is added to {seeds}: {narrow}");
    }
    assert!(narrow.contains("8 seeds: the widest interval is") && narrow.contains("no more seeds"), "{narrow}");
    let table = world.call("table", &with(&one_scene, &["--replicates", "8"])).ok();
    assert!(table.contains("gain in PSNR over static3dgs") && table.contains(" ± "), "{table}");
    assert_eq!(run("0").code, 2, "zero is no precision");
}

/// Largest factor between budget and training time. It allows for a machine that slows down after the calibration.
const SLOWEST: f64 = 10.0;

#[test]
fn a_training_with_a_budget_takes_about_that_time() {
    let world = World::with_edit("iterations = { train = 40 }", "iterations = { train = 100000 }");
    let only_static = ["-s", "axes.method=[\"static3dgs\"]", "-s", "axes.scene=[\"swinging-arm\"]"];
    world.call("run", &with(&only_static, &["--budget", "2s"])).ok();
    let table = |more: &[&str]| world.call("table", &with(&only_static, &with(&["--budget", "2s"], more))).ok();
    let output = table(&[]);
    assert!(output.contains(", to fit a budget of 2 s"), "{output}");
    let report: serde_json::Value = serde_json::from_str(&table(&["--format", "json"])).unwrap();
    let run = &report["runs"][0];
    let (scale, secs) = (run["schedule_scale"].as_f64().unwrap(), run["figures"]["training_secs"].as_f64().unwrap());
    assert!(scale > 40.0 / 100_000.0 && scale < 1.0 && run["budget_secs"] == 2.0, "{run}");
    assert!(secs > 2.0 / SLOWEST && secs < 2.0 * SLOWEST, "{secs} s of training for a budget of 2 s");
}
