//! A run that is killed or interrupted at any moment is completed by the next one, with the artifacts of an undisturbed
//! run.

use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::process::Stdio;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::{Pid, Signal, kill_process};
use walkdir::WalkDir;

use crate::product::World;

/// Kills per test, half of schedulers and half of jobs.
const ROUNDS: usize = 6;

#[test]
fn killed_schedulers_and_jobs_change_nothing() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let longer = || World::with_edit("{ train = 40 }", "{ train = 300 }");
    let clock = Instant::now();
    let (world, undisturbed) = (longer(), longer().run(&[]));
    // Early enough that the rounds together do not finish the work.
    let latest_millis = (clock.elapsed().as_millis() as u64 / 4).max(20);
    let (mut schedulers, mut jobs) = (0, 0);
    for round in 0..ROUNDS {
        let mut scheduler = world.start_run();
        std::thread::sleep(Duration::from_millis(random.random_range(10..latest_millis)));
        // Schedulers first, because a run that loses a job still finishes the others.
        if round < ROUNDS / 2 {
            scheduler.kill().unwrap();
            schedulers += usize::from(scheduler.wait().unwrap().signal().is_some());
        } else {
            // Retry: a job is running at nearly every moment.
            for _ in 0..100 {
                let running = children(Pid::from_child(&scheduler));
                jobs += running.iter().filter(|job| kill_process(**job, Signal::KILL).is_ok()).count();
                if !running.is_empty() || scheduler.try_wait().unwrap().is_some() {
                    break;
                }
                std::thread::sleep(Duration::from_millis(2));
            }
            // The run records the killed job as failed and continues without it.
            scheduler.wait().unwrap();
        }
    }
    println!("killed {schedulers} schedulers and {jobs} jobs");
    assert!(schedulers >= 2 && jobs >= 1, "too few kills: {schedulers} schedulers, {jobs} jobs");
    let completed = world.run(&[]);
    assert_eq!(completed.timeless(), undisturbed.timeless());
    assert_eq!(world.run(&[]).counts["executed"], 0);
    let store = world.path("store").display().to_string();
    crate::product::Ended::of(crate::product::program(&["cache", "verify", "--store", &store])).ok();
}

/// The running jobs of a scheduler: the children of all of its threads.
pub(crate) fn children(scheduler: Pid) -> Vec<Pid> {
    let tasks = std::fs::read_dir(format!("/proc/{}/task", scheduler.as_raw_nonzero())).into_iter().flatten().flatten();
    let lists = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("children")).ok());
    let pids: Vec<i32> =
        lists.flat_map(|list| list.split_whitespace().map(str::parse).collect::<Vec<_>>()).flatten().collect();
    pids.into_iter().filter_map(Pid::from_raw).collect()
}

#[test]
fn an_interrupted_run_stops_and_the_next_one_resumes() {
    const ONLY: [&str; 2] = ["--only", "train/bouncing-spheres/static3dgs/0"];
    const TRAIN: &str = "train/bouncing-spheres/static3dgs/0";
    let longer = || World::with_edit("{ train = 40 }", "{ train = 10000 }");
    let world = longer();
    let mut run = world.command("run", &["--json", ONLY[0], ONLY[1]]);
    let mut run = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(run.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut interrupted_at = None;
    for line in lines {
        let event: serde_json::Value = serde_json::from_str(&line).unwrap();
        // Interrupt at the first progress event: the training has started and is far from its end.
        if interrupted_at.is_none() && event["event"] == "progress" && event["node"] == TRAIN {
            interrupted_at = event["progress"]["done"].as_u64();
            kill_process(Pid::from_child(&run), Signal::INT).unwrap();
        }
    }
    let status = run.wait().unwrap();
    assert_eq!(status.code(), Some(130), "interrupted at {interrupted_at:?}");
    let checkpoints = || WalkDir::new(world.path("store/checkpoints")).into_iter().flatten();
    let saved = checkpoints().filter(|entry| entry.file_type().is_file()).count();
    assert!(saved > 0, "no checkpoint was saved at step {interrupted_at:?}");

    let resumed = world.run(&ONLY);
    assert_eq!((resumed.counts["executed"], resumed.counts["cached"]), (1, 1), "the capture is cached");
    assert_eq!(resumed.contents, longer().run(&ONLY).contents);
    assert_eq!(checkpoints().filter(|entry| entry.file_type().is_file()).count(), 0, "checkpoints are left behind");
}
