//! Searches over parameters, as users start, interrupt and continue them.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::Value;

use crate::product::World;

const METHOD: &str = r#"axes.method=["static3dgs"]"#;
const SPACE: &str = "nodes.train.params.loss.lambda_dssim=uniform(0,0.5)";

/// The only file of this name below the store's searches.
fn file(world: &World, name: &str) -> PathBuf {
    let searches = std::fs::read_dir(world.path("store/sweeps")).expect("a search").flatten();
    let found: Vec<PathBuf> = searches.map(|entry| entry.path().join(name)).filter(|path| path.exists()).collect();
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}

fn entries(world: &World) -> usize {
    history(world).len()
}

/// What trials reached: (trial, rung) → entry.
pub(crate) fn history(world: &World) -> BTreeMap<(u64, u64), Value> {
    let files = std::fs::read_dir(file(world, "trials")).expect("a history").flatten();
    let read = |path: PathBuf| -> Value { serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap() };
    let place = |entry: &Value| (entry["trial"].as_u64().unwrap(), entry["rung"].as_u64().unwrap());
    files.map(|file| read(file.path())).map(|entry| (place(&entry), entry)).collect()
}

/// Trial → objective of the completed trials of a search with one rung.
pub(crate) fn objectives(world: &World) -> BTreeMap<u64, Option<f64>> {
    history(world).into_iter().map(|((trial, _), entry)| (trial, entry["objective"].as_f64())).collect()
}

/// The plan of the trainings of the best recipe.
fn best_plan(world: &World, arguments: &[&str]) -> String {
    let (recipe, store) = (file(world, "best.toml"), world.path("store"));
    let [recipe, store] = [recipe, store].map(|path| path.display().to_string());
    let all = [&["plan", &recipe, "--store", &store, "--only", "train"], arguments].concat();
    crate::product::Ended::of(crate::product::program(&all)).ok()
}

/// The records of a stage's results in the store.
fn records_of(world: &World, stage: &str) -> Vec<Value> {
    let records = std::fs::read_dir(world.path("store/records")).unwrap().flatten();
    let records = records.map(|file| std::fs::read_to_string(file.path()).unwrap());
    let records = records.map(|text| serde_json::from_str::<Value>(&text).unwrap());
    records.filter(|record| record["components"]["stage"] == stage).collect()
}

/// The splits of all renders in the store.
fn rendered_splits(world: &World) -> Vec<String> {
    let split = |record: &Value| record["components"]["params"]["split"].as_str().unwrap_or("test").to_owned();
    records_of(world, "rendering").iter().map(split).collect()
}

#[test]
fn a_search_continues_its_history_and_its_best_trial_is_an_ordinary_job() {
    let world = World::tiny();
    let search =
        |trials: &str| world.call("run", &["-s", METHOD, "--sweep", SPACE, "--rungs", "3", "--trials", trials]);
    let report = search("3").ok();
    assert!(report.contains("| 3 | 1.000 |") && report.contains("Checkpoints and cached results saved"), "{report}");
    let first = entries(&world);
    assert_eq!(search("3").ok(), report, "the search is over");
    assert_eq!(entries(&world), first);
    // Trials are paused at a ninth and at a third of their steps; one in three continues.
    let more = search("9");
    assert!(more.stderr.contains("6 trials: about ") && more.stderr.contains("predicted from"), "{}", more.stderr);
    more.ok();
    assert!(entries(&world) > first + 6, "{:?}", history(&world).keys());
    let cached = best_plan(&world, &["-s", "axes.seed=[0]"]);
    assert_eq!(cached.matches("cached       train/").count(), 2, "{cached}");
    assert!(!best_plan(&world, &[]).contains("cached       train/"), "judged with the seeds that chose it");
    let hint = format!("best.toml --store {}`", world.path("store").display());
    assert!(report.contains(&hint), "{report}");
}

#[test]
fn the_best_recipe_is_what_the_search_trained_whatever_the_form_of_overrides() {
    let rule = "nodes.train.params.iterations = { train = 40 }";
    let world = World::with_edit(rule, &format!("{rule}\nnodes.train.params.density.max_count = 350"));
    let lambda = |values: &str| format!("nodes.train.params.loss.lambda_dssim={values}");
    let overrides = [
        METHOD.to_owned(),
        r#"axes={scene=["swinging-arm"]}"#.into(),
        "axes.seed=[0]".into(),
        r#"name="other""#.into(),
        // The recipe has a rule about this parameter.
        "nodes.train.params={density={max_count=300}}".into(),
        "nodes.train.params.density={prune_interval=12}".into(),
        lambda("0.5"),
        lambda("0.4"),
    ];
    let mut arguments: Vec<&str> = overrides.iter().flat_map(|text| ["-s", text]).collect();
    let searched = lambda("0.1,0.2");
    let thresholds = "nodes.train.params.density.gradient_threshold=0.0001,0.0002";
    arguments.extend(["--sweep", &searched, "--sweep", thresholds]);
    world.call("run", &arguments).ok();
    assert_eq!(entries(&world), 4);
    let cached = best_plan(&world, &["-s", "axes.seed=[0]"]);
    assert_eq!(cached.matches("cached       train/").count(), 1, "{cached}");
    let new = best_plan(&world, &[]);
    for seed in ["1001", "1002", "1003"] {
        assert!(new.contains(&format!("will run     train/swinging-arm/static3dgs/{seed}")), "{new}");
    }
    let text = std::fs::read_to_string(file(&world, "best.toml")).unwrap();
    assert!(text.contains("name = \"other-best\""), "{text}");
}

#[test]
fn an_invalid_value_is_a_trial_without_a_result() {
    let world = World::tiny();
    let search = |world: &World, space: &str| world.call("run", &["-s", METHOD, "--sweep", space]);
    let lambda = |values: &str| format!("nodes.train.params.loss.lambda_dssim={values}");
    let ended = search(&world, &lambda("0.1,2,0.2"));
    let reason = "nodes.train.params.loss.lambda_dssim=2: must be in [0, 1]";
    assert!(ended.stderr.contains(&format!("warning: {reason}; a trial with this value")), "{}", ended.stderr);
    let report = ended.ok();
    assert!(report.contains(&format!("Trials without a result: 1, e.g. trial 2: {reason}.")), "{report}");
    assert_eq!(objectives(&world).values().map(Option::is_some).collect::<Vec<_>>(), [true, false, true]);
    let world = World::tiny();
    let none = search(&world, &lambda("2,3"));
    assert!(none.code == 3 && none.stderr.contains("must be in [0, 1]"), "{}", none.stderr);
    assert!(!world.path("store/sweeps").exists(), "no trial began");
    let report = world.call("run", &["--sweep", r#"axes.method=["static3dgs"],["vcgs"]"#]).ok();
    assert!(report.contains("Trials without a result: 1") && report.contains("vcgs needs depth"), "{report}");
    assert!(report.contains("Best:") && report.contains("method=[\"static3dgs\"]"), "{report}");
}

#[test]
fn values_that_trials_cannot_be_compared_by_are_refused() {
    let world = World::tiny();
    let capture = "change the capture";
    let nothing = "nothing that the search compares depends on it";
    for (space, reason) in [
        ("nodes.capture.params.width=32,48", capture),
        (r#"axes.scene=["swinging-arm"],["bouncing-spheres"]"#, capture),
        ("nodes.report.params.title=a,b", nothing),
        ("name=a,b", nothing),
        (r#"nodes.metrics.params.metrics=["psnr"],["psnr","ssim"]"#, nothing),
    ] {
        let refused = world.call("run", &["-s", METHOD, "--sweep", space]);
        assert!(refused.code == 3 && refused.stderr.contains(reason), "{space}: {}", refused.stderr);
    }
    assert!(!world.path("store/sweeps").exists(), "no trial began");
}

#[test]
fn a_grid_completes_every_combination() {
    let world = World::tiny();
    let space = "nodes.train.params.density.max_count=300,400";
    let search = |arguments: &[&str]| world.call("run", &[&["-s", METHOD, "--sweep", space], arguments].concat());
    let report = search(&[]).ok();
    assert!(report.contains("max_count=300") && report.contains("max_count=400"), "{report}");
    assert_eq!(entries(&world), 2);
    let renders = || rendered_splits(&world);
    assert!(renders().is_empty(), "the curve of the training decides");
    // Three new seeds, two scenes.
    let evaluated = search(&["--evaluate"]);
    assert!(evaluated.code == 0, "{}", evaluated.stderr);
    assert_eq!(renders(), ["test"; 6]);
}

#[test]
fn test_views_never_choose_anything() {
    let world = World::with_edit("val_views = 2", "val_views = 0");
    let refused = world.call("run", &["-s", METHOD, "--sweep", SPACE, "--trials", "3"]);
    assert!(refused.code == 3 && refused.stderr.contains("no validation views"), "{}", refused.stderr);
    let begun = std::fs::read_dir(world.path("store/checkpoints")).unwrap().count();
    assert!(begun == 0 && records_of(&world, "training").is_empty(), "no trial has begun a training");
    let several = World::tiny().call("run", &["--sweep", SPACE]);
    assert!(several.code == 3 && several.stderr.contains("of one method"), "{}", several.stderr);
    let wrong = World::tiny().call("run", &["--sweep", "nodes.train.params.loss.lambda=0.1,0.2", "-s", METHOD]);
    assert!(wrong.code == 3 && wrong.stderr.contains("lambda_dssim"), "{}", wrong.stderr);
}

#[test]
fn a_grid_counts_the_values_of_a_parameter_with_a_condition_on_an_axis() {
    let world = World::tiny();
    let conditional = "nodes.train.params.loss.lambda_dssim=0.1,0.2 when method=static3dgs";
    let space = ["--sweep", conditional, "--sweep", "nodes.train.params.density.max_count=300,400"];
    world.call("run", &[&["-s", METHOD], &space[..]].concat()).ok();
    assert_eq!(entries(&world), 4);
}

#[test]
fn options_of_searches_and_of_single_runs_do_not_mix() {
    let world = World::tiny();
    let alone = world.call("run", &["--within", "8h"]);
    assert!(alone.code == 2 && alone.stderr.contains("--within belongs to a search"), "{}", alone.stderr);
    let twice = world.call("run", &["-s", METHOD, "--sweep", SPACE, "--sweep", SPACE]);
    assert!(twice.code == 2 && twice.stderr.contains("lambda_dssim occurs twice"), "{}", twice.stderr);
    let text = std::fs::read_to_string(world.recipe()).unwrap();
    std::fs::write(world.recipe(), format!("{text}[sweep.parameters]\n\"nodes.train.params.seed\" = [1, 2]\n"))
        .unwrap();
    let frozen = world.call("run", &["-s", METHOD, "--frozen"]);
    assert!(frozen.code == 3 && frozen.stderr.contains("a search does not have --frozen"), "{}", frozen.stderr);
    assert!(!world.path("store").exists(), "nothing ran");
}

#[test]
fn a_search_without_time_fails_no_trial() {
    let ended = World::tiny().call("run", &["-s", METHOD, "--sweep", SPACE, "--within", "1ms"]);
    assert!(ended.code == 4 && ended.stdout.contains("No trial is completed yet"), "{}", ended.stderr);
}

#[test]
fn any_column_can_be_the_objective_and_limits_discard_trials() {
    let world = World::tiny();
    let space = "nodes.train.params.density.max_count=300,400";
    let search = |arguments: &[&str]| world.call("run", &[&["-s", METHOD, "--sweep", space], arguments].concat());
    let report = search(&["--objective", "ssim", "--limit", "gaussians<=100000"]).ok();
    assert!(report.contains("| completed trial | SSIM |") && report.contains("`gaussians<=100000`"), "{report}");
    assert!(objectives(&world).values().all(|objective| objective.is_some_and(|ssim| 0.0 < ssim && ssim < 1.0)));
    assert_eq!(rendered_splits(&world), ["val"; 4], "whatever a search renders, it is no test view");

    let world = World::tiny();
    let search = |arguments: &[&str]| world.call("run", &[&["-s", METHOD, "--sweep", space], arguments].concat());
    let none = search(&["--objective", "training_secs", "--limit", "gaussians<=10"]);
    assert_eq!(none.code, 10, "{}", none.stderr);
    assert!(none.stderr.contains("breaks the limit gaussians<=10"), "{}", none.stderr);
    assert!(history(&world).values().all(|entry| entry["values"]["gaussians"].as_f64() > Some(10.0)));
    let unknown = search(&["--limit", "gaussian<=10"]);
    assert!(unknown.code == 2 && unknown.stderr.contains("did you mean `gaussians`?"), "{}", unknown.stderr);
}

#[test]
fn a_goal_that_cannot_be_measured_is_refused_before_any_training() {
    let world = World::tiny();
    let search = |arguments: &[&str]| world.call("run", &[&["-s", METHOD, "--sweep", SPACE], arguments].concat());
    for goal in [["--objective", "lpips_alex"], ["--limit", "lpips_alex<=0.5"]] {
        let refused = search(&goal);
        let (code, text) = (refused.code, &refused.stderr);
        assert!(code == 3 && text.contains("alexnet-owt-7be5be79.pth is missing"), "{text}");
        assert!(text.contains("pipeline data fetch lpips"), "{text}");
    }
    let left_out = search(&["--objective", "ssim", "-s", "nodes.metrics.params.metrics=[\"psnr\"]"]);
    let reason = "ssim cannot be measured: nodes.metrics.params.metrics does not list it";
    assert!(left_out.code == 3 && left_out.stderr.contains(reason), "{}", left_out.stderr);
    assert!(!world.path("store/sweeps").exists(), "no trial began");
}

#[test]
fn another_seed_is_another_search() {
    let world = World::tiny();
    let search = |arguments: &[&str]| {
        let ended = world.call("run", &[&["-s", METHOD, "--sweep", SPACE, "--trials", "1"], arguments].concat());
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        ended.stderr.contains("continues the search in ")
    };
    assert!(!search(&["--sweep-seed", "1"]) && !search(&["--sweep-seed", "2"]));
    assert!(!search(&["--sweep-seed", "1", "--strategy", "sobol"]));
    assert!(search(&["--sweep-seed", "1"]) && search(&["--sweep-seed", "2"]));
    assert_eq!(std::fs::read_dir(world.path("store/sweeps")).unwrap().count(), 3);
}

#[test]
fn conditions_set_parameters_for_some_methods_only() {
    let world = World::tiny();
    let methods = r#"axes.method=["static3dgs"],["deformable4dgs"]"#;
    let channels = "nodes.train.params.deformable4dgs.channels=2,4 when method=deformable4dgs";
    world.call("run", &["--sweep", methods, "--sweep", channels]).ok();
    let all: Vec<String> = history(&world).values().map(|entry| entry["assignments"].to_string()).collect();
    assert_eq!(all.len(), 3, "{all:?}");
    assert!(all.iter().all(|text| text.contains("channels") == text.contains("deformable4dgs\\")), "{all:?}");
    let unknown = world.call("run", &["--sweep", methods, "--sweep", &channels.replace("when method", "when methd")]);
    assert!(unknown.code == 3 && unknown.stderr.contains("when methd: neither"), "{}", unknown.stderr);
    let misspelt = channels.replace("=deformable4dgs", "=deformabel4dgs");
    let refused = world.call("run", &["--sweep", methods, "--sweep", &misspelt]);
    assert!(refused.code == 3 && refused.stderr.contains("did you mean `deformable4dgs`?"), "{}", refused.stderr);
}

#[test]
fn workers_share_a_search() {
    let (alone, shared) = (World::tiny(), World::tiny());
    let space = "nodes.train.params.density.max_count=250,300,350,400";
    alone.call("run", &["-s", METHOD, "--sweep", space]).ok();
    let report = shared.call("run", &["-s", METHOD, "--sweep", space, "--workers", "2"]).ok();
    assert!(report.contains("Best:"), "{report}");
    assert_eq!(objectives(&shared), objectives(&alone));
    let again = shared.call("run", &["-s", METHOD, "--sweep", space]);
    assert!(!again.stderr.contains("trial "), "nothing is left to do: {}", again.stderr);
}
