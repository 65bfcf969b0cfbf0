//! Follows a run on a cluster: shows its progress, and closes a wave whose last job was lost.

use std::time::{Duration, Instant};

use engine::event::Event;
use engine::job::StopRequests;
use engine::scheduler::{Crew, RunSummary, run};

use crate::crew::follower;
use crate::slurm::{self, is_alive};
use crate::wave::ClusterRun;
use crate::{Process, RunFile};

/// The interval at which the run's own files are polled.
const TICK: Duration = Duration::from_millis(500);

impl ClusterRun<'_> {
    /// Waits for the end of the run, and returns the usual summary. A stop request to `process` ends the wait; the
    /// batch jobs continue. `watcher` receives every event.
    pub fn follow(
        &self,
        file: &RunFile,
        process: &Process,
        watcher: &mut dyn FnMut(&Event),
    ) -> anyhow::Result<RunSummary> {
        let crew = Crew::default();
        let options = file.options(process, follower(&self.run, &crew));
        std::thread::scope(|scope| {
            let watch = scope.spawn(|| {
                let close = |number| self.close(file, process, number, &mut |_| ()).map(drop);
                let watched = self.watch(&process.stop, || Ok(!crew.has_ended()), close);
                crew.leave();
                watched
            });
            let summary = run(self.plan, self.store, &options, watcher);
            // A summary before the end of the batch jobs means that all results exist.
            crew.leave();
            watch.join().map_err(|_| anyhow::anyhow!("the thread that watches the batch jobs panicked"))??;
            summary
        })
    }

    /// Waits until the run has ended, the user stops waiting, or `tick`, which is called every half second, returns `false`.
    /// `close` does the work of the last job of a wave of this number, should that job be lost; 0 if nothing was submitted.
    pub fn watch(
        &self,
        stop: &StopRequests,
        mut tick: impl FnMut() -> anyhow::Result<bool>,
        close: impl Fn(usize) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let mut patience = Patience::default();
        let mut asked = Instant::now();
        while !self.has_ended() && stop.count() == 0 && tick()? {
            std::thread::sleep(TICK);
            if asked.elapsed() < self.site.cluster.poll {
                continue;
            }
            asked = Instant::now();
            if patience.is_over(self.lives()?, self.site.cluster.patience) {
                close(self.newest_wave()?.map_or(0, |wave| wave.number))?;
                patience = Patience::default();
            }
        }
        Ok(())
    }

    /// Whether a job of the newest wave may still be active; `None` if that is unknown. If Slurm's list lacks the
    /// last job, e.g. while the controller starts, the jobs count as ended only if the controller does not know that
    /// job.
    fn lives(&self) -> anyhow::Result<Option<bool>> {
        let Some(wave) = self.newest_wave()? else { return Ok(Some(false)) };
        let ids = wave.all_jobs();
        let Some(states) = slurm::states(&ids) else { return Ok(None) };
        let is_listed = ids.last().is_none_or(|last| states.contains_key(last));
        Ok(match states.values().any(is_alive) {
            true => Some(true),
            false if is_listed => Some(false),
            false => ids.last().and_then(|last| slurm::knows(*last)).filter(|knows| !knows),
        })
    }
}

/// Measures for how long no job has been alive. An unknown state neither resets the time nor ends the wait.
#[derive(Default)]
struct Patience {
    silent_since: Option<Instant>,
}

impl Patience {
    fn is_over(&mut self, lives: Option<bool>, patience: Duration) -> bool {
        match lives {
            None => false,
            Some(true) => {
                self.silent_since = None;
                false
            }
            Some(false) => self.silent_since.get_or_insert_with(Instant::now).elapsed() >= patience,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_answers_are_no_evidence() {
        let mut patience = Patience::default();
        assert!(!patience.is_over(None, Duration::ZERO));
        assert!(!patience.is_over(Some(true), Duration::ZERO));
        assert!(patience.is_over(Some(false), Duration::ZERO));
        assert!(!patience.is_over(Some(false), Duration::from_secs(60)));
        assert!(!patience.is_over(Some(true), Duration::ZERO) && patience.silent_since.is_none());
    }
}
