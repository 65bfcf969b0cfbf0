//! Requests to stop, from signals.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGPIPE, SIGTERM, SIGUSR1};
use signal_hook::flag;
use signal_hook::iterator::Signals;

/// How often the user asked the scheduler to stop, and with which signal last.
#[derive(Clone, Debug, Default)]
pub struct StopRequests {
    count: Arc<AtomicUsize>,
    signal: Arc<AtomicUsize>,
}

impl StopRequests {
    /// Counts INT, TERM and HUP of this process from now on.
    pub fn listen() -> io::Result<Self> {
        let requests = Self::default();
        let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
        let counter = requests.clone();
        std::thread::Builder::new().name("signals".into()).spawn(move || {
            for signal in signals.forever() {
                counter.request(signal);
            }
        })?;
        Ok(requests)
    }

    /// Asks once more.
    pub fn request(&self, signal: i32) {
        self.signal.store(usize::try_from(signal).unwrap_or(0), Ordering::SeqCst);
        self.count.fetch_add(1, Ordering::SeqCst);
    }

    /// How often stopping was asked for.
    pub fn count(&self) -> usize {
        self.count.load(Ordering::SeqCst)
    }

    /// Asks to stop since nobody reads the output any more.
    pub fn reader_is_gone(&self) {
        self.request(SIGPIPE);
    }

    /// What asked last: `INT`, `TERM` or `PIPE`.
    pub fn last_signal(&self) -> &'static str {
        match i32::try_from(self.signal.load(Ordering::SeqCst)) {
            Ok(SIGTERM) => "TERM",
            Ok(SIGPIPE) => "PIPE",
            _ => "INT",
        }
    }
}

/// In a job: the first INT, TERM, USR1 or HUP sets the flag; a TERM after that ends the process at once.
pub(super) fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    // Registered first, so that a single TERM finds the flag still unset.
    flag::register_conditional_shutdown(SIGTERM, crate::exit::TERMINATED.into(), Arc::clone(&stop))?;
    for signal in [SIGINT, SIGTERM, SIGUSR1, SIGHUP] {
        flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}
