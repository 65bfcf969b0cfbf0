//! Reuse of results: which jobs a change reruns.

use std::fs;

use engine::DeviceClass;
use engine::event::{Event, Outcome};
use engine::scheduler::{self, RunOptions};

use crate::world::{GRID, World, contents, nodes};

pub(crate) const TESTS: &[(&str, fn())] = &[
    ("second_run_executes_nothing", second_run_executes_nothing),
    ("a_changed_parameter_reruns_its_dependents", a_changed_parameter_reruns_its_dependents),
    ("an_equal_result_cuts_the_rerun_off", an_equal_result_cuts_the_rerun_off),
    ("equal_actions_run_once", equal_actions_run_once),
    ("an_optional_input_is_read_if_it_is_wired", an_optional_input_is_read_if_it_is_wired),
    ("relayed_measurements_reach_the_job_and_no_key", relayed_measurements_reach_the_job_and_no_key),
    ("a_renamed_axis_value_reruns_only_jobs_that_show_it", a_renamed_axis_value_reruns_only_jobs_that_show_it),
    ("damaged_blobs_are_recomputed", damaged_blobs_are_recomputed),
    ("forced_jobs_run_again", forced_jobs_run_again),
    ("jobs_on_a_device_run_once_per_class_of_devices", jobs_on_a_device_run_once_per_class_of_devices),
    ("selection_runs_only_what_it_needs", selection_runs_only_what_it_needs),
    ("a_source_that_changes_during_its_job_is_not_recorded", sources),
    ("a_job_runs_without_an_optional_source_and_again_with_it", optional_sources),
    ("two_runs_share_one_store", two_runs_share_one_store),
];

fn second_run_executes_nothing() {
    let world = World::new(GRID);
    let first = world.run(&[]);
    assert_eq!(first.counts.executed, 7);
    assert_eq!(world.text(&first, "work/lego/q"), "lego:qqq");
    let list = world.text(&first, "list");
    assert_eq!(list.lines().count(), 5);
    assert!(list.contains(r#"{"scene": "ball", "seed": "p"} ball:ppp"#), "{list}");
    assert_eq!(first.exit_code(true), engine::exit::OK);

    let second = world.run(&[]);
    assert_eq!((second.counts.executed, second.counts.cached), (0, 7));
    assert_eq!(contents(&second), contents(&first));
}

fn a_changed_parameter_reruns_its_dependents() {
    let world = World::new(GRID);
    world.run(&[]);
    // A different spelling of the same value changes nothing.
    let same = world.run(&["nodes.work.params.rate=1e-3"]);
    assert_eq!(same.counts.executed, 0);
    let rule = "\n[[set]]\nwhen = { scene = \"lego\" }\nnodes.work.params.steps = 4\n";
    fs::write(world.root.join("recipe.toml"), format!("{GRID}{rule}")).unwrap();
    let changed = world.run(&[]);
    assert_eq!(nodes(&changed, Outcome::Executed), ["list", "work/lego/p", "work/lego/q"]);
    assert_eq!(world.text(&changed, "work/lego/p"), "lego:pppp");
}

fn an_equal_result_cuts_the_rerun_off() {
    let world = World::new(GRID);
    world.run(&["nodes.work.params.keep=2"]);
    // Another letter, but only "ba" and "le" are kept, so the list's inputs stay equal.
    let cut = world.run(&["nodes.work.params.keep=2", "nodes.work.params.letter='z'"]);
    assert_eq!(nodes(&cut, Outcome::Executed), ["work/ball/p", "work/lego/p"]);
    assert_eq!(cut.results["list"].outcome, Outcome::Cached);
}

fn jobs_on_a_device_run_once_per_class_of_devices() {
    let world = World::new(GRID);
    world.run(&[]);
    let run_on = |device: &str| {
        let mut plan = world.plan(&[]);
        plan.device = DeviceClass::Gpu;
        let options = RunOptions { device: device.into(), ..world.options(&plan) };
        scheduler::run(&plan, &world.store(), &options, &mut |_| ()).unwrap()
    };
    // The texts are equal, so the list's inputs stay equal.
    let on_gpu = run_on("card 7");
    assert_eq!(nodes(&on_gpu, Outcome::Executed), ["work/ball/p", "work/ball/q", "work/lego/p", "work/lego/q"]);
    let records = world.store().records().unwrap();
    let mut of_gpu = records.iter().filter(|record| record.components.environment == "gpu");
    let measured = world.store().read_measurements(&of_gpu.next().unwrap().measurements).unwrap();
    assert_eq!((&measured["device"], of_gpu.count()), (&"card 7".into(), 3), "{measured}");
    // Another GPU is of the same class, and the results of the CPU are still in the store.
    assert_eq!(run_on("card 8").counts.executed, 0);
    assert_eq!(world.run(&[]).counts.executed, 0);
}

fn an_optional_input_is_read_if_it_is_wired() {
    const JOIN: &str = r#"
[nodes.a]
stage = "test-write"
params.text = "a"
[nodes.b]
stage = "test-write"
params.text = "b"
[nodes.joined]
stage = "test-join"
inputs = { text = "a" }
"#;
    let world = World::new(JOIN);
    let alone = world.run(&[]);
    assert_eq!(world.text(&alone, "joined"), "a");
    let both = world.run(&["nodes.joined.inputs.suffix='b'"]);
    assert_eq!(nodes(&both, Outcome::Executed), ["joined"]);
    assert_eq!(world.text(&both, "joined"), "ab");
    // An automatic choice has the key of the explicit choice that it resolves to.
    let named = world.run(&["nodes.joined.inputs.suffix='b'", "nodes.joined.params.suffix=true"]);
    assert_eq!(named.counts.executed, 0);
    let without = world.run(&["nodes.joined.inputs.suffix='b'", "nodes.joined.params.suffix=false"]);
    assert_eq!((without.counts.executed, without.results.len()), (0, 2), "left out is as if it were not wired");
    assert_eq!(without.results["joined"].content, alone.results["joined"].content);
}

fn relayed_measurements_reach_the_job_and_no_key() {
    const JOIN: &str = r#"
[nodes.a]
stage = "test-write"
[nodes.work]
stage = "test-work"
inputs.text = "a"
[nodes.joined]
stage = "test-join"
inputs.text = "work"
"#;
    let world = World::new(JOIN);
    world.run(&[]);
    let again = world.run_with(&[], |options| options.force.extend([1]), |_, _| ());
    assert_eq!(nodes(&again, Outcome::Executed), ["work"]);
    let records = world.store().records().unwrap();
    let joined = records.iter().find(|record| record.provenance.node == "joined").unwrap();
    let measured = world.store().read_measurements(&joined.measurements).unwrap();
    assert_eq!(measured["of_text"]["resumed_steps"], 0, "{measured}");
    assert!(measured["of_text"]["job"]["wall_secs"].as_f64().unwrap() > 0.0);
}

fn equal_actions_run_once() {
    let world = World::new(GRID);
    let summary = world.run(&["nodes.work.params.letter='z'"]);
    // Both seeds now have the same key, so the second takes the first one's result.
    assert_eq!(summary.counts.executed, 5);
    assert_eq!(summary.results["work/ball/p"].content, summary.results["work/ball/q"].content);
    assert_eq!(world.text(&summary, "list").lines().count(), 5);
}

fn a_renamed_axis_value_reruns_only_jobs_that_show_it() {
    let recipe = GRID.replace("text = \"{scene}:\"", "text = \"same\"");
    let world = World::new(&recipe);
    world.run(&[]);
    fs::write(world.root.join("recipe.toml"), recipe.replace("\"lego\"", "\"brick\"")).unwrap();
    assert_eq!(nodes(&world.run(&[]), Outcome::Executed), ["list"]);
}

fn damaged_blobs_are_recomputed() {
    let world = World::new(GRID);
    let first = world.run(&[]);
    let store = world.store();
    let blob_of = |node: &str| {
        let manifest = store.manifest(&first.results[node].content.unwrap()).unwrap();
        store.blob_path(&manifest.files[0].sha256)
    };
    fs::remove_file(blob_of("work/ball/p")).unwrap();
    let corrupt = blob_of("text/lego");
    fs::remove_file(&corrupt).unwrap();
    fs::write(&corrupt, "LEGO:").unwrap();

    let mut warnings = Vec::new();
    let second = world.run_with(
        &[],
        |_| (),
        |_, event| {
            if let Event::Warning { message } = event {
                warnings.push(message.clone());
            }
        },
    );
    assert_eq!(nodes(&second, Outcome::Executed), ["text/lego", "work/ball/p"]);
    assert_eq!(warnings, ["text/lego runs again: text.txt is corrupt", "work/ball/p runs again: text.txt is missing"]);
    assert_eq!(contents(&second), contents(&first));
    assert_eq!(world.run(&[]).counts.executed, 0);
    assert!(store.root().join("quarantine").read_dir().unwrap().count() > 0);
}

fn forced_jobs_run_again() {
    let world = World::new(GRID);
    let first = world.run(&[]);
    let force = world.plan(&[]).select(&["work/ball".into()]).unwrap();
    let second = world.run_with(&[], |options| options.force = force, |_, _| ());
    assert_eq!(nodes(&second, Outcome::Executed), ["work/ball/p", "work/ball/q"]);
    assert_eq!(contents(&second), contents(&first));
}

fn selection_runs_only_what_it_needs() {
    let world = World::new(GRID);
    let targets = world.plan(&[]).select(&["work/lego/q".into()]).unwrap();
    let summary = world.run_with(&[], |options| options.targets = targets, |_, _| ());
    assert_eq!(nodes(&summary, Outcome::Executed), ["text/lego", "work/lego/q"]);
    assert_eq!(summary.sinks, ["work/lego/q"]);
}

fn sources() {
    let recipe = "[nodes.text]\nstage = \"test-write\"\nparams = { source = \"in.txt\" }\n\
        [nodes.work]\nstage = \"test-work\"\ninputs = { text = \"text\" }\n";
    let world = World::new(recipe);
    let file = world.root.join("data/in.txt");
    fs::write(&file, "one").unwrap();
    assert_eq!(world.text(&world.run(&[]), "work"), "onex");
    assert_eq!(world.run(&[]).counts.executed, 0);
    fs::write(&file, "two").unwrap();
    assert_eq!(world.text(&world.run(&[]), "work"), "twox");

    // A source that changes between hashing and the end of the job is used and reported, but not recorded.
    fs::write(&file, "three").unwrap();
    let touch = |_: &_, event: &Event| {
        if matches!(event, Event::Started { node, .. } if node == "text") {
            fs::write(&file, "four").unwrap();
        }
    };
    let moved = world.run_with(&[], |_| (), touch);
    let note = moved.results["text"].note.clone().unwrap_or_default();
    assert!(note.contains("changed while the job ran"), "{note}");
    fs::write(&file, "three").unwrap();
    assert_eq!(world.text(&world.run(&[]), "work"), "threex");
}

fn optional_sources() {
    let recipe = "[nodes.text]\nstage = \"test-write\"\nparams = { text = \"a\", source = \"optional/in.txt\" }\n";
    let world = World::new(recipe);
    let file = world.root.join("data/optional/in.txt");
    assert_eq!(world.text(&world.run(&[]), "text"), "a");
    fs::create_dir(world.root.join("data/optional")).unwrap();
    fs::write(&file, "b").unwrap();
    assert_eq!(world.text(&world.run(&[]), "text"), "ab");
    fs::write(&file, "c").unwrap();
    assert_eq!(world.text(&world.run(&[]), "text"), "ac");
    fs::remove_file(&file).unwrap();
    let without = world.run(&[]);
    assert_eq!((world.text(&without, "text").as_str(), without.counts.executed), ("a", 0), "the first result");
    let required = world.run(&["nodes.text.params.source=\"in.txt\""]);
    assert_eq!((required.counts.executed, required.counts.cached), (0, 0), "no job runs without a required source");
}

fn two_runs_share_one_store() {
    let world = World::new(GRID);
    let slow = ["nodes.work.params.sleep_millis=60"];
    let (one, two) = std::thread::scope(|scope| {
        let one = scope.spawn(|| world.run(&slow));
        let two = scope.spawn(|| world.run(&slow));
        (one.join().unwrap(), two.join().unwrap())
    });
    assert_eq!(contents(&one), contents(&two));
    assert_eq!(one.counts.executed + two.counts.executed, 7, "every job runs in one of the runs only");
}
