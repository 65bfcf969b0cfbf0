//! Frames in flight: earlier frames are read back, converted and encoded on other threads while the next one is rendered.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use shaders::tape::Tensor;

/// The maximum number of frames in flight: the other threads of the pool have work while this one renders or helps.
pub(crate) fn max_in_flight() -> usize {
    2 * rayon::current_num_threads()
}

/// Renders frames in turn on this thread and passes the colours of each to `finish` on the threads of the current pool, with
/// at most [`max_in_flight`] frames in flight. Returns the results in the order of the frames.
///
/// # Errors
/// An error of `render`, which ends the run, or else the first error of `finish`.
pub(crate) fn deliver<F: Send, R: Send>(
    frames: impl IntoIterator<Item = F>,
    mut render: impl FnMut(&F) -> anyhow::Result<Tensor<f32>>,
    finish: impl Fn(F, &Tensor<f32>) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    let (in_flight, finished) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let (in_flight, finished, finish) = (&in_flight, &finished, &finish);
    rayon::in_place_scope(|scope| {
        for (index, frame) in frames.into_iter().enumerate() {
            let color = render(&frame)?;
            wait_for_a_place(in_flight);
            in_flight.fetch_add(1, Ordering::Relaxed);
            scope.spawn(move |_| {
                let result = finish(frame, &color);
                finished.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
                in_flight.fetch_sub(1, Ordering::Release);
            });
        }
        anyhow::Ok(())
    })?;
    let mut finished = std::mem::take(&mut *finished.lock().unwrap_or_else(PoisonError::into_inner));
    finished.sort_unstable_by_key(|&(index, _)| index);
    finished.into_iter().map(|(_, result)| result).collect()
}

/// Waits until a further frame may be in flight. A thread of the pool works on the frames meanwhile: the pool may have no other.
fn wait_for_a_place(in_flight: &AtomicUsize) {
    while in_flight.load(Ordering::Acquire) >= max_in_flight() {
        if rayon::yield_now().is_none() {
            std::thread::yield_now();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Delivers ten frames on a pool; `fails` returns which frames cannot be finished.
    fn delivered(threads: usize, fails: impl Fn(usize) -> bool + Sync + Send) -> anyhow::Result<Vec<usize>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (now, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let finish = |frame: usize, color: &Tensor<f32>| {
            most.fetch_max(1 + now.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
            // Later frames finish earlier.
            std::thread::sleep(std::time::Duration::from_millis(10 - frame as u64));
            now.fetch_sub(1, Ordering::SeqCst);
            anyhow::ensure!(!fails(frame), "frame {frame}");
            Ok(color.as_slice()[0] as usize)
        };
        let render = |frame: &usize| Ok(Tensor::full([1], 2.0 * *frame as f32));
        let result = pool.install(|| deliver(0..10, render, finish));
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
