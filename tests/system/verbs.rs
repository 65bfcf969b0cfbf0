//! A tiny recipe from end to end: run, run again, and every verb that reads the results.

use std::os::unix::process::CommandExt;
use std::time::Instant;

use serde_json::Value;

use crate::product::{Ended, TINY_JOBS, World, program};

const STATIC: &str = "train/bouncing-spheres/static3dgs/0";
const TRAINING: &str = "train/bouncing-spheres/deformable4dgs/0";

#[test]
fn a_recipe_runs_once_and_every_verb_understands_the_result() {
    let world = World::tiny();
    let first = world.run(&[]);
    assert_eq!(first.counts["executed"], TINY_JOBS as u64);
    second_run_executes_nothing(&world);
    plan_status_explain_and_graph(&world);
    show(&world);
    tables(&world);
    other_recipes_and_kept_reports(&world);
    eval_export_and_render(&world);
    outdated_results_are_used_and_damaged_ones_refused(&world);
    the_store_is_sound(&world);
    options_are_in_the_commands_of_the_report(&world);
}

#[test]
fn texts_about_a_new_recipe_are_reviewed() {
    let world = World::tiny();
    let mut texts = String::new();
    for (verb, arguments) in [
        ("plan", &[][..]),
        ("status", &[]),
        ("explain", &["render/swinging-arm/static3dgs/0"]),
        ("graph", &["--collapse", "--format", "mermaid"]),
    ] {
        let text = world.call(verb, arguments).ok();
        texts += &format!("==== {verb} {}\n{}\n", arguments.join(" "), world.timeless(&text));
    }
    insta::assert_snapshot!(texts);
}

#[test]
fn degenerate_results_have_an_exit_code_of_their_own() {
    // Opacities that are reset to nearly 0 do not recover before the end.
    let world = World::with_edit(", opacity_reset_to = 0.3", "");
    for _ in 0..2 {
        let ended = world.call("run", &[]);
        assert_eq!(ended.code, i32::from(engine::exit::DEGENERATE), "{}", ended.stderr);
        let named =
            ["DEGENERATE", "deformable4dgs on swinging-arm, seed 0: the renders are not better", "40 iterations"];
        named.iter().for_each(|text| assert!(ended.stderr.contains(text), "{}", ended.stderr));
    }
    let table = world.call("table", &[]).ok();
    assert!(table.contains("| deformable4dgs | degenerate | degenerate |"), "{table}");
    let compared = world.call("compare", &["tiny.toml"]);
    assert_eq!(compared.code, 4, "{}{}", compared.stdout, compared.stderr);
}

/// A recipe of one small capture.
const CAPTURE: &str = r#"
[axes]
scene = ["swinging-arm"]
[nodes.capture]
stage = "scene-synthesis"
over = ["scene"]
[nodes.capture.params]
scene = "{scene}"
width = 24
height = 24
frames = 6
val_views = 1
test_views = 1
samples_per_pixel = 1
points = 60
"#;

#[test]
fn the_last_result_is_that_of_the_last_run_even_if_it_was_cached() {
    let world = World::of(CAPTURE);
    let other = world.path("other.toml").display().to_string();
    let of_other = |arguments: &[&str]| {
        let store = world.path("store").display().to_string();
        Ended::of(program(&[&[arguments[0], &other][..], &arguments[1..], &["--store", &store]].concat())).ok()
    };
    let with_points = |points: usize| CAPTURE.replace("points = 60", &format!("points = {points}"));
    for points in [60, 70, 60] {
        std::fs::write(world.recipe(), with_points(points)).unwrap();
        world.call("run", &[]).ok();
    }
    // A run with other options changes nothing, and all results of the other recipe are in the store.
    world.call("run", &["-s", "nodes.capture.params.points=80"]).ok();
    std::fs::write(&other, with_points(70)).unwrap();
    of_other(&["run"]);
    for recipe in [world.recipe(), (&other).into()] {
        std::fs::write(recipe, with_points(90)).unwrap();
    }
    let points = |shown: String| {
        serde_json::from_str::<Value>(&shown).unwrap()["record"]["components"]["params"]["points"].as_u64()
    };
    assert_eq!(points(world.call("show", &["capture/swinging-arm", "--json"]).ok()), Some(60));
    assert_eq!(points(of_other(&["show", "capture/swinging-arm", "--json"])), Some(70));
    for (plan, change) in [(world.call("plan", &[]).ok(), "points 60 → 90"), (of_other(&["plan"]), "points 70 → 90")]
    {
        assert!(plan.contains(change), "{plan}");
    }
}

#[test]
fn a_store_that_cannot_be_written_is_checked_and_used() {
    let world = World::of(CAPTURE);
    world.call("run", &[]).ok();
    let chmod = |mode: &str| {
        let changed = std::process::Command::new("chmod").args(["-R", mode]).arg(world.path("")).status();
        assert!(changed.expect("chmod starts").success());
    };
    chmod("a=rX");
    let store = world.path("store").display().to_string();
    let recipe = world.recipe().display().to_string();
    for arguments in [&["run", &recipe, "--frozen"][..], &["cache", "verify"], &["cache", "gc", "--dry-run"]] {
        let mut command = program(&[arguments, &["--store", &store]].concat());
        if rustix::process::geteuid().is_root() {
            // Permissions do not bind the superuser.
            command.uid(65_534).gid(65_534);
        }
        match command.output() {
            Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => {
                support::skip("another user cannot start the program");
            }
            output => _ = Ended::from(output.expect("the program starts")).ok(),
        }
    }
    chmod("u+w");
}

#[test]
fn only_runs_on_a_cluster_are_followed_and_cancelled() {
    let world = World::of(CAPTURE);
    world.run(&["--workers", "1"]);
    let store = world.path("store");
    let run = std::fs::read_dir(store.join("runs")).unwrap().flatten().next().expect("a run");
    let (run, store) = (run.file_name().into_string().unwrap(), store.display().to_string());
    for verb in ["attach", "cancel"] {
        for (arguments, message) in
            [(&[][..], "no run is on a cluster"), (&[&*run], "is not on a cluster"), (&["x"], "there is no run x")]
        {
            let refused = Ended::of(program(&[&[verb][..], arguments, &["--store", &store]].concat()));
            let has_hint = refused.stderr.contains("`pipeline run RECIPE --on slurm`");
            assert!(refused.code == 4 && refused.stderr.contains(message) && has_hint, "{}", refused.stderr);
        }
    }
}

fn second_run_executes_nothing(world: &World) {
    let clock = Instant::now();
    let second = world.run(&[]);
    let secs = clock.elapsed().as_secs_f64();
    println!("the second run of {TINY_JOBS} jobs took {secs:.3} s");
    assert_eq!((second.counts["executed"], second.counts["cached"]), (0, TINY_JOBS as u64));
    // Usually a few hundredths of a second. The limit allows for a loaded machine.
    assert!(secs < 5.0, "{secs} s");
    world.run(&["--workers", "2"]);
    let mut runs = std::fs::read_dir(world.path("store/runs")).unwrap().flatten();
    assert!(runs.all(|run| !run.path().join("worker-1.log").exists()), "a worker started without a job to run");
    world.call("run", &["--frozen"]).ok();
    let events = world.call("run", &["--json"]);
    assert!(events.code == 0 && events.stderr.is_empty(), "events replace the summary: {}", events.stderr);

    let changed = world.call("run", &["--frozen", "-s", "nodes.render.params.maps=\"all\""]);
    assert_eq!(changed.code, 5, "{}", changed.stderr);
    assert!(changed.stderr.contains("render/bouncing-spheres/static3dgs/0"), "{}", changed.stderr);
}

fn plan_status_explain_and_graph(world: &World) {
    let plan = world.call("plan", &[]).ok();
    assert!(plan.contains(&format!("{TINY_JOBS} jobs: {TINY_JOBS} cached")), "{plan}");
    let changed = world.call("plan", &["-s", "nodes.train.params.loss.lambda_dssim=0.5", "--only", TRAINING]).ok();
    assert!(changed.contains("lambda_dssim 0.0 → 0.5"), "{changed}");
    let json: Value = serde_json::from_str(&world.call("plan", &["--json"]).ok()).unwrap();
    assert_eq!(json["jobs"][TRAINING]["state"], "cached");

    let status = world.call("status", &[]).ok();
    assert!(status.lines().any(|line| line.starts_with("train") && line.contains("4 cached")), "{status}");
    let explained = world.call("explain", &[TRAINING, "-s", "nodes.train.params.seed=1"]).ok();
    assert!(explained.contains("seed 0 → 1") && explained.contains("(default)"), "{explained}");
    let dot = world.call("graph", &[]).ok();
    assert!(dot.starts_with("digraph") && dot.contains(TRAINING), "{dot}");
    let mermaid = world.call("graph", &["--format", "mermaid", "--collapse"]).ok();
    assert!(mermaid.starts_with("flowchart") && mermaid.contains("training"), "{mermaid}");
}

fn show(world: &World) {
    let shown: Value = serde_json::from_str(&world.call("show", &[TRAINING, "--json"]).ok()).unwrap();
    assert!(shown["measurements"]["training_secs"].as_f64().is_some_and(|secs| secs > 0.0), "{shown}");
    assert_eq!(shown["record"]["components"]["params"]["method"], "deformable4dgs");
    let path = world.call("show", &[TRAINING, "--path"]).ok();
    assert!(std::path::Path::new(path.trim()).join("model.safetensors").is_file(), "{path}");
    let nothing = world.call("show", &["train/no-such-job"]);
    assert_eq!(nothing.code, 4, "{}", nothing.stderr);
    assert!(nothing.stderr.contains("hint"), "{}", nothing.stderr);
}

fn tables(world: &World) {
    let table = |format: &str| world.call("table", &["--format", format]).ok();
    let markdown = table("md");
    for expected in ["| method | PSNR (dB) |", "| static3dgs |", "| deformable4dgs |", "swinging-arm"] {
        assert!(markdown.contains(expected), "no {expected} in\n{markdown}");
    }
    let latex = table("latex");
    assert!(latex.contains("\\toprule") && latex.contains("deformable4dgs"), "{latex}");
    let csv = table("csv");
    let columns = csv.lines().next().unwrap_or_default().split(',').count();
    assert!(columns > 3 && csv.lines().count() > 4, "{csv}");
    let json: Value = serde_json::from_str(&table("json")).unwrap();
    assert!(json.to_string().contains("static3dgs"), "{json}");
}

/// Verbs never use results of another recipe. A kept report can be compared with the current results of its recipe.
fn other_recipes_and_kept_reports(world: &World) {
    let [tiny, other, out, store, kept] =
        ["tiny.toml", "other.toml", "none", "store", "kept"].map(|name| world.path(name).display().to_string());
    std::fs::write(&other, "extends = [\"tiny.toml\"]\nnodes.train.params.loss.lambda_dssim = 0.5\n").unwrap();
    let ended = |arguments: &[&str]| Ended::of(program(&[arguments, &["--store", &store]].concat()));
    for arguments in [
        &["table", &other][..],
        &["show", &other, TRAINING],
        &["compare", &tiny, &other],
        &["export", &other, TRAINING, "--times", "0:0.2:2", "--out", &out],
        &["table", &tiny, "-s", "nodes.train.params.loss.lambda_dssim=0.5"],
    ] {
        let Ended { code, stdout, stderr } = ended(arguments);
        assert!(code == 4 && stderr.contains("has no result"), "{arguments:?}\n{stdout}\n{stderr}");
    }
    let lost = ended(&["table", &tiny, "-s", "nodes.train.params.loss.lambda_dssim=0.5"]).stderr;
    assert!(lost.contains("has no result with these options\nhint: the last run with a result had "), "{lost}");
    let lost = ended(&["table", &other]).stderr;
    assert!(lost.contains(&format!("has no result in {store} (")), "{lost}");
    let plan = ended(&["plan", &other]).ok();
    assert!(
        plan.contains("will run     train/") && plan.contains(": never ran") && !plan.contains("params."),
        "{plan}"
    );

    let copied =
        std::process::Command::new("cp").args(["-r", &format!("{store}/results/tiny/report/"), &kept]).status();
    assert!(copied.expect("cp starts").success());
    assert!(ended(&["compare", &kept, &tiny]).ok().contains("| +0.00 |"));
    let page = std::fs::read_to_string(format!("{kept}/index.html")).expect("the page is a file");
    assert!(page.contains(&format!(" --device cpu --only {}", TRAINING.replacen("train", "metrics", 1))), "{page}");
}

fn eval_export_and_render(world: &World) {
    let folder = |job: &str| world.call("show", &[job, "--path"]).ok().trim().to_owned();
    let renders = folder("render/bouncing-spheres/static3dgs/0") + "/images";
    let against = |truth: &str| -> Value {
        let arguments = ["eval", "--renders", &renders, "--truth", truth, "--json"];
        serde_json::from_str(&Ended::of(program(&arguments)).ok()).unwrap()
    };
    // Images equal themselves and differ from those of another method.
    let same = against(&renders);
    assert_eq!(same["n_images"], 2);
    assert!((same["means"]["ssim"].as_f64().unwrap() - 1.0).abs() <= 1e-12, "{same}");
    let other = against(&(folder("render/bouncing-spheres/deformable4dgs/0") + "/images"));
    assert!(other["means"]["ssim"].as_f64().unwrap() < 1.0, "{other}");

    let out = world.path("ply").display().to_string();
    let report = world.call("export", &[TRAINING, "--times", "0:0.2:3", "--out", &out]).ok();
    assert_eq!(report.lines().count(), 3, "{report}");
    for (index, line) in report.lines().enumerate() {
        // The PSNR of equal images is infinite and printed as a word.
        assert!(line.contains("dB") || line.contains("equal"), "{line}");
        let ply = std::fs::read(world.path(&format!("ply/frame_{index:04}.ply"))).unwrap();
        assert!(ply.starts_with(b"ply\nformat binary_little_endian 1.0\n"), "{line}");
    }

    let film = world.path("film").display().to_string();
    let shot = [TRAINING, "--times", "0.1:0.1:3", "--views", "test_0000,test_0001", "--out", &film];
    assert!(world.call("render", &shot).ok().starts_with("3 frames of "));
    let frame = |index: usize| std::fs::read(world.path(&format!("film/frame_{index:04}.png"))).unwrap();
    assert!(frame(0).starts_with(b"\x89PNG") && frame(0) != frame(2), "the time is fixed and the camera moves");
    let again = world.call("render", &shot);
    assert!(again.code == 3 && again.stderr.contains("the folder is not empty"), "{}", again.stderr);

    let gif = world.path("film.gif").display().to_string();
    let side_by_side = [STATIC, TRAINING, "--views", "test", "--truth", "--gif", &gif];
    assert!(world.call("render", &side_by_side).ok().starts_with("2 frames of "));
    assert!(std::fs::read(&gif).unwrap().starts_with(b"GIF89a"));
    let sheet = world.path("sheet.png").display().to_string();
    let rows = [STATIC, TRAINING, "--views", "test", "--truth", "--sheet", &sheet];
    assert!(world.call("render", &rows).ok().starts_with("2 rows of 3 panels, "));
    assert!(std::fs::read(&sheet).unwrap().starts_with(b"\x89PNG"));
    let frames_of_two = world.call("render", &[STATIC, TRAINING, "--views", "test", "--out", &gif]);
    assert!(frames_of_two.code == 3 && frames_of_two.stderr.contains("one job only"), "{}", frames_of_two.stderr);

    let unknown = Ended::of(program(&["inspect", &out]));
    let output = unknown.stdout + &unknown.stderr;
    assert!(output.contains("not recognised") && output.contains("frame_0000.ply"), "{output}");
}

/// A warning says why a result is out of date. A result with a damaged file, or with a damaged capture, is not used.
fn outdated_results_are_used_and_damaged_ones_refused(world: &World) {
    let recipe = std::fs::read_to_string(world.recipe()).unwrap();
    std::fs::write(world.recipe(), recipe.replace("random_count = 200", "random_count = 100")).unwrap();
    let outdated = world.call("show", &[STATIC]);
    let reason = "is out of date (params.initial_points.random_count 200 → 100";
    assert!(outdated.code == 0 && outdated.stderr.contains(reason), "{}", outdated.stderr);
    std::fs::write(world.recipe(), &recipe).unwrap();

    // A report is not that of another recipe with the same name.
    let (twin, store) = (world.path("twin.toml"), world.path("store").display().to_string());
    std::fs::write(&twin, recipe.replace("random_count = 200", "random_count = 100")).unwrap();
    let table = Ended::of(program(&["table", &twin.display().to_string(), "--store", &store]));
    assert!(table.code == 4 && table.stderr.contains("the last recipe of this name was"), "{}", table.stderr);

    let file = |job: &str, name: &str| {
        let folder = world.call("show", &[job, "--path"]).ok();
        std::fs::canonicalize(std::path::Path::new(folder.trim()).join(name)).unwrap()
    };
    let out = world.path("damaged").display().to_string();
    let refused = |damage: &str| {
        for verb in ["render", "export"] {
            let ended = world.call(verb, &[TRAINING, "--times", "0:0.2:3", "--out", &out]);
            assert!(ended.code == 12 && ended.stderr.contains(damage), "{verb}: {}", ended.stderr);
            assert!(ended.stderr.contains("run the recipe again") && !world.path("damaged").exists());
        }
    };
    let model = file(TRAINING, "model.safetensors");
    let whole = std::fs::read(&model).unwrap();
    make_writable(&model);
    std::fs::write(&model, [&[0; 400][..], &whole[400..]].concat()).unwrap();
    refused("the result of train/bouncing-spheres/deformable4dgs/0 is damaged: model.safetensors is corrupt");
    std::fs::write(&model, &whole[..whole.len() / 2]).unwrap();
    refused("model.safetensors has the wrong size");
    let changed = world.call("show", &[TRAINING, "--replicates", "1"]);
    assert!(
        changed.code == 4 && changed.stderr.contains("(model.safetensors has the wrong size)"),
        "{}",
        changed.stderr
    );
    std::fs::write(&model, whole).unwrap();

    let shown: Value = serde_json::from_str(&world.call("show", &[TRAINING, "--json"]).ok()).unwrap();
    let (shard, rest) = shown["record"]["measurements"].as_str().unwrap().split_at(2);
    let measurements = world.path("store/cas").join(shard).join(rest);
    let whole = std::fs::read(&measurements).unwrap();
    std::fs::remove_file(&measurements).unwrap();
    for arguments in [["plan", "--only", TRAINING].as_slice(), &["explain", TRAINING]] {
        let output = world.call(arguments[0], &arguments[1..]).ok();
        assert!(output.contains(&format!("{TRAINING}: the measurements are unreadable")), "{output}");
    }
    std::fs::write(&measurements, whole).unwrap();

    let capture = file("capture/bouncing-spheres", "capture.json");
    let whole = std::fs::read(&capture).unwrap();
    make_writable(&capture);
    std::fs::write(&capture, vec![b' '; whole.len()]).unwrap();
    refused("the capture of train/bouncing-spheres/deformable4dgs/0 is damaged: capture.json is corrupt");
    std::fs::write(&capture, whole).unwrap();
    assert_eq!(world.run(&[]).counts["executed"], 0);
}

fn the_store_is_sound(world: &World) {
    let store = world.path("store").display().to_string();
    let cache = |verb: &str| Ended::of(program(&["cache", verb, "--store", &store]));
    cache("verify").ok();
    assert!(cache("du").ok().contains("files"));
    cache("gc").ok();
    assert_eq!(world.run(&[]).counts["executed"], 0, "gc removed what the last run needs");

    // A damaged blob is detected, and its producer runs again.
    let blob = walkdir::WalkDir::new(world.path("store/cas")).into_iter().map(Result::unwrap);
    let blob = blob.filter(|entry| entry.file_type().is_file()).max_by_key(|entry| entry.metadata().unwrap().len());
    let blob = blob.expect("the store has blobs").into_path();
    let mut bytes = std::fs::read(&blob).unwrap();
    bytes[0] ^= 1;
    make_writable(&blob);
    std::fs::write(&blob, bytes).unwrap();
    assert_eq!(cache("verify").code, 12);
    Ended::of(program(&["cache", "verify", "--repair", "--store", &store])).ok();
    assert!(world.run(&[]).counts["executed"] > 0);
    cache("verify").ok();
}

/// The commands in a report contain the options that changed the recipe.
fn options_are_in_the_commands_of_the_report(world: &World) {
    world.call("run", &["-s", "nodes.report.params.title = 'its title'"]).ok();
    let page = std::fs::read_to_string(world.path("store/results/tiny/report/index.html")).expect("the page");
    assert!(page.contains(r"-s 'nodes.report.params.title = '\''its title'\''' --device cpu"), "{page}");
}

fn make_writable(path: &std::path::Path) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o644)).unwrap();
}
