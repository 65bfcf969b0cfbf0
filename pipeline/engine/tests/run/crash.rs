//! Crashes: processes are killed at random times, and the next run gives the results of an undisturbed run.

use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::{Pid, Signal, kill_process};

use crate::world::{GRID, World, contents};

pub(crate) const TESTS: &[(&str, fn())] = &[
    ("killed_scheduler_leaves_a_usable_store", killed_scheduler_leaves_a_usable_store),
    ("killed_jobs_are_run_again", killed_jobs_are_run_again),
    ("orphaned_jobs_stop", orphaned_jobs_stop),
];

const ROUNDS: usize = 10;

fn killed_scheduler_leaves_a_usable_store() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let world = World::new(GRID);
    for _ in 0..ROUNDS {
        let mut scheduler = start(&world);
        std::thread::sleep(Duration::from_millis(random.random_range(5..150)));
        scheduler.kill().unwrap();
        scheduler.wait().unwrap();
    }
    completes_like_an_undisturbed_run(&world);
}

fn killed_jobs_are_run_again() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let world = World::new(GRID);
    let mut killed = 0;
    for _ in 0..ROUNDS {
        let mut scheduler = start(&world);
        for _ in 0..4 {
            std::thread::sleep(Duration::from_millis(random.random_range(5..40)));
            for job in children(&scheduler) {
                killed += usize::from(kill_process(job, Signal::KILL).is_ok());
            }
        }
        scheduler.wait().unwrap();
    }
    assert!(killed > 0 || cfg!(not(target_os = "linux")), "no job was hit");
    completes_like_an_undisturbed_run(&world);
}

fn orphaned_jobs_stop() {
    let world =
        World::new(&GRID.replace("sleep_millis = 10", "sleep_millis = 20").replace("steps = 3", "steps = 5000"));
    let mut scheduler = start(&world);
    let wait_until = |what: &dyn Fn() -> bool| {
        for _ in 0..400 {
            if what() {
                return;
            }
            std::thread::sleep(Duration::from_millis(25));
        }
        panic!("not reached within 10 s");
    };
    let store = world.store();
    let checkpoints = || walk_count(&store.root().join("checkpoints"));
    wait_until(&|| checkpoints() >= 4);
    scheduler.kill().unwrap();
    scheduler.wait().unwrap();
    // Every job holds the store's shared lock, which is free when the last job has ended.
    wait_until(&|| store.try_lock_exclusive().unwrap().is_some());
    assert!(store.records().unwrap().iter().all(|record| record.components.stage != "test-work"));
}

/// Asserts that the next run finishes and agrees with a run in another store, and that the store is undamaged.
fn completes_like_an_undisturbed_run(world: &World) {
    let summary = world.run(&[]);
    assert_eq!(summary.exit_code(true), engine::exit::OK, "{:?}", summary.results);
    assert_eq!(contents(&summary), contents(&World::new(GRID).run(&[])));
    assert_eq!(world.run(&[]).counts.executed, 0);
    let damages = world.store().verify(false).unwrap();
    assert!(damages.is_empty(), "{damages:?}");
}

fn start(world: &World) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.arg("schedule").arg(&world.root).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().unwrap()
}

/// The job processes of a scheduler: the children of all of its threads.
pub(crate) fn children(scheduler: &Child) -> Vec<Pid> {
    let tasks = fs::read_dir(format!("/proc/{}/task", scheduler.id()));
    let lists = tasks.into_iter().flatten().flatten().map(|task| fs::read_to_string(task.path().join("children")));
    let pids = lists.flatten().flat_map(|list| list.split_whitespace().map(str::to_owned).collect::<Vec<_>>());
    pids.filter_map(|pid| Pid::from_raw(pid.parse().ok()?)).collect()
}

fn walk_count(dir: &std::path::Path) -> usize {
    walkdir::WalkDir::new(dir).into_iter().flatten().filter(|entry| entry.file_type().is_file()).count()
}
