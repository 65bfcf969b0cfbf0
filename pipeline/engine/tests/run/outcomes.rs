//! Outcomes of jobs that do not succeed.

use std::fs;
use std::time::Duration;

use engine::event::{Event, Outcome};
use engine::{FailureKind, exit};

use crate::world::{GRID, World, nodes};

pub(crate) const TESTS: &[(&str, fn())] = &[
    ("failures_are_typed_and_other_jobs_continue", failures_are_typed_and_other_jobs_continue),
    #[cfg(target_os = "linux")]
    ("a_full_disk_in_a_job_is_a_machine_failure", a_full_disk_in_a_job_is_a_machine_failure),
    ("invalid_artifacts_are_not_published", invalid_artifacts_are_not_published),
    ("code_that_changed_since_the_plan_is_refused", code_that_changed_since_the_plan_is_refused),
    ("failing_fast_launches_no_more_jobs", failing_fast_launches_no_more_jobs),
    ("missing_data_skips_dependent_jobs", missing_data_skips_dependent_jobs),
    ("a_run_of_missing_data_only_is_not_a_success", a_run_of_missing_data_only_is_not_a_success),
    ("jobs_past_their_time_limit_are_stopped", jobs_past_their_time_limit_are_stopped),
    ("interrupted_job_resumes", interrupted_job_resumes),
    ("runs_stop_when_their_reader_is_gone", runs_stop_when_their_reader_is_gone),
    ("a_second_stop_ends_unresponsive_jobs", a_second_stop_ends_unresponsive_jobs),
    ("thread_slots_are_respected", thread_slots_are_respected),
    ("events_are_kept_as_json_lines", events_are_kept_as_json_lines),
];

/// A recipe with one text, jobs on it that fail in the given ways, a second job after each, and a list of all results.
fn failing(ways: &str) -> World {
    World::new(&format!(
        r#"
[axes]
way = [{ways}]
[nodes.text]
stage = "test-write"
params = {{ text = "t" }}
[nodes.work]
stage = "test-work"
over = ["way"]
inputs = {{ text = "text" }}
params = {{ fail = "{{way}}", steps = 3 }}
[nodes.more]
stage = "test-work"
over = ["way"]
inputs = {{ text = "work" }}
[nodes.list]
stage = "test-list"
inputs = {{ texts = "more" }}
"#
    ))
}

fn failures_are_typed_and_other_jobs_continue() {
    let world = failing(r#""no", "error", "diverged", "panic", "abort""#);
    let summary = world.run(&[]);
    let failure = |way: &str| summary.results[&format!("work/{way}")].failure.clone().unwrap();
    assert_eq!(failure("error").kind, FailureKind::BadInput);
    assert_eq!(failure("diverged").kind, FailureKind::Diverged);
    assert_eq!(failure("panic").to_string(), "panicked: panicked on request; this is a bug; the log has a backtrace");
    assert_eq!(failure("abort").to_string(), "killed by SIGABRT");
    assert_eq!(nodes(&summary, Outcome::Skipped), ["more/abort", "more/diverged", "more/error", "more/panic"]);
    assert_eq!(summary.results["more/abort"].because_of.as_deref(), Some("work/abort"));
    // The list has all five, and the kinds of failures.
    let list = world.text(&summary, "list");
    let lines = [
        r#"{"way": "no"} txxxx"#,
        r#"{"way": "error"} BadInput"#,
        r#"{"way": "diverged"} Diverged"#,
        r#"{"way": "panic"} Crashed"#,
        r#"{"way": "abort"} Crashed"#,
    ];
    assert_eq!(list.trim_start(), lines.join("\n"));
    assert_eq!(summary.exit_code(false), exit::FAILED);
    // A failure is never a cache hit; the unchanged list is.
    let again = world.run(&[]);
    assert_eq!((again.counts.executed, again.counts.failed), (0, 4));
}

#[cfg(target_os = "linux")]
/// Every write to `/dev/full` fails like a write to a full disk.
fn a_full_disk_in_a_job_is_a_machine_failure() {
    let world = failing(r#""no", "full""#);
    let summary = world.run(&[]);
    let failure = summary.results["work/full"].failure.clone().unwrap();
    assert_eq!(failure.kind, FailureKind::World);
    let message = failure.to_string();
    assert!(message.starts_with("cannot write the text: No space left on device"), "{message}");
    assert!(message.contains("free space"), "{message}");
    assert_eq!(summary.exit_code(false), exit::INFRASTRUCTURE);
    let log_dir = summary.results["work/full"].log_dir.clone().unwrap();
    let log = fs::read_to_string(log_dir.join("log")).unwrap();
    assert!(log.contains("started work/full: stage test-work, 1 threads, device cpu"), "{log}");
    assert!(log.contains("ERROR") && log.contains("failed (machine failure): cannot write the text"), "{log}");
    let log = fs::read_to_string(log_dir.with_file_name("no").join("log")).unwrap();
    assert!(log.contains("step 3/3: 4 letters") && log.contains("published "), "{log}");
}

fn invalid_artifacts_are_not_published() {
    let world = World::new("[nodes.text]\nstage = \"test-write\"\nparams = { text = \"invalid\" }\n");
    let summary = world.run(&[]);
    let message = summary.results["text"].failure.as_ref().unwrap().to_string();
    assert_eq!(message, "test-write returned a text that is not valid: the text contains `invalid`");
    assert!(world.store().records().unwrap().is_empty());
}

fn code_that_changed_since_the_plan_is_refused() {
    let world = failing(r#""no""#);
    let rebuilt = |options: &mut engine::scheduler::RunOptions| options.command[1] = "exec-rebuilt-job".into();
    let summary = world.run_with(&[], rebuilt, |_, _| ());
    assert_eq!(nodes(&summary, Outcome::Executed), ["list", "text"]);
    let message = summary.results["work/no"].failure.as_ref().unwrap().to_string();
    assert_eq!(message, "the pipeline binary was rebuilt during this run; run again");
}

fn failing_fast_launches_no_more_jobs() {
    let world = failing(r#""error", "no""#);
    let one_at_a_time = |options: &mut engine::scheduler::RunOptions| {
        options.max_failures = Some(1);
        options.jobs = 1;
    };
    let summary = world.run_with(&[], one_at_a_time, |_, _| ());
    assert_eq!(nodes(&summary, Outcome::Failed), ["work/error"]);
    assert_eq!(nodes(&summary, Outcome::NotRun), ["list", "more/no", "work/no"]);
    assert_eq!(summary.exit_code(false), exit::FAILED);
}

/// [`GRID`] with texts from files.
fn from_files() -> World {
    World::new(&GRID.replace("text = \"{scene}:\"", "source = \"{scene}.txt\""))
}

fn missing_data_skips_dependent_jobs() {
    let world = from_files();
    fs::write(world.root.join("data/ball.txt"), "ball:").unwrap();
    let summary = world.run(&[]);
    assert_eq!(nodes(&summary, Outcome::MissingData), ["text/lego"]);
    assert_eq!(nodes(&summary, Outcome::Skipped), ["work/lego/p", "work/lego/q"]);
    let message = summary.results["text/lego"].failure.as_ref().unwrap().to_string();
    assert!(message.contains("--data-root") && message.ends_with("data/lego.txt"), "{message}");
    assert!(world.text(&summary, "list").contains("MissingData"));
    assert_eq!((summary.exit_code(false), summary.exit_code(true)), (exit::OK, exit::FAILED));

    fs::write(world.root.join("data/lego.txt"), "lego:").unwrap();
    let complete = world.run(&[]);
    assert_eq!(nodes(&complete, Outcome::Cached), ["text/ball", "work/ball/p", "work/ball/q"]);
    assert_eq!(complete.counts.executed, 4);
}

fn a_run_of_missing_data_only_is_not_a_success() {
    let world = from_files();
    let summary = world.run(&[]);
    assert_eq!((summary.counts.missing_data, summary.counts.skipped, summary.counts.executed), (2, 4, 1));
    assert!(world.text(&summary, "list").contains("MissingData"), "the list shows what is missing");
    assert_eq!((summary.exit_code(false), summary.exit_code(true)), (exit::NOTHING, exit::FAILED));
}

fn jobs_past_their_time_limit_are_stopped() {
    let world = failing(r#""no""#);
    let limit = |options: &mut engine::scheduler::RunOptions| options.timeout = Some(Duration::from_millis(300));
    let slow = ["nodes.work.params.sleep_millis=200", "nodes.work.params.steps=50"];
    let summary = world.run_with(&slow, limit, |_, _| ());
    assert_eq!(summary.results["work/no"].failure.as_ref().unwrap().kind, FailureKind::Timeout);
    assert_eq!(summary.results["more/no"].outcome, Outcome::Skipped);
}

fn interrupted_job_resumes() {
    let world = failing(r#""no""#);
    let slow = ["nodes.work.params.sleep_millis=30", "nodes.work.params.steps=12"];
    let stop_after_two = |options: &engine::scheduler::RunOptions, event: &Event| {
        let two_done = matches!(event, Event::Progress { node, progress } if node == "work/no" && progress.done >= 2);
        if two_done && options.stop.count() == 0 {
            options.stop.request(libc::SIGINT);
        }
    };
    let stopped = world.run_with(&slow, |_| (), stop_after_two);
    assert_eq!(nodes(&stopped, Outcome::Interrupted), ["work/no"]);
    assert_eq!(nodes(&stopped, Outcome::Skipped), ["list", "more/no"]);
    assert_eq!(stopped.exit_code(false), exit::INTERRUPTED);

    let predicted = crate::predict::predicted(&world, &slow);
    let expected = "work/no: will run (interrupted, continues from a checkpoint)";
    assert!(predicted.iter().any(|line| line == expected), "{predicted:?}");

    let resumed = world.run(&slow);
    assert_eq!(world.text(&resumed, "work/no"), "txxxxxxxxxxxx");
    let store = world.store();
    let records = store.records().unwrap();
    let record = records.iter().find(|record| record.provenance.node == "work/no").unwrap();
    let measured = store.read_measurements(&record.measurements).unwrap();
    assert!(measured["resumed_steps"].as_u64().unwrap() >= 2, "{measured}");
    assert!(record.provenance.peak_rss_bytes.is_none_or(|bytes| bytes > 100_000));
    assert!(!store.checkpoint_dir(record.key.as_str()).exists(), "checkpoints go when the result is there");
}

fn runs_stop_when_their_reader_is_gone() {
    let world = failing(r#""no""#);
    let slow = ["nodes.work.params.sleep_millis=30", "nodes.work.params.steps=100"];
    let stop_at_start = |options: &engine::scheduler::RunOptions, event: &Event| {
        if matches!(event, Event::Started { node, .. } if node == "work/no") {
            options.stop.reader_is_gone();
        }
    };
    let stopped = world.run_with(&slow, |_| (), stop_at_start);
    assert_eq!(nodes(&stopped, Outcome::Interrupted), ["work/no"], "{:?}", stopped.results);
    assert_eq!(stopped.exit_code(false), exit::READER_GONE);
}

fn a_second_stop_ends_unresponsive_jobs() {
    let world = failing(r#""hang""#);
    let stop_twice = |options: &engine::scheduler::RunOptions, event: &Event| {
        if matches!(event, Event::Started { node, .. } if node == "work/hang") {
            options.stop.request(libc::SIGINT);
            options.stop.request(libc::SIGINT);
            options.stop.request(libc::SIGINT);
        }
    };
    let stopped = world.run_with(&[], |_| (), stop_twice);
    assert_eq!(nodes(&stopped, Outcome::Interrupted), ["work/hang"]);
}

fn thread_slots_are_respected() {
    let world = World::new(GRID);
    let (mut running, mut most) = (0_usize, 0);
    let watch = |_: &_, event: &Event| match event {
        Event::Started { .. } => {
            running += 1;
            most = most.max(running);
        }
        Event::Finished { .. } => running = running.saturating_sub(1),
        _ => {}
    };
    let summary = world.run_with(&[], |options| (options.jobs, options.threads) = (8, 2), watch);
    assert_eq!((most, summary.counts.executed), (2, 7));
}

fn events_are_kept_as_json_lines() {
    let world = World::new(GRID);
    let summary = world.run(&[]);
    let text = fs::read_to_string(world.store().run_dir(&summary.run).join("events.jsonl")).unwrap();
    let events: Vec<Event> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let finished = |event: &&Event| matches!(event, Event::Finished { .. });
    assert_eq!(events.iter().filter(finished).count(), 7);
    assert!(matches!(events.first(), Some(Event::Planned { jobs: 7, .. })));
    assert!(matches!(events.last(), Some(Event::RunFinished { counts, .. }) if counts.executed == 7));
}
