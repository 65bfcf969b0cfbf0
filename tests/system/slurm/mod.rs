//! A recipe on a real Slurm: with and without disturbances, its artifacts are those of an undisturbed local run.

mod daemons;

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use crate::crashes::children;
use crate::product::{Ended, RunEvents, World, program};
use crate::search::objectives;
use daemons::Slurm;

/// A cluster file for the small machine of the test.
const CLUSTER: &str = r#"
poll = "1s"
patience = "6s"
signal_lead = "20s"
[class.cpu]
cpus = 1
memory = "100M"
time = "10m"
"#;

/// The longest time that a run may take.
const PATIENCE: Duration = Duration::from_secs(150);

/// A world whose trainings take a few seconds each, with a cluster file.
fn world(iterations: usize) -> World {
    let world = World::with_edit("{ train = 40 }", &format!("{{ train = {iterations} }}"));
    std::fs::write(world.path("cluster.toml"), CLUSTER).expect("the cluster file is written");
    world
}

/// `run --on slurm` with further arguments.
fn run_on(slurm: &Slurm, world: &World, arguments: &[&str]) -> Command {
    let mut command = world.command("run", &["--json", "--on", "slurm", "--cluster", "cluster.toml", "--lease", "5s"]);
    command.args(arguments).envs([slurm.variable()]);
    command
}

fn attach(slurm: &Slurm, world: &World) -> RunEvents {
    let mut command = program(&["attach", "--json", "--store"]);
    command.arg(world.path("store")).envs([slurm.variable()]).current_dir(world.path(""));
    let has_ended = AtomicBool::new(false);
    let ended = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !has_ended.load(Ordering::Relaxed) {
                slurm.resume_nodes();
                std::thread::sleep(Duration::from_secs(1));
            }
        });
        let ended = Ended::of(command);
        has_ended.store(true, Ordering::Relaxed);
        ended
    });
    RunEvents::read(&ended.ok())
}

#[test]
fn cells_and_pilots_on_slurm_give_the_results_of_a_local_run() {
    let Some(slurm) = Slurm::start() else { return };
    let (local, cells, pilots) = (world(40), world(40), world(40));
    let expected = local.run(&[]);
    let of_cells = RunEvents::read(&Ended::of(run_on(&slurm, &cells, &[])).ok());
    assert_eq!(of_cells.timeless(), expected.timeless());
    let of_pilots = RunEvents::read(&Ended::of(run_on(&slurm, &pilots, &["--workers", "2"])).ok());
    assert_eq!(of_pilots.timeless(), expected.timeless());
    for world in [&cells, &pilots] {
        let again = RunEvents::read(&Ended::of(run_on(&slurm, world, &[])).ok());
        assert_eq!(again.counts["executed"], 0);
        let store = world.path("store").display().to_string();
        Ended::of(program(&["cache", "verify", "--store", &store])).ok();
        let published = publications(world);
        assert!(
            published.len() == crate::product::TINY_JOBS && published.values().all(|count| *count == 1),
            "{published:?}"
        );
    }
    let mut doctor = program(&["doctor", "--device", "cpu", "--cluster", "cluster.toml", "--store", "store"]);
    doctor.current_dir(cells.path("")).envs([slurm.variable()]);
    let text = Ended::of(doctor).ok();
    let expected =
        ["never replace", "SLURM_VERSION", "AccountingStorageType accounting_storage/none", "cluster.toml: valid"];
    assert!(expected.iter().all(|part| text.contains(part)), "{text}");
}

#[test]
fn disturbances_on_slurm_change_no_result() {
    let Some(mut slurm) = Slurm::start() else { return };
    let (local, disturbed) = (world(24_000), world(24_000));
    let expected = local.run(&[]);
    let mut submitter = start(run_on(&slurm, &disturbed, &[]));
    let clock = Instant::now();

    wait_until("an element runs", || !slurm.running().is_empty());
    // A younger controller forgets jobs that it has not saved yet.
    std::thread::sleep(Duration::from_secs(6));
    submitter.kill().expect("the submitter is killed");
    submitter.wait().expect("the submitter has ended");
    slurm.restart_controller();
    wait_until("the controller answers", || slurm.ask("scontrol", &["ping"]).contains("UP"));
    let mut hits = 0;
    for disturb in [requeue, cancel, kill_worker] {
        wait_until("an element runs", || !workers(&slurm).is_empty() || slurm.ask("squeue", &["-h"]).is_empty());
        hits += usize::from(disturb(&slurm).is_some());
    }
    let ended = attach(&slurm, &disturbed);
    println!("a run with {hits} disturbances took {:.1} s", clock.elapsed().as_secs_f64());
    assert!(hits >= 3, "the run ended after {hits} disturbances");
    assert_eq!(ended.timeless(), expected.timeless());
    assert_eq!(disturbed.run(&[]).counts["executed"], 0);
    let store = disturbed.path("store").display().to_string();
    Ended::of(program(&["cache", "verify", "--store", &store])).ok();
}

#[test]
fn an_empty_answer_of_squeue_is_no_evidence() {
    let Some(slurm) = Slurm::start() else { return };
    let (local, blind) = (world(12_000), world(12_000));
    let expected = local.run(&[]);
    let squeue = blind.path("bin/squeue");
    std::fs::create_dir(blind.path("bin")).expect("a folder");
    std::fs::write(&squeue, "#!/bin/sh\n").expect("a squeue that prints nothing");
    std::fs::set_permissions(&squeue, std::fs::Permissions::from_mode(0o755)).expect("it can be executed");
    let path = format!("{}:{}", blind.path("bin").display(), std::env::var("PATH").unwrap_or_default());
    let clock = Instant::now();
    let mut run = run_on(&slurm, &blind, &[]);
    run.env("PATH", path);
    assert_eq!(RunEvents::read(&Ended::of(run).ok()).timeless(), expected.timeless());
    // Longer than the patience of the cluster file, after which an unknown job counts as lost.
    assert!(clock.elapsed() > Duration::from_secs(8), "the run was too short: {:?}", clock.elapsed());
    let files = walkdir::WalkDir::new(blind.path("store/runs")).into_iter().flatten();
    let waves = files.filter(|file| file.path().extension().is_some_and(|extension| extension == "json"));
    let waves = waves.filter(|file| file.file_name().to_string_lossy().starts_with("wave-"));
    assert_eq!(waves.count(), 1, "something was submitted twice");
}

#[test]
fn a_node_on_which_jobs_vanish_is_excluded_and_named() {
    let Some(slurm) = Slurm::with(2, "REQUEUE") else { return };
    let (local, disturbed) = (world(12_000), world(12_000));
    let expected = local.run(&[]);
    let submitter = run_on(&slurm, &disturbed, &[]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut submitter = submitter.expect("the program starts");
    let clock = Instant::now();
    while submitter.try_wait().expect("the program runs").is_none() {
        let is_late = clock.elapsed() > PATIENCE;
        assert!(!is_late, "the run does not end: {}", slurm.ask("scontrol", &["show", "jobs", "-o"]));
        // A broken node: each batch job of trainings is killed once a training runs, when its start is recorded.
        let jobs = workers_with(&slurm, &["SLURMD_NODENAME=node1", "SLURM_JOB_NAME=tiny-cpu"]);
        for job in jobs.into_iter().filter(|job| !children(*job).is_empty()) {
            // Fails if it has just ended.
            let _ = kill_process(job, Signal::KILL);
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    let ended = Ended::from(submitter.wait_with_output().expect("the program has ended"));
    assert!(ended.stderr.contains("because batch jobs vanished there: node1"), "{}", ended.stderr);
    assert_eq!(RunEvents::read(&ended.ok()).timeless(), expected.timeless());
    let jobs = slurm.ask("scontrol", &["show", "jobs", "-o"]);
    let excluding: Vec<&str> = jobs.lines().filter(|job| job.contains("ExcNodeList=node1")).collect();
    assert!(!excluding.is_empty() && excluding.iter().all(|job| !job.contains(" NodeList=node1")), "{jobs}");
}

#[test]
fn preemption_that_cancels_changes_no_result() {
    // Without this option, a job that is warned puts itself back into the queue before it is cancelled.
    let cluster = format!("extra = [\"--no-requeue\"]\n{CLUSTER}");
    // One that ends on its own within the grace time counts as failed for Slurm.
    preempted("CANCEL", &cluster, |job| job.contains("PreemptTime=2") && job.contains("Restarts=0"));
}

#[test]
fn preemption_that_requeues_changes_no_result() {
    preempted("REQUEUE", CLUSTER, |job| job.contains("Restarts=1"));
}

/// A run during whose trainings a job of a higher partition takes the node. Slurm must show a job `as_preempted`.
fn preempted(mode: &str, cluster: &str, as_preempted: impl Fn(&str) -> bool) {
    let Some(slurm) = Slurm::with(1, mode) else { return };
    let (local, disturbed) = (world(24_000), world(24_000));
    let expected = local.run(&[]);
    std::fs::write(disturbed.path("cluster.toml"), cluster).expect("the cluster file is written");
    Ended::of(run_on(&slurm, &disturbed, &["--detach"])).ok();
    // The trainings of the other method last less than a second: the node would be free before it is claimed.
    let is_long = |name: &str| name.starts_with("train/") && name.contains("static3dgs");
    wait_until("a long training runs", || attempts(&disturbed).iter().any(|(name, _)| is_long(name)));
    let cpus = std::thread::available_parallelism().map_or(1, usize::from).to_string();
    slurm.ask("sbatch", &["-p", "urgent", "-n", &cpus, "--mem=100M", "-o", "/dev/null", "--wrap", "sleep 2"]);
    let ended = attach(&slurm, &disturbed);
    assert_eq!(ended.timeless(), expected.timeless());
    let jobs = slurm.ask("scontrol", &["show", "jobs", "-o"]);
    let preempted = jobs.lines().filter(|job| as_preempted(job)).count();
    println!("{mode}: {preempted} jobs were preempted");
    assert!(preempted > 0, "{jobs}");
    assert!(slurm.ask("sacct", &[]).is_empty(), "this Slurm has no accounting");
}

#[test]
fn pilots_on_slurm_share_a_search_that_survives_a_killed_one() {
    let Some(slurm) = Slurm::start() else { return };
    let (local, batch) = (world(9000), world(9000));
    let space = "nodes.train.params.density.max_count=250,300,350,400";
    let search = [r#"-saxes.method=["static3dgs"]"#, r#"-saxes.scene=["swinging-arm"]"#, "--sweep", space];
    local.call("run", &search).ok();
    let on_slurm = |arguments: &[&str]| {
        let mut command = batch.command("run", &[&search[..], arguments].concat());
        command.args(["--on", "slurm", "--cluster", "cluster.toml", "--lease", "5s"]).envs([slurm.variable()]);
        Ended::of(command)
    };
    let refused = on_slurm(&[]);
    assert!(refused.code == 3 && refused.stderr.contains("add --workers N"), "{}", refused.stderr);
    on_slurm(&["--workers", "2", "--detach"]).ok();
    let pilots = || processes_with(&slurm, "--search-part", &[]);
    wait_until("a pilot trains", || !pilots().is_empty() && batch.path("store/checkpoints").exists());
    std::thread::sleep(Duration::from_secs(1));
    kill_process(*pilots().first().expect("a pilot"), Signal::KILL).expect("the pilot is killed");
    let mut attach = program(&["attach", "--store"]);
    attach.arg(batch.path("store")).envs([slurm.variable()]).current_dir(batch.path(""));
    let report = Ended::of(attach).ok();
    assert!(report.contains("Best:"), "{report}");
    assert_eq!(objectives(&batch), objectives(&local));
}

#[test]
fn a_frozen_pilot_loses_its_training_and_stops() {
    let Some(slurm) = Slurm::start() else { return };
    let (local, shared) = (world(12_000), world(12_000));
    let expected = local.run(&[]);
    Ended::of(run_on(&slurm, &shared, &["--workers", "2", "--detach"])).ok();
    let trainings = || attempts(&shared).into_iter().filter(|(name, _)| name.starts_with("train/")).count();
    wait_until("both pilots train", || trainings() == 2);
    // The children of the pilot are frozen with it, like on a suspended machine.
    let pilot = *workers(&slurm).first().expect("a pilot");
    let training = children(pilot);
    let signal = |pids: &[Pid], signal| pids.iter().for_each(|pid| _ = kill_process(*pid, signal));
    assert!(!training.is_empty(), "the pilot trains");
    signal(&[pilot], Signal::STOP);
    signal(&training, Signal::STOP);
    let is_taken_over = || attempts(&shared).iter().any(|(name, _)| name.starts_with("train/") && name.ends_with(".2"));
    wait_until("the training is taken over", is_taken_over);
    signal(&training, Signal::CONT);
    signal(&[pilot], Signal::CONT);
    let clock = Instant::now();
    wait_until("the training that was frozen stops", || !children(pilot).iter().any(|pid| training.contains(pid)));
    let elapsed = clock.elapsed();
    println!("the training stopped {:.1} s after it continued", elapsed.as_secs_f64());
    assert!(elapsed < Duration::from_secs(5), "it went on for {elapsed:?}, longer than its lease");
    assert_eq!(attach(&slurm, &shared).timeless(), expected.timeless());
    let published = publications(&shared);
    assert!(published.values().all(|count| *count == 1), "{published:?}");
}

#[test]
fn a_cancelled_run_is_continued_by_the_next_one() {
    let Some(slurm) = Slurm::start() else { return };
    let world = world(4000);
    Ended::of(run_on(&slurm, &world, &["--detach"])).ok();
    let status = || {
        let mut status = world.command("status", &[]);
        status.envs([slurm.variable()]);
        Ended::of(status).ok()
    };
    // Querying Slurm first and the status second would miss an element that ends in between.
    wait_until("the status shows a running element", || {
        let status = status();
        status.contains("on Slurm, wave 1") && status.contains("RUNNING")
    });
    let mut cancel = program(&["cancel", "--store"]);
    cancel.arg(world.path("store")).envs([slurm.variable()]);
    Ended::of(cancel).ok();
    wait_until("all jobs have ended", || slurm.ask("squeue", &["-h"]).trim().is_empty());
    let status = world.call("status", &[]).ok();
    assert!(!status.contains("running"), "{status}");
    assert_eq!(world.run(&[]).timeless().len(), crate::product::TINY_JOBS - 1);
}

#[test]
fn time_limits_in_mid_training_change_no_result() {
    if std::env::var_os("NIGHTLY").is_none() {
        support::skip("NIGHTLY is not set: Slurm's shortest time limit is a minute");
        return;
    }
    let Some(slurm) = Slurm::start() else { return };
    let (local, limited) = (world(100_000), world(100_000));
    let cluster = CLUSTER.replace("10m", "1m").replace("20s", "25s");
    std::fs::write(limited.path("cluster.toml"), cluster).expect("the cluster file is written");
    let expected = local.run(&[]);
    let ended = RunEvents::read(&Ended::of(run_on(&slurm, &limited, &[])).ok());
    assert_eq!(ended.timeless(), expected.timeless());
    let jobs = slurm.ask("scontrol", &["show", "jobs", "-o"]);
    let restarts = jobs.split_whitespace().filter_map(|word| word.strip_prefix("Restarts=")?.parse::<u32>().ok());
    let restarts: u32 = restarts.sum();
    println!("{restarts} restarts at time limits");
    assert!(restarts > 0, "no time limit struck:\n{jobs}");
}

/// The names and folders of all attempts at jobs of the newest run, e.g. `train/a` and `train/a.2`; none before a job began.
fn attempts(world: &World) -> Vec<(String, PathBuf)> {
    let runs = std::fs::read_dir(world.path("store/runs")).into_iter().flatten().flatten();
    let Some(jobs) = runs.map(|run| run.path().join("jobs")).filter(|jobs| jobs.exists()).max() else { return vec![] };
    let specs = walkdir::WalkDir::new(&jobs).into_iter().flatten().filter(|entry| entry.file_name() == "job.json");
    let folders = specs.filter_map(|spec| Some(spec.path().parent()?.to_owned()));
    folders.map(|folder| (folder.strip_prefix(&jobs).expect("below jobs").display().to_string(), folder)).collect()
}

/// Job of the newest run → how often the logs of its attempts say that its result was published.
fn publications(world: &World) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for (attempt, folder) in attempts(world) {
        let log = std::fs::read_to_string(folder.join("log")).unwrap_or_default();
        let name = attempt.split_once('.').map_or(&*attempt, |(name, _)| name);
        *counts.entry(name.to_owned()).or_default() += log.matches(" published ").count();
    }
    counts
}

fn start(mut command: Command) -> Child {
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
}

fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    let clock = Instant::now();
    while !is_so() {
        assert!(clock.elapsed() < PATIENCE, "not reached: {what}");
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// Puts a running element back into the queue; `None` if none runs.
fn requeue(slurm: &Slurm) -> Option<()> {
    slurm.running().first().map(|id| _ = slurm.ask("scontrol", &["requeue", id]))
}

fn cancel(slurm: &Slurm) -> Option<()> {
    slurm.running().first().map(|id| _ = slurm.ask("scancel", &[id]))
}

/// The processes of batch jobs of plans: those whose command line has `worker` and this Slurm's variable.
fn workers(slurm: &Slurm) -> Vec<Pid> {
    workers_with(slurm, &[])
}

/// The processes of batch jobs that have these variables.
fn workers_with(slurm: &Slurm, variables: &[&str]) -> Vec<Pid> {
    processes_with(slurm, "worker", variables)
}

/// The processes of batch jobs that have this argument and these variables.
fn processes_with(slurm: &Slurm, argument: &str, variables: &[&str]) -> Vec<Pid> {
    let (name, value) = slurm.variable();
    let variable = format!("{name}={}", value.display());
    let pids = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = pids.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    let is_worker = |pid: &i32| {
        let read = |file: &str| std::fs::read(format!("/proc/{pid}/{file}")).unwrap_or_default();
        let has = |bytes: Vec<u8>, text: &str| bytes.split(|byte| *byte == 0).any(|part| part == text.as_bytes());
        let has_variables = || variables.iter().chain([&&*variable]).all(|text| has(read("environ"), text));
        has(read("cmdline"), argument) && has_variables()
    };
    pids.filter(is_worker).filter_map(Pid::from_raw).collect()
}

fn kill_worker(slurm: &Slurm) -> Option<()> {
    kill_process(*workers(slurm).first()?, Signal::KILL).ok()
}
