//! The time until the end of a run, predicted from measured jobs, including those of the run itself.

use std::collections::BTreeMap;
use std::time::Instant;

use engine::Plan;
use engine::estimate::Estimator;
use engine::event::{Event, Outcome};
use engine::status::Prediction;

use crate::error::CliError;
use crate::output::{count, duration};
use crate::session::Session;

/// Predicts the end of one run.
#[derive(Default)]
pub(crate) struct Eta {
    plan: Option<Plan>,
    estimator: Estimator,
    /// The threads of all jobs together.
    threads: usize,
    /// Name → node of each job that may run and is not finished.
    unfinished: BTreeMap<String, usize>,
    running: BTreeMap<String, Running>,
}

/// A running job.
struct Running {
    since: Instant,
    /// Time and finished share of steps at its first report. The share may include steps of a job that this one continues.
    first: Option<(Instant, f64)>,
    /// The finished share of its steps.
    share: f64,
}

impl Eta {
    /// Prepares for a run of `session` with these predictions and this number of threads.
    pub(crate) fn new(
        session: &Session,
        predictions: &BTreeMap<usize, Prediction>,
        threads: usize,
    ) -> Result<Self, CliError> {
        let may_run = predictions.iter().filter(|(_, prediction)| prediction.may_run());
        let unfinished: BTreeMap<String, usize> =
            may_run.map(|(&index, _)| (session.plan.nodes[index].name.clone(), index)).collect();
        if unfinished.is_empty() {
            return Ok(Self::default());
        }
        let estimator = Estimator::new(session.store.records()?.iter());
        Ok(Self { plan: Some(session.plan.clone()), estimator, threads, unfinished, running: BTreeMap::new() })
    }

    /// Records an event of the run.
    pub(crate) fn note(&mut self, event: &Event) {
        match event {
            Event::Started { node, .. } => {
                self.running.insert(node.clone(), Running { since: Instant::now(), first: None, share: 0.0 });
            }
            Event::Progress { node, progress } => {
                if let Some(running) = self.running.get_mut(node).filter(|_| progress.total > 0) {
                    running.share = progress.done as f64 / progress.total as f64;
                    running.first.get_or_insert((Instant::now(), running.share));
                }
            }
            Event::Finished { node, result } => {
                self.running.remove(node);
                let index = self.unfinished.remove(node);
                if let (Outcome::Executed, Some(secs), Some(index), Some(plan)) =
                    (result.outcome, result.wall_secs, index, &self.plan)
                {
                    self.estimator.add_run(plan, &plan.nodes[index], secs);
                }
            }
            _ => (),
        }
    }

    /// The remaining time, e.g. `about 12 min 3 s left`. Jobs without a comparable measurement are counted.
    pub(crate) fn text(&self) -> Option<String> {
        let plan = self.plan.as_ref()?;
        let (mut known_secs, mut unknown) = (0.0, 0);
        for (name, &index) in &self.unfinished {
            let node = &plan.nodes[index];
            let threads = if node.threads == 0 { self.threads } else { node.threads.min(self.threads) };
            let secs = match self.running.get(name) {
                Some(running) => self.secs_left(plan, index, running),
                None => self.estimator.secs(plan, node),
            };
            match secs {
                Some(secs) => known_secs += secs * threads as f64 / self.threads.max(1) as f64,
                None => unknown += 1,
            }
        }
        match (self.unfinished.len(), unknown) {
            (0, _) => None,
            (_, 0) => Some(format!("about {} left", duration(known_secs))),
            (all, unknown) if all == unknown => Some(format!("{} of unknown duration left", count(unknown, "job"))),
            (_, unknown) => {
                Some(format!("about {} and {} of unknown duration left", duration(known_secs), count(unknown, "job")))
            }
        }
    }

    /// The remaining seconds of a running job, from its progress since its first report or else from its prediction.
    fn secs_left(&self, plan: &Plan, index: usize, running: &Running) -> Option<f64> {
        if let Some((time, first)) = running.first.filter(|(_, first)| running.share > *first) {
            return Some(time.elapsed().as_secs_f64() * (1.0 - running.share) / (running.share - first));
        }
        let elapsed = running.since.elapsed().as_secs_f64();
        self.estimator.secs(plan, &plan.nodes[index]).map(|secs| (secs - elapsed).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Duration;

    use engine::event::NodeResult;
    use engine::{Node, Progress};

    use super::*;

    fn started(node: &Node) -> Event {
        Event::Started { node: node.name.clone(), key: String::new(), threads: 1 }
    }

    fn finished(node: &Node, secs: f64) -> Event {
        let result = NodeResult { wall_secs: Some(secs), ..NodeResult::new(Outcome::Executed) };
        Event::Finished { node: node.name.clone(), result }
    }

    #[test]
    fn finished_jobs_teach_how_long_the_others_take() {
        let recipe = Path::new("builtin:quickstart");
        let plan = engine::recipe::resolve(recipe, &[], &crate::stages::stages(), Path::new("data")).expect("plans");
        let is_capture = |node: &&Node| node.template == "capture";
        let captures: Vec<Node> = plan.nodes.iter().filter(is_capture).cloned().collect();
        let unfinished = (0..plan.nodes.len()).filter(|&index| is_capture(&&plan.nodes[index]));
        let unfinished = unfinished.map(|index| (plan.nodes[index].name.clone(), index)).collect();
        let mut eta = Eta { plan: Some(plan), threads: 2, unfinished, ..Eta::default() };
        assert_eq!(eta.text().as_deref(), Some("2 jobs of unknown duration left"));
        eta.note(&started(&captures[0]));
        eta.note(&finished(&captures[0], 90.0));
        // The other capture has the same work.
        assert_eq!(eta.text().as_deref(), Some("about 1 min 30 s left"));
        eta.note(&started(&captures[1]));
        let report = |done| {
            let progress = Progress { done, total: 10, message: String::new() };
            Event::Progress { node: captures[1].name.clone(), progress }
        };
        eta.note(&report(6));
        assert_eq!(eta.text().as_deref(), Some("about 1 min 30 s left"), "these may be steps of an earlier job");
        let running = eta.running.get_mut(&captures[1].name).expect("it runs");
        running.first = Instant::now().checked_sub(Duration::from_secs(20)).map(|time| (time, 0.6));
        eta.note(&report(8));
        assert_eq!(eta.text().as_deref(), Some("about 20 s left"), "the last two steps take as long");
        eta.note(&finished(&captures[1], 90.0));
        assert_eq!(eta.text(), None);
    }
}
