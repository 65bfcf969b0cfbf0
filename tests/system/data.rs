//! Recipes whose data is missing, entirely or in part.

use std::path::Path;

use support::fakes::Fake;

use crate::product::{Ended, World, program, root};

fn dnerf(verb: &str, data_root: &Path, store: &Path) -> Ended {
    let mut command = program(&[verb]);
    command.arg(root().join("recipes/dnerf.toml")).arg("--data-root").arg(data_root).arg("--store").arg(store);
    Ended::of(command)
}

#[test]
fn a_run_without_any_data_stops_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let run = dnerf("run", dir.path(), &dir.path().join("store"));
    assert_eq!(run.code, 4, "{}", run.stderr);
    let missing = dir.path().join("dnerf/bouncingballs").display().to_string();
    for expected in ["all data of this recipe is missing", "--data-root", &missing] {
        assert!(run.stderr.contains(expected), "no {expected} in\n{}", run.stderr);
    }
    assert!(run.stdout.is_empty() && run.stderr.lines().count() == 2, "{}", run.stderr);
    assert!(!dir.path().join("store/results").exists(), "no empty report replaces an earlier one");
    let plan = dnerf("plan", dir.path(), &dir.path().join("store")).ok();
    assert!(plan.contains("missing data capture/lego") && plan.contains("9 missing data"), "{plan}");
}

#[test]
fn existing_scenes_run_and_others_are_missing_data() {
    let Some(data) = support::data("") else { return };
    let data = root().join("tests").join(data);
    let dir = tempfile::tempdir().unwrap();
    let plan = dnerf("plan", &data, &dir.path().join("store")).ok();
    for scene in ["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex"] {
        let word = if data.join("dnerf").join(scene).exists() { "will run" } else { "missing data" };
        let line = format!("{word:<12} capture/{scene}");
        assert!(plan.lines().any(|found| found.starts_with(&line)), "no `{line}` in\n{plan}");
        if word == "will run" {
            let description =
                Ended::of(program(&["inspect", &data.join("dnerf").join(scene).display().to_string()])).ok();
            assert!(description.contains("lender") && description.contains("800"), "{description}");
        }
    }
}

#[test]
fn a_run_ends_with_the_warnings_of_the_jobs_that_it_executed() {
    let world = World::of(
        "[axes]\nscene = [\"one\", \"two\"]\n[nodes.capture]\nstage = \"sfm-import\"\nover = [\"scene\"]\n\
         params = { source = \"{scene}\" }\n",
    );
    for scene in ["one", "two"] {
        let folder = world.path("data").join(scene);
        Fake::small(3, 4).dnerf(&folder);
        std::fs::remove_file(folder.join("transforms_test.json")).unwrap();
    }
    let ended = world.call("run", &[]);
    let warning =
        "warning capture/one, capture/two: transforms_test.json is missing: the validation views serve as test views";
    assert_eq!(ended.stderr.lines().filter(|line| *line == warning).count(), 1, "{}", ended.stderr);
    assert_eq!(ended.stderr.matches("transforms_test.json is missing").count(), 1, "{}", ended.stderr);
    let again = world.call("run", &[]);
    assert!(again.code == 0 && !again.stderr.contains("warning"), "{}", again.stderr);
}
