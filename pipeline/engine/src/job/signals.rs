//! Stop requests from signals.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGPIPE, SIGTERM, SIGUSR1};
use signal_hook::flag;
use signal_hook::iterator::Signals;

/// The number of stop requests to the scheduler, and the signal of the last one.
#[derive(Clone, Debug, Default)]
pub struct StopRequests {
    count: Arc<AtomicUsize>,
    signal: Arc<AtomicUsize>,
}

impl StopRequests {
    /// Starts to count the signals INT, TERM and HUP of this process.
    pub fn listen() -> io::Result<Self> {
        Self::listen_to(&[SIGINT, SIGTERM, SIGHUP])
    }

    /// Starts to count the signals INT, TERM, HUP and USR1 of this process. Batch systems announce the end of an
    /// allocation with USR1.
    pub fn listen_in_batch() -> io::Result<Self> {
        Self::listen_to(&[SIGINT, SIGTERM, SIGHUP, SIGUSR1])
    }

    fn listen_to(signals: &[i32]) -> io::Result<Self> {
        let requests = Self::default();
        let mut signals = Signals::new(signals)?;
        let counter = requests.clone();
        std::thread::Builder::new().name("signals".into()).spawn(move || {
            for signal in signals.forever() {
                counter.request(signal);
            }
        })?;
        Ok(requests)
    }

    /// Adds a request with this signal.
    pub fn request(&self, signal: i32) {
        self.signal.store(usize::try_from(signal).unwrap_or(0), Ordering::SeqCst);
        self.count.fetch_add(1, Ordering::SeqCst);
    }

    /// The number of requests.
    pub fn count(&self) -> usize {
        self.count.load(Ordering::SeqCst)
    }

    /// Adds a request because the reader of the program's output has closed it.
    pub fn reader_is_gone(&self) {
        self.request(SIGPIPE);
    }

    /// The signal of the last request: `INT`, `TERM`, `HUP`, `USR1` or `PIPE`; `INT` without a request.
    pub fn last_signal(&self) -> &'static str {
        match i32::try_from(self.signal.load(Ordering::SeqCst)) {
            Ok(SIGTERM) => "TERM",
            Ok(SIGHUP) => "HUP",
            Ok(SIGUSR1) => "USR1",
            Ok(SIGPIPE) => "PIPE",
            _ => "INT",
        }
    }
}

/// The stop flag of a job. The first INT, TERM, USR1 or HUP sets it; a later TERM ends the process at once.
pub(super) fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    // Registered first, so that this handler sees the flag unset at the first TERM.
    flag::register_conditional_shutdown(SIGTERM, crate::exit::TERMINATED.into(), Arc::clone(&stop))?;
    for signal in [SIGINT, SIGTERM, SIGUSR1, SIGHUP] {
        flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_is_that_of_the_last_request() {
        let requests = StopRequests::default();
        assert_eq!((requests.count(), requests.last_signal()), (0, "INT"));
        requests.request(SIGTERM);
        requests.request(SIGHUP);
        assert_eq!((requests.count(), requests.last_signal()), (2, "HUP"));
        requests.reader_is_gone();
        assert_eq!((requests.count(), requests.last_signal()), (3, "PIPE"));
    }
}
