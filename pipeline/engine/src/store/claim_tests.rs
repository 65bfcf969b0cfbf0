//! Claims held, expired, taken away and contended for.

use super::*;
use crate::store::tests::{key, with_store};

const LEASE: Duration = Duration::from_millis(100);

/// Polls a claim until it can be taken away; panics if that takes many leases.
fn wait_until_broken(store: &Store) -> Duration {
    let (start, mut watch) = (Instant::now(), Watch::default());
    while !store.break_expired_claim(&key("a"), &mut watch, LEASE).unwrap() {
        assert!(start.elapsed() < 50 * LEASE, "the claim never expires");
        std::thread::sleep(LEASE / 10);
    }
    start.elapsed()
}

#[test]
fn one_process_holds_a_claim() {
    with_store(|store| {
        let claim = store.try_claim(&key("a"), "run", 2).unwrap().unwrap();
        assert!(store.try_claim(&key("a"), "run", 2).unwrap().is_none());
        assert!(store.try_claim(&key("b"), "run", 2).unwrap().is_some());
        assert_eq!(store.holder(&key("a")).unwrap().threads, 2);
        drop(claim);
        assert!(store.try_claim(&key("a"), "run", 2).unwrap().is_some());
    });
}

#[test]
fn a_beating_claim_lasts_and_a_silent_one_expires() {
    with_store(|store| {
        let mut claim = store.try_claim(&key("a"), "run", 1).unwrap().unwrap();
        let mut watch = Watch::default();
        for _ in 0..30 {
            assert!(claim.beat(None, &Progress::default()).unwrap());
            assert!(!store.break_expired_claim(&key("a"), &mut watch, LEASE).unwrap());
            std::thread::sleep(LEASE / 10);
        }
        assert!(wait_until_broken(store) >= LEASE);
        let other = store.try_claim(&key("a"), "run", 1).unwrap().unwrap();
        assert!(!claim.beat(None, &Progress::default()).unwrap(), "the former holder does not notice");
        drop(claim);
        assert!(store.holder(&key("a")).is_some(), "the former holder released the claim of the new one");
        drop(other);
    });
}

#[test]
fn a_frozen_contender_does_not_break_claims_when_it_wakes() {
    with_store(|store| {
        let mut claim = store.try_claim(&key("a"), "run", 1).unwrap().unwrap();
        let mut watch = Watch::default();
        assert!(!store.break_expired_claim(&key("a"), &mut watch, LEASE).unwrap());
        std::thread::sleep(3 * LEASE);
        assert!(!store.break_expired_claim(&key("a"), &mut watch, LEASE).unwrap());
        assert!(claim.beat(None, &Progress::default()).unwrap());
    });
}

#[test]
fn the_claim_of_an_ended_process_is_free_at_once() {
    with_store(|store| {
        let mut claim = store.try_claim(&key("a"), "run", 1).unwrap().unwrap();
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        claim.holder.process = ProcessId::local(child.id());
        claim.file.write_all_at(&claim.holder.bytes().unwrap(), 0).unwrap();
        let mut watch = Watch::default();
        assert!(!store.break_expired_claim(&key("a"), &mut watch, LEASE).unwrap());
        child.kill().unwrap();
        child.wait().unwrap();
        let is_free = store.break_expired_claim(&key("a"), &mut watch, LEASE).unwrap();
        assert_eq!(is_free, cfg!(target_os = "linux"));
    });
}

#[test]
fn contenders_take_an_expired_claim_once() {
    with_store(|store| {
        std::mem::forget(store.try_claim(&key("a"), "run", 1).unwrap());
        let contend = || {
            wait_until_broken(store);
            store.try_claim(&key("a"), "run", 1).unwrap()
        };
        let claims: Vec<Claim> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(contend)).collect();
            threads.into_iter().filter_map(|thread| thread.join().unwrap()).collect()
        });
        let holder = store.holder(&key("a")).expect("a claim remains");
        let mine: Vec<bool> = claims.iter().map(|claim| claim.is_mine().unwrap()).collect();
        assert_eq!(mine.iter().filter(|mine| **mine).count(), 1, "{mine:?} {holder:?}");
    });
}

/// Contending workers claim every job once.
#[test]
fn many_workers_claim_each_job_once() {
    const WORKERS: usize = 200;
    const JOBS: usize = 2_000;
    with_store(|store| {
        let keys: Vec<ActionKey> = (0..JOBS).map(|job| key(&job.to_string())).collect();
        let done: Vec<std::sync::atomic::AtomicUsize> = (0..JOBS).map(|_| Default::default()).collect();
        let work = |worker: usize| {
            for job in (0..JOBS).map(|at| (at + worker * JOBS / WORKERS) % JOBS) {
                // Like the scheduler, which looks for a result before and after claiming a job.
                if done[job].load(Ordering::SeqCst) > 0 {
                    continue;
                }
                let Some(claim) = store.try_claim(&keys[job], "run", 1).unwrap() else { continue };
                if done[job].load(Ordering::SeqCst) == 0 {
                    std::thread::sleep(Duration::from_micros(200));
                    done[job].fetch_add(1, Ordering::SeqCst);
                }
                drop(claim);
            }
        };
        std::thread::scope(|scope| {
            let work = &work;
            (0..WORKERS).for_each(|worker| _ = scope.spawn(move || work(worker)));
        });
        assert!(done.iter().all(|count| count.load(Ordering::SeqCst) == 1));
        assert!(store.claimed().unwrap().is_empty());
    });
}

/// Workers that begin at different places rarely try to claim a job that another one holds. They take turns, because the number of
/// attempts of threads depends on how the system schedules them.
#[test]
fn workers_from_different_places_need_few_attempts() {
    const WORKERS: usize = 200;
    const JOBS: usize = 10_000;
    struct Worker {
        order: Box<dyn Iterator<Item = usize>>,
        held: Option<(usize, Claim)>,
        is_at_end: bool,
    }
    with_store(|store| {
        let keys: Vec<ActionKey> = (0..JOBS).map(|job| key(&job.to_string())).collect();
        let begin = |worker: usize| Worker {
            order: Box::new((0..JOBS).map(move |at| (at + worker * JOBS / WORKERS) % JOBS)),
            held: None,
            is_at_end: false,
        };
        let mut workers: Vec<Worker> = (0..WORKERS).map(begin).collect();
        let (mut done, mut attempts) = (vec![0; JOBS], 0);
        while workers.iter().any(|worker| !worker.is_at_end) {
            for worker in &mut workers {
                if let Some((job, claim)) = worker.held.take() {
                    done[job] += 1;
                    drop(claim);
                } else if let Some(job) = worker.order.find(|job| done[*job] == 0) {
                    attempts += 1;
                    worker.held = store.try_claim(&keys[job], "run", 1).unwrap().map(|claim| (job, claim));
                } else {
                    worker.is_at_end = true;
                }
            }
        }
        assert_eq!(done, vec![1; JOBS]);
        println!("{JOBS} jobs, {WORKERS} workers: {attempts} attempts");
        assert!(attempts < 2 * JOBS, "{attempts} attempts for {JOBS} jobs");
    });
}
