//! Runs that several processes share: whatever happens to some of them, the results are those of an undisturbed run.

use std::collections::BTreeMap;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use engine::Failure;
use engine::FailureKind;
use engine::event::{Event, Outcome};
use engine::scheduler::{self, Crew, RunOptions, RunSummary, Share};
use rustix::process::{Pid, Signal, kill_process};

use crate::world::{GRID, SHORT_LEASE, World, contents};

pub(crate) const TESTS: &[(&str, fn())] = &[
    ("workers_run_each_job_once", workers_run_each_job_once),
    ("failures_are_shared_and_retried_by_the_next_run", failures_are_shared_and_retried_by_the_next_run),
    ("killed_workers_lose_nothing", killed_workers_lose_nothing),
    ("a_frozen_worker_loses_its_jobs_and_stops", a_frozen_worker_loses_its_jobs_and_stops),
    ("a_result_counts_although_its_claim_remains", a_result_counts_although_its_claim_remains),
    ("a_restricted_process_reports_what_is_missing", a_restricted_process_reports_what_is_missing),
];

/// A larger grid whose jobs take some time.
fn slow_grid(steps: usize) -> World {
    let slow = GRID.replace("steps = 3, sleep_millis = 10", &format!("steps = {steps}, sleep_millis = 10"));
    World::new(&slow.replace(r#"seed = ["p", "q"]"#, r#"seed = ["p", "q", "r", "s"]"#))
}

/// Starts workers of a new shared run.
fn start(world: &World, count: usize) -> (String, Vec<Child>) {
    let run = scheduler::begin(&world.plan(&[]), &world.store()).unwrap();
    let start = |part: usize| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.arg("work").arg(&world.root).args([&run, &part.to_string()]);
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    let children = (0..count).map(start).collect();
    (run, children)
}

fn share(run: &str, following: Option<Crew>) -> Share {
    // The events of a follower repeat those of the workers.
    let name = if following.is_some() { "" } else { "test" }.into();
    Share { run: run.into(), name, begin: 0.0, following, only: None, missing: None, idle: None }
}

/// Takes part in the run, and returns its summary.
fn join(world: &World, share: Share) -> RunSummary {
    join_and_watch(world, share, |_| ())
}

/// Takes part in the run, calls `watch` with each event, and returns the summary.
fn join_and_watch(world: &World, share: Share, mut watch: impl FnMut(&Event)) -> RunSummary {
    world.run_with(
        &[],
        |options: &mut RunOptions| {
            (options.share, options.lease) = (Some(share), SHORT_LEASE);
            options.heartbeat = Duration::from_millis(1);
        },
        |_, event| watch(event),
    )
}

/// How often each job was executed, by the events of all processes of the run.
fn executions(world: &World, run: &str) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for entry in std::fs::read_dir(world.store().run_dir(run)).unwrap() {
        let path = entry.unwrap().path();
        if !path.file_name().unwrap().to_string_lossy().starts_with("events-") {
            continue;
        }
        for line in std::fs::read_to_string(path).unwrap().lines() {
            let event: serde_json::Value = serde_json::from_str(line).unwrap();
            if event["event"] == "started" {
                *counts.entry(event["node"].as_str().unwrap().to_owned()).or_default() += 1;
            }
        }
    }
    counts
}

fn workers_run_each_job_once() {
    let world = slow_grid(5);
    let (run, mut workers) = start(&world, 3);
    let mut running = Vec::new();
    let watch = |event: &Event| {
        if let Event::Heartbeat { counts, running: jobs } = event {
            running.push((counts.running, jobs.len()));
        }
    };
    let summary = std::thread::scope(|scope| {
        let follower = scope.spawn(|| join_and_watch(&world, share(&run, Some(Crew::default())), watch));
        workers.iter_mut().for_each(|worker| assert!(worker.wait().unwrap().success()));
        follower.join().unwrap()
    });
    assert_eq!(summary.exit_code(true), engine::exit::OK, "{:?}", summary.results);
    assert_eq!((summary.counts.executed, summary.counts.cached), (11, 0));
    assert!(running.iter().any(|&(count, _)| count > 0), "the follower shows the jobs of the workers: {running:?}");
    assert!(running.iter().all(|&(count, named)| count == named), "{running:?}");
    assert_eq!(contents(&summary), contents(&slow_grid(5).run(&[])));
    let executions = executions(&world, &run);
    assert_eq!(executions.len(), 11, "{executions:?}");
    assert!(executions.values().all(|count| *count == 1), "{executions:?}");
}

fn failures_are_shared_and_retried_by_the_next_run() {
    let world = World::new(&GRID.replace("steps = 3", "fail = \"diverged\", steps = 3"));
    let (run, mut workers) = start(&world, 2);
    workers.iter_mut().for_each(|worker| _ = worker.wait().unwrap());
    let summary = join(&world, share(&run, None));
    assert_eq!((summary.counts.failed, summary.counts.executed), (4, 3), "{:?}", summary.counts);
    assert!(summary.failures().all(|(_, result, _)| result.log_dir.as_ref().is_some_and(|dir| dir.is_dir())));
    let executions = executions(&world, &run);
    assert!(executions.values().all(|count| *count == 1), "{executions:?}");
    assert_eq!(world.run(&[]).counts.failed, 4);
}

fn killed_workers_lose_nothing() {
    let world = slow_grid(8);
    let (run, mut workers) = start(&world, 3);
    for worker in &mut workers {
        std::thread::sleep(Duration::from_millis(120));
        worker.kill().unwrap();
        worker.wait().unwrap();
    }
    let crew = Crew::default();
    crew.take_over();
    let clock = Instant::now();
    let summary = join(&world, share(&run, Some(crew)));
    assert_eq!(summary.exit_code(true), engine::exit::OK, "{:?}", summary.results);
    assert_eq!(contents(&summary), contents(&slow_grid(8).run(&[])));
    assert!(clock.elapsed() < Duration::from_secs(60) && world.store().verify(false).unwrap().is_empty());
}

fn a_frozen_worker_loses_its_jobs_and_stops() {
    let world = slow_grid(120);
    let (run, mut workers) = start(&world, 1);
    let signal = |worker: &Child, signal| kill_process(Pid::from_child(worker), signal).unwrap();
    // The child of the frozen worker is frozen, too, like on a suspended machine.
    let jobs = || crate::crash::children(&workers[0]);
    while jobs().is_empty() || world.store().claimed().unwrap().is_empty() {
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(SHORT_LEASE / 5);
    let frozen = jobs();
    signal(&workers[0], Signal::STOP);
    frozen.iter().for_each(|job| _ = kill_process(*job, Signal::STOP));
    let summary = join(&world, share(&run, None));
    assert_eq!(summary.exit_code(true), engine::exit::OK, "{:?}", summary.results);
    assert_eq!(contents(&summary), contents(&slow_grid(120).run(&[])));
    assert_eq!(summary.counts.total, summary.counts.done());

    frozen.iter().for_each(|job| _ = kill_process(*job, Signal::CONT));
    signal(&workers[0], Signal::CONT);
    let clock = Instant::now();
    assert!(workers[0].wait().unwrap().success(), "it ends with the results of the others");
    assert!(clock.elapsed() < 4 * SHORT_LEASE, "it goes on for {:?}", clock.elapsed());
    assert_eq!(contents(&world.run(&[])), contents(&summary));
    assert!(world.store().verify(false).unwrap().is_empty() && world.store().claimed().unwrap().is_empty());
}

fn a_result_counts_although_its_claim_remains() {
    let world = World::new(GRID);
    let finished = world.run(&[]);
    let store = world.store();
    let (records, hidden) = (world.root.join("store/records"), world.root.join("hidden"));
    // As if each worker had been killed between publishing its result and releasing its claim.
    let keys = finished.results.values().map(|result| serde_json::json!(result.key));
    let keys = keys.map(|key| serde_json::from_value::<engine::ActionKey>(key).unwrap());
    let claims: Vec<_> = keys.map(|key| store.try_claim(&key, "killed", 1).unwrap().unwrap()).collect();
    std::fs::rename(&records, &hidden).unwrap();
    std::fs::create_dir(&records).unwrap();
    let run = scheduler::begin(&world.plan(&[]), &store).unwrap();
    let crew = Crew::default();
    let summary = std::thread::scope(|scope| {
        let follower = scope.spawn(|| join(&world, share(&run, Some(crew.clone()))));
        std::thread::sleep(Duration::from_millis(300));
        std::fs::remove_dir(&records).unwrap();
        std::fs::rename(&hidden, &records).unwrap();
        std::thread::sleep(Duration::from_millis(300));
        crew.leave();
        follower.join().unwrap()
    });
    assert_eq!((summary.counts.done(), summary.counts.not_run), (7, 0), "{:?}", summary.results);
    drop(claims);
}

fn a_restricted_process_reports_what_is_missing() {
    let world = World::new(GRID);
    let plan = world.plan(&[]);
    let run = scheduler::begin(&plan, &world.store()).unwrap();
    let of = |template: &str| {
        let found = plan.nodes.iter().enumerate().filter(|(_, node)| node.template == template);
        Some(found.map(|(index, _)| index).collect())
    };
    let only_texts = join(&world, Share { only: of("text"), idle: Some(Duration::ZERO), ..share(&run, None) });
    assert_eq!((only_texts.counts.executed, only_texts.counts.not_run), (2, 5));
    let missing = Some(Failure::new(FailureKind::Crashed, "no process ran it"));
    let list = join(&world, Share { only: of("list"), missing, ..share(&run, None) });
    assert_eq!((list.counts.executed, list.counts.failed), (3, 4), "{:?}", list.results);
    assert!(list.results["work/ball/p"].outcome == Outcome::Failed && world.text(&list, "list").contains("Crashed"));
    // A follower of the same run learns why the jobs have no result.
    let crew = Crew::default();
    crew.leave();
    assert_eq!(join(&world, share(&run, Some(crew))).counts, list.counts);
}
