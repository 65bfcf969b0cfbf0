//! The first day of a new user: the program alone in an empty folder, a run that is interrupted, and its end.

use std::process::Command;

use crate::product::{Ended, World, program, root};

/// The program in `folder`.
fn program_in(folder: &std::path::Path, arguments: &[&str]) -> Ended {
    let mut command: Command = program(arguments);
    command.current_dir(folder);
    Ended::of(command)
}

#[test]
fn one_binary_in_an_empty_folder_is_enough() {
    let folder = tempfile::tempdir().expect("a folder for the test");
    let call = |arguments: &[&str]| program_in(folder.path(), arguments);
    let listed = call(&["recipes", "list"]).ok();
    assert!(listed.contains("quickstart") && listed.contains("parts to extend: ablation, benchmark"), "{listed}");
    for name in listed.lines().take_while(|line| !line.is_empty()).filter_map(|line| line.split_whitespace().next()) {
        let builtin = call(&["plan", &format!("builtin:{name}"), "--json"]).ok();
        let file = root().join(format!("recipes/{name}.toml")).display().to_string();
        let planned: [serde_json::Value; 2] =
            [builtin, call(&["plan", &file, "--json"]).ok()].map(|text| serde_json::from_str(&text).expect("JSON"));
        let [jobs, of_file] = planned.map(|plan| plan["jobs"].as_object().expect("a table").len());
        assert_eq!(jobs, of_file, "{name}");
    }
    let copied = call(&["recipes", "copy", "quickstart"]);
    assert!(copied.stderr.contains("pipeline run quickstart.toml"), "{}", copied.stderr);
    let text = std::fs::read_to_string(folder.path().join("quickstart.toml")).expect("the copy");
    assert!(
        text.contains("extends = [\"builtin:benchmark\"]") && text.contains("recipe = \"quickstart.toml\""),
        "{text}"
    );
    assert!(call(&["plan", "quickstart.toml"]).ok().contains("17 will run; about "));
    assert_eq!(call(&["recipes", "copy", "quickstart"]).code, 3, "an existing file is kept");
    assert!(call(&["plan", "quickstrat"]).stderr.contains("did you mean quickstart.toml?"));
    assert!(call(&["recipes", "show", "quick"]).stderr.contains("choose one: "));
    let sets = call(&["data", "list"]).ok();
    for line in ["dnerf           0 of 8 scenes in data/dnerf", "cmu-panoptic-hd 0 of 3 scenes in data/cmu-panoptic-hd"]
    {
        assert!(sets.contains(line), "{sets}");
    }
    assert!(call(&["data", "show", "dnerf"]).ok().contains("[[scene]]"));
    let doctor = call(&["doctor", "--device", "cpu"]).ok();
    for expected in ["LPIPS        not measured: put alexnet-owt-7be5be79.pth", "free for the store", "built in"] {
        assert!(doctor.contains(expected), "no {expected} in\n{doctor}");
    }
    assert!(!doctor.contains("stage "), "{doctor}");
}

#[test]
fn finished_cells_of_an_unfinished_run_have_a_table() {
    let world = World::tiny();
    let nothing = world.call("table", &["--partial"]);
    assert!(nothing.code == 4 && nothing.stderr.contains("no job of the table has a result"), "{}", nothing.stderr);
    let cell = world.call("run", &["--only", "metrics/swinging-arm/static3dgs/*"]);
    assert!(cell.code == 0 && cell.stdout.is_empty(), "{}", cell.stdout);
    let table = world.call("table", &["--partial"]).ok();
    let row = |method: &str| table.lines().find(|line| line.starts_with(&format!("| {method} |"))).map(str::to_owned);
    let finished = row("static3dgs").unwrap_or_else(|| panic!("no row in\n{table}"));
    assert!(finished.contains(|c: char| c.is_ascii_digit()), "{finished}");
    assert!(table.contains("not run yet"), "{table}");
    assert_eq!(world.call("table", &[]).code, 4, "an unfinished table is not the table");

    let ended = world.call("run", &[]);
    assert!(ended.code == 0 && ended.stdout.is_empty(), "{}", ended.stdout);
    let ending: Vec<&str> = ended.stderr.lines().skip_while(|line| !line.contains(" executed, ")).collect();
    assert!((3..=10).contains(&ending.len()), "{ending:#?}");
    assert!(ending[1].starts_with("best PSNR (dB): ") && ending[1].contains("mean of 2 scenes"), "{ending:#?}");
    assert!(ending.last().is_some_and(|line| line.ends_with("report/index.html")), "{ending:#?}");
    let plan = world.call("plan", &["-s", "nodes.train.params.schedule_scale=2"]).ok();
    assert!(plan.contains("; about ") && !plan.contains("unknown"), "{plan}");
    let plan =
        world.call("plan", &["-s", "nodes.capture.params.width=4000", "-s", "nodes.capture.params.height=4000"]).ok();
    assert!(plan.contains("time unknown: nothing comparable to "), "15,625 times the pixels\n{plan}");
}
