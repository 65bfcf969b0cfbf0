//! Searches over parameters, as users start, interrupt and continue them.

use std::path::PathBuf;

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
    std::fs::read_to_string(file(world, "history.jsonl")).expect("a history").lines().count()
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
    search("9").ok();
    let (all, history) = (entries(&world), std::fs::read_to_string(file(&world, "history.jsonl")).unwrap());
    assert!(all > first + 6, "{history}");
    let best = file(&world, "best.toml");
    let recipe = best.display().to_string();
    let store = world.path("store").display().to_string();
    let plan = |arguments: &[&str]| {
        let all = [&["plan", &recipe, "--store", &store, "--only", "train"], arguments].concat();
        crate::product::Ended::of(crate::product::program(&all)).ok()
    };
    let cached = plan(&["-s", "axes.seed=[0]"]);
    assert_eq!(cached.matches("cached       train/").count(), 2, "{cached}");
    assert!(!plan(&[]).contains("cached       train/"), "judged with the seeds that chose it");
}

#[test]
fn a_grid_completes_every_combination() {
    let world = World::tiny();
    let space = "nodes.train.params.density.max_count=300,400";
    let report = world.call("run", &["-s", METHOD, "--sweep", space]).ok();
    assert!(report.contains("max_count=300") && report.contains("max_count=400"), "{report}");
    assert_eq!(entries(&world), 2);
}

#[test]
fn test_views_never_choose_anything() {
    let world = World::with_edit("val_views = 2", "val_views = 0");
    let refused = world.call("run", &["-s", METHOD, "--sweep", SPACE, "--trials", "3"]);
    assert!(refused.code == 3 && refused.stderr.contains("no validation views"), "{}", refused.stderr);
    let several = World::tiny().call("run", &["--sweep", SPACE]);
    assert!(several.code == 3 && several.stderr.contains("of one method"), "{}", several.stderr);
    let wrong = World::tiny().call("run", &["--sweep", "nodes.train.params.loss.lambda=0.1,0.2", "-s", METHOD]);
    assert!(wrong.code == 3 && wrong.stderr.contains("lambda_dssim"), "{}", wrong.stderr);
}
