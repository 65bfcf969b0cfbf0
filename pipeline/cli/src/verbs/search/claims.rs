//! Claims on trials: leases in the store, like those of jobs. They only save work: a history accepts the first result
//! of a trial from any process.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

use engine::store::{Claim, Watch};
use engine::{ActionKey, Progress, Store};

/// The claims on the trials of a search.
pub(super) struct Claims {
    store: Store,
    search: String,
    lease: Duration,
    /// This process's observations of the claims of other processes.
    watches: BTreeMap<(usize, usize), Watch>,
}

/// The right to work on a trial up to a rung, kept alive by a thread until it is dropped.
pub(super) struct Held {
    _alive: Sender<()>,
}

impl Claims {
    pub(super) fn new(store: Store, folder: &Path, lease: Duration) -> Self {
        let search = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self { store, search, lease, watches: BTreeMap::new() }
    }

    /// Claims the work on a trial up to a rung; `None` if another process holds it.
    pub(super) fn take(&mut self, trial: usize, rung: usize) -> io::Result<Option<Held>> {
        let key = ActionKey::of_work(&format!("{}/{trial}/{rung}", self.search));
        let try_claim = |store: &Store| store.try_claim(&key, &self.search, 0);
        if let Some(claim) = try_claim(&self.store)? {
            return Ok(Some(Held::keep(claim, self.lease)));
        }
        let watch = self.watches.entry((trial, rung)).or_default();
        if !self.store.break_expired_claim(&key, watch, self.lease)? {
            return Ok(None);
        }
        Ok(try_claim(&self.store)?.map(|claim| Held::keep(claim, self.lease)))
    }
}

impl Held {
    fn keep(mut claim: Claim, lease: Duration) -> Self {
        let (alive, ended) = channel();
        std::thread::spawn(move || {
            while ended.recv_timeout(Claim::interval(lease)) == Err(RecvTimeoutError::Timeout) {
                // A claim that cannot be written expires, and another process repeats the trial.
                if !claim.beat(None, &Progress::default()).unwrap_or(true) {
                    return;
                }
            }
        });
        Self { _alive: alive }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_is_taken_once_until_it_is_given_back() {
        let folder = tempfile::tempdir().unwrap();
        let claims = || {
            let store = Store::open(&folder.path().join("store")).unwrap();
            Claims::new(store, Path::new("sweeps/a"), Duration::from_secs(60))
        };
        let (mut one, mut other) = (claims(), claims());
        let held = one.take(0, 0).unwrap().unwrap();
        assert!(other.take(0, 0).unwrap().is_none() && other.take(0, 1).unwrap().is_some());
        drop(held);
        let clock = std::time::Instant::now();
        while other.take(0, 0).unwrap().is_none() {
            assert!(clock.elapsed() < Duration::from_secs(10), "the claim stays");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
