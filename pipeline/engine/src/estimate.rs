//! Predicted seconds of jobs, scaled by their work from measured jobs.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

use crate::store::ActionRecord;
use crate::{Node, Plan, Work};

/// Number of newest measurements that are kept per group; older ones may be of other code.
const MAX_SAMPLES: usize = 32;
/// Measured jobs with this many times more or less work are not comparable.
const MAX_SCALE: f64 = 1000.0;
/// The limit for measurements that ship with the program: a rough prediction is better than none.
const MAX_SHIPPED_SCALE: f64 = 1e6;
/// The ratios that are tried between the costs of the two amounts of work: powers of this number, in both directions.
const RATIO_STEP: f64 = 1.8;
/// The number of powers in each direction: ratios up to 1.8⁸ ≈ 110.
const RATIO_STEPS: i32 = 8;
/// The weight of the assumption that both amounts cost the same per unit, in squared relative errors.
const PRIOR: f64 = 0.0002;
/// The weight of a measurement of the same job, relative to one of another job with equal work.
const SAME_JOB: f64 = 4.0;

/// The weight of the assumed scatter, as a number of measurements: one measured job says little about the next.
const ASSUMED_COUNT: f64 = 2.0;
/// The assumed scatter of the logarithm of the seconds of comparable jobs.
const ASSUMED_SCATTER: f64 = 0.35;
/// The additional scatter of that logarithm for each factor e between the work and that of the nearest measurement.
const SCATTER_PER_SCALE: f64 = 0.15;
/// The additional scatter of that logarithm if the measurements are of other machines.
const SCATTER_BETWEEN_MACHINES: f64 = 0.5;
/// The half-width of a range in standard deviations: nine of ten jobs of normal scatter.
const RANGE: f64 = 1.645;

/// The predicted time of a job.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The expected seconds.
    pub secs: f64,
    /// The range in which nine of ten jobs are expected to end, in seconds.
    pub range_secs: [f64; 2],
    /// The number of comparable measured jobs.
    pub measurements: usize,
    /// Whether one of them was this job, perhaps with other parameters.
    pub has_same_job: bool,
    /// Whether they were measured on other machines.
    pub is_foreign: bool,
}

impl Estimate {
    /// A range around `secs` from the standard deviation of its logarithm.
    fn of(secs: f64, scatter: f64, measurements: usize, has_same_job: bool, is_foreign: bool) -> Self {
        let between = if is_foreign { SCATTER_BETWEEN_MACHINES } else { 0.0 };
        let factor = (RANGE * scatter.hypot(between)).exp();
        Self { secs, range_secs: [secs / factor, secs * factor], measurements, has_same_job, is_foreign }
    }
}

/// Predicts the seconds of jobs from the measured jobs of the same stage, kind and device class.
#[derive(Clone, Debug, Default)]
pub struct Estimator {
    /// Stage, kind of work and device class → measurements, oldest first.
    groups: BTreeMap<[String; 3], Vec<Sample>>,
    /// Stage and job → parameters and seconds of the last run, for jobs whose work is unknown.
    last: BTreeMap<[String; 2], (serde_json::Value, f64)>,
    /// The groups and jobs that were measured on other machines only.
    foreign: BTreeSet<Vec<String>>,
}

/// A measured job that ships with the program, for predictions before anything was measured here.
#[derive(Clone, Debug, Deserialize)]
pub struct Shipped {
    /// The stage.
    pub stage: String,
    /// The kind of its work.
    pub kind: String,
    /// The name of the device class.
    pub device: String,
    /// The amounts of its work.
    pub amounts: [f64; 2],
    /// The measured seconds.
    pub secs: f64,
}

/// See [`ship`].
static SHIPPED: OnceLock<Vec<Shipped>> = OnceLock::new();

/// Sets the measurements that ship with the program, once per process. Estimators that are made later use them for stages,
/// kinds and devices of which the store has no measurement.
pub fn ship(measured: Vec<Shipped>) {
    // Later calls change nothing.
    let _ = SHIPPED.set(measured);
}

/// A measured job.
#[derive(Clone, Debug)]
struct Sample {
    /// The job's name; empty if the measurement ships with the program.
    node: String,
    amounts: [f64; 2],
    secs: f64,
}

impl Estimator {
    /// Learns from records, oldest first. Records of this machine are preferred: those of others are used for groups
    /// without any.
    pub fn new<'a>(records: impl Iterator<Item = &'a ActionRecord> + Clone) -> Self {
        let host = crate::process::host_name();
        let (mut own, mut others) = (Self::default(), Self::default());
        for record in records {
            let estimator = if record.provenance.host == host { &mut own } else { &mut others };
            estimator.learn(record);
        }
        for (group, samples) in others.groups {
            if !own.groups.contains_key(&group) {
                own.foreign.insert(group.to_vec());
                own.groups.insert(group, samples);
            }
        }
        own.add_shipped(SHIPPED.get().map_or(&[], Vec::as_slice));
        for (job, secs) in others.last {
            if !own.last.contains_key(&job) {
                own.foreign.insert(job.to_vec());
                own.last.insert(job, secs);
            }
        }
        own
    }

    /// Adds measurements that ship with the program to groups without any.
    fn add_shipped(&mut self, shipped: &[Shipped]) {
        let mut groups: BTreeMap<[String; 3], Vec<Sample>> = BTreeMap::new();
        for one in shipped {
            let group = [&one.stage, &one.kind, &one.device].map(String::to_owned);
            let sample = Sample { node: String::new(), amounts: one.amounts, secs: one.secs };
            groups.entry(group).or_default().push(sample);
        }
        groups.retain(|group, _| !self.groups.contains_key(group));
        self.foreign.extend(groups.keys().map(|group| group.to_vec()));
        self.groups.extend(groups);
    }

    fn learn(&mut self, record: &ActionRecord) {
        let (made, components) = (&record.provenance, &record.components);
        self.add(&components.stage, &made.node, &components.environment, made.work.as_ref(), made.wall_secs);
        self.last.insert(job_key(&components.stage, &made.node), (components.params.clone(), made.wall_secs));
    }

    /// Adds the measured seconds of a job of `plan` that has just run.
    pub fn add_run(&mut self, plan: &Plan, node: &Node, secs: f64) {
        self.add(&node.stage, &node.name, plan.device_of(node).as_str(), node.work.as_ref(), secs);
        let job = job_key(&node.stage, &node.name);
        self.foreign.remove(job.as_slice());
        self.last.insert(job, (node.params.clone(), secs));
    }

    fn add(&mut self, stage: &str, node: &str, device: &str, work: Option<&Work>, secs: f64) {
        let Some(Work { kind, amounts }) = work else { return };
        let group = [stage, kind, device].map(str::to_owned);
        let was_foreign = self.foreign.remove(group.as_slice());
        let samples = self.groups.entry(group).or_default();
        if was_foreign {
            // A measurement of this machine replaces those of others.
            samples.clear();
        }
        // Shorter times are rounding errors of the clock.
        samples.push(Sample { node: node.to_owned(), amounts: *amounts, secs: secs.max(1e-3) });
        samples.drain(..samples.len().saturating_sub(MAX_SAMPLES));
    }

    /// The expected seconds of a job of `plan`; `None` if no comparable job was measured.
    pub fn secs(&self, plan: &Plan, node: &Node) -> Option<f64> {
        self.estimate(plan, node).map(|estimate| estimate.secs)
    }

    /// The predicted time of a job of `plan`; `None` if no comparable job was measured.
    pub fn estimate(&self, plan: &Plan, node: &Node) -> Option<Estimate> {
        let Some(Work { kind, amounts }) = &node.work else {
            let job = job_key(&node.stage, &node.name);
            let (params, secs) = self.last.get(&job)?;
            let is_foreign = self.foreign.contains(job.as_slice());
            return (*params == node.params).then(|| Estimate::of(*secs, ASSUMED_SCATTER, 1, true, is_foreign));
        };
        let group = [&node.stage, kind, plan.device_of(node).as_str()].map(str::to_owned);
        let samples = self.groups.get(&group)?;
        let nearby: Vec<Weighted<'_>> = samples.iter().filter_map(|sample| weighted(sample, node, *amounts)).collect();
        if nearby.is_empty() {
            return None;
        }
        let ratios = (-RATIO_STEPS..=RATIO_STEPS).map(|power| RATIO_STEP.powi(power));
        let fits = ratios.map(|ratio| (ratio, Fit::of(&nearby, ratio)));
        let cost = |(ratio, fit): &(f64, Fit)| fit.variance + PRIOR * ratio.ln().powi(2);
        let (ratio, fit) = fits.min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        let secs = fit.log_rate.exp() * total(*amounts, ratio);
        let count = nearby.len() as f64;
        let scatter = (fit.variance * count + ASSUMED_SCATTER.powi(2) * ASSUMED_COUNT) / (count + ASSUMED_COUNT);
        let nearest = nearby.iter().map(|one| one.distance).fold(f64::INFINITY, f64::min);
        let has_same_job = nearby.iter().any(|one| one.sample.node == node.name);
        let scatter = scatter.sqrt().hypot(SCATTER_PER_SCALE * nearest);
        Some(Estimate::of(secs, scatter, nearby.len(), has_same_job, self.foreign.contains(group.as_slice())))
    }
}

/// Stage and job.
fn job_key(stage: &str, job: &str) -> [String; 2] {
    [stage, job].map(str::to_owned)
}

/// A measured job with its weight in one prediction.
struct Weighted<'a> {
    sample: &'a Sample,
    weight: f64,
    /// The logarithm of the factor between the amounts of work, summed over both.
    distance: f64,
}

/// The measurement with a weight that falls with the relative difference of the work; `None` if it is not comparable.
fn weighted<'a>(sample: &'a Sample, node: &Node, amounts: [f64; 2]) -> Option<Weighted<'a>> {
    let scale = |(own, measured): (f64, f64)| match (own > 0.0, measured > 0.0) {
        (true, true) => (own / measured).ln().abs(),
        (false, false) => 0.0,
        _ => f64::INFINITY,
    };
    let scales = [0, 1].map(|at| scale((amounts[at], sample.amounts[at])));
    let max_scale = if sample.node.is_empty() { MAX_SHIPPED_SCALE } else { MAX_SCALE };
    if !(scales[0].max(scales[1]) <= max_scale.ln()) {
        return None;
    }
    let same_job = if sample.node == node.name { SAME_JOB } else { 1.0 };
    let distance = scales[0] + scales[1];
    Some(Weighted { sample, weight: same_job / (0.1 + distance).powi(2), distance })
}

/// Seconds per unit of work, fitted for one ratio between the costs of the two amounts.
struct Fit {
    /// The logarithm of the seconds per unit.
    log_rate: f64,
    /// The weighted mean of the squared relative errors.
    variance: f64,
}

impl Fit {
    fn of(nearby: &[Weighted<'_>], ratio: f64) -> Self {
        let log_rate = |one: &Weighted<'_>| (one.sample.secs / total(one.sample.amounts, ratio)).ln();
        let sum: f64 = nearby.iter().map(|one| one.weight).sum();
        let mean = nearby.iter().map(|one| one.weight * log_rate(one)).sum::<f64>() / sum;
        let squares = nearby.iter().map(|one| one.weight * (log_rate(one) - mean).powi(2));
        Self { log_rate: mean, variance: squares.sum::<f64>() / sum }
    }
}

/// The work as one number, for one ratio between the costs of its amounts.
fn total(amounts: [f64; 2], ratio: f64) -> f64 {
    amounts[0] + ratio * amounts[1]
}
