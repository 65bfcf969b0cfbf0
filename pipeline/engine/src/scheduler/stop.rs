//! Stops jobs: on request, after too many failures, and at a job's time limit.

use std::time::Duration;

use super::Scheduler;
use crate::event::Event;
use crate::job::Stop;

/// The time that a job has to save its progress after its time limit, and to end after TERM.
const TIME_LIMIT_GRACE: Duration = Duration::from_secs(10);

impl Scheduler<'_> {
    /// Handles each new stop request: the first makes jobs save their progress, the second sends TERM, later ones KILL.
    pub(super) fn handle_stop_requests(&mut self) {
        let requests = self.options.stop.count();
        while self.stops_seen < requests {
            self.stops_seen += 1;
            let handles = self.running.values().map(|job| &job.handle);
            let message = match self.stops_seen {
                1 => {
                    handles.for_each(|handle| handle.stop(Stop::Save));
                    "no new jobs; running jobs save their progress (again: terminate them)"
                }
                2 => {
                    handles.for_each(|handle| handle.stop(Stop::Terminate));
                    "terminating running jobs (again: kill them)"
                }
                _ => {
                    handles.for_each(|handle| handle.stop(Stop::Kill));
                    "killing running jobs"
                }
            };
            self.events.emit(&Event::Stopping { message: message.into() });
        }
    }

    /// Whether the scheduler launches no more jobs.
    pub(super) fn has_stopped_launching(&self) -> bool {
        self.stops_seen > 0 || self.options.max_failures.is_some_and(|limit| self.counts.failed >= limit.max(1))
    }

    /// Requests jobs past the time limit to stop, then terminates them, then kills them.
    pub(super) fn enforce_time_limit(&mut self) {
        let Some(limit) = self.options.timeout else { return };
        for job in self.running.values_mut() {
            let Some(started) = job.process_started else { continue };
            let graces = u32::try_from(job.time_warnings).unwrap_or(u32::MAX);
            if started.elapsed() < limit + TIME_LIMIT_GRACE * graces {
                continue;
            }
            job.handle.mark_timed_out();
            match job.time_warnings {
                0 => job.handle.stop(Stop::Save),
                1 => job.handle.stop(Stop::Terminate),
                _ => job.handle.stop(Stop::Kill),
            }
            job.time_warnings += 1;
        }
    }

    /// The signal that stopped the run, if it was stopped on request.
    pub(super) fn stopped_by(&self) -> Option<String> {
        (self.stops_seen > 0).then(|| self.options.stop.last_signal().to_owned())
    }
}
