//! Frames in flight: earlier frames are encoded on other threads, and a GPU renders the next ones, while this thread
//! records further frames. Only this thread waits for the GPU: many waiting threads delay its submissions.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Frames that a GPU may have to render after the one for which this thread waits.
const QUEUED: usize = 3;

/// Maximum number of frames that have arrived and are not encoded yet. With two per thread, the other threads of the
/// pool have work while this thread records or encodes frames.
fn max_arrived() -> usize {
    2 * rayon::current_num_threads()
}

/// The maximum number of frames in flight.
pub(crate) fn max_in_flight() -> usize {
    QUEUED + max_arrived()
}

/// Starts frames in turn on this thread, waits here until each has arrived and passes it to `finish` on the threads of the
/// current pool, with at most [`max_in_flight`] frames in flight. Returns the results in the order of the frames.
///
/// # Errors
/// An error of `start`, which ends the run, or else the first error of `finish`.
pub(crate) fn deliver<F: Send, S: Send, R: Send>(
    frames: impl IntoIterator<Item = F>,
    mut start: impl FnMut(&F) -> anyhow::Result<S>,
    wait: impl Fn(&S),
    finish: impl Fn(F, S) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    let (arrived, finished) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let (arrived, finished, finish) = (&arrived, &finished, &finish);
    rayon::in_place_scope(|scope| {
        let pass_on = |(index, frame, started): (usize, F, S)| {
            wait(&started);
            wait_for_a_place(arrived);
            arrived.fetch_add(1, Ordering::Relaxed);
            scope.spawn(move |_| {
                let result = finish(frame, started);
                finished.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
                arrived.fetch_sub(1, Ordering::Release);
            });
        };
        let mut queue = VecDeque::new();
        for (index, frame) in frames.into_iter().enumerate() {
            let started = start(&frame)?;
            queue.push_back((index, frame, started));
            if queue.len() > QUEUED {
                queue.pop_front().map(pass_on);
            }
        }
        queue.into_iter().for_each(pass_on);
        anyhow::Ok(())
    })?;
    let mut finished = std::mem::take(&mut *finished.lock().unwrap_or_else(PoisonError::into_inner));
    finished.sort_unstable_by_key(|&(index, _)| index);
    finished.into_iter().map(|(_, result)| result).collect()
}

/// Waits until fewer than [`max_arrived`] frames await encoding. If this thread belongs to the pool, it encodes frames
/// meanwhile, because the pool may have no other thread.
fn wait_for_a_place(arrived: &AtomicUsize) {
    while arrived.load(Ordering::Acquire) >= max_arrived() {
        if rayon::yield_now().is_none() {
            std::thread::yield_now();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    struct Doubled {
        value: usize,
        has_arrived: AtomicBool,
    }

    /// Delivers ten frames on a pool; `fails` returns which frames cannot be finished.
    fn delivered(threads: usize, fails: impl Fn(usize) -> bool + Sync + Send) -> anyhow::Result<Vec<usize>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (now, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let finish = |frame: usize, started: Doubled| {
            most.fetch_max(1 + now.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
            // Later frames finish earlier.
            std::thread::sleep(std::time::Duration::from_millis(10 - frame as u64));
            now.fetch_sub(1, Ordering::SeqCst);
            anyhow::ensure!(!fails(frame), "frame {frame}");
            anyhow::ensure!(started.has_arrived.load(Ordering::SeqCst), "frame {frame} has not arrived");
            Ok(started.value)
        };
        let wait = |started: &Doubled| started.has_arrived.store(true, Ordering::SeqCst);
        let start = |frame: &usize| Ok(Doubled { value: 2 * frame, has_arrived: AtomicBool::new(false) });
        let result = pool.install(|| deliver(0..10, start, wait, finish));
        assert!((1..=threads).contains(&most.load(Ordering::SeqCst)), "{most:?} of {threads}");
        result
    }

    #[test]
    fn frames_keep_their_order_and_the_first_error_counts() {
        for threads in [1, 2, 4] {
            let expected: Vec<usize> = (0..10).map(|frame| 2 * frame).collect();
            assert_eq!(delivered(threads, |_| false).unwrap(), expected, "{threads} threads");
            let error = delivered(threads, |frame| frame == 7 || frame == 4).unwrap_err();
            assert_eq!(error.to_string(), "frame 4");
        }
    }
}
