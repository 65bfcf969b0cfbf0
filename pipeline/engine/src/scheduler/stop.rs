//! Stopping: on request, after too many failures, and when a job's time is up.

use std::time::Duration;

use super::Scheduler;
use crate::event::Event;
use crate::job::Stop;

/// After its time limit a job has so long to save its progress, and as long again after TERM.
const TIME_LIMIT_GRACE: Duration = Duration::from_secs(10);

impl Scheduler<'_> {
    /// Acts on each request to stop once: ask the jobs to save their progress, then TERM, then KILL.
    pub(super) fn watch_stop_requests(&mut self) {
        let requests = self.options.stop.count();
        while self.stops_seen < requests {
            self.stops_seen += 1;
            let handles = self.running.values().map(|job| &job.handle);
            let message = match self.stops_seen {
                1 => {
                    handles.for_each(|handle| handle.stop(Stop::Save));
                    "launching nothing more; running jobs save their progress (again: end them)"
                }
                2 => {
                    handles.for_each(|handle| handle.stop(Stop::Terminate));
                    "ending running jobs (again: kill them)"
                }
                _ => {
                    handles.for_each(|handle| handle.stop(Stop::Kill));
                    "killing running jobs"
                }
            };
            self.events.emit(&Event::Stopping { message: message.into() });
        }
    }

    /// Whether nothing more is to be launched.
    pub(super) fn launching_has_ended(&self) -> bool {
        self.stops_seen > 0 || self.options.max_failures.is_some_and(|limit| self.counts.failed >= limit.max(1))
    }

    /// Asks jobs past the time limit to stop, then ends them, then kills them.
    pub(super) fn watch_time_limits(&mut self) {
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

    /// The exit code's reason, if the run was stopped on request.
    pub(super) fn stopped_by(&self) -> Option<String> {
        (self.stops_seen > 0).then(|| self.options.stop.last_signal().to_owned())
    }
}
