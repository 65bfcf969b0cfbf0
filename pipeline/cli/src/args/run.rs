//! Arguments of verbs that run jobs, alone or together with other processes.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use clap::builder::NonEmptyStringValueParser;

use super::recipe::{DataArgs, RecipeArgs, SelectionArgs};
use super::sweep::SweepArgs;
use super::values::{BatchSystem, at_least_one, half_width_db, log_filter, part, some_time};

#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    #[command(flatten)]
    pub(crate) selection: SelectionArgs,
    /// Run up to N jobs at the same time (default: the number of threads)
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub(crate) jobs: Option<usize>,
    /// Use N threads for all jobs together (default: all of this machine)
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// Submit the jobs to a batch system. Each training becomes a batch job, together with the renders and metrics that
    /// depend only on it
    #[arg(long, value_enum, value_name = "SYSTEM", conflicts_with_all = ["frozen", "devices", "profile", "precision", "jobs", "threads"])]
    pub(crate) on: Option<BatchSystem>,
    /// Cluster file (TOML): partitions, accounts, limits and extra options by class of jobs; see pipeline/cluster
    #[arg(long, value_name = "FILE", requires = "on")]
    pub(crate) cluster: Option<PathBuf>,
    /// Return after the submission; `pipeline attach` follows the run
    #[arg(long, requires = "on")]
    pub(crate) detach: bool,
    /// Share the run among N worker processes, which divide threads and jobs among them; on a cluster, submit N pilots
    /// that take any ready jobs, instead of one batch job per training
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub(crate) workers: Option<usize>,
    /// Compute on several devices of this machine, one worker on each: all, or a list of adapters by number (as `doctor`
    /// lists them, from 0), PCI bus or part of the name, e.g. 0,1
    #[arg(long, value_delimiter = ',', value_name = "DEVICE,…", conflicts_with = "workers")]
    pub(crate) devices: Vec<String>,
    /// Take over a job whose process has sent no heartbeat for TIME because it froze or died on another machine (a
    /// process that dies on this machine is noticed at once)
    #[arg(long, value_parser = some_time, value_name = "TIME", default_value = "60s")]
    pub(crate) lease: Duration,
    /// Start no further jobs after the first failure; each of several workers reacts to the failures that it meets. Not with
    /// --on, where batch jobs do not see each other's failures
    #[arg(long, conflicts_with_all = ["max_failures", "on"])]
    pub(crate) fail_fast: bool,
    /// Start no further jobs after N failures; counted like --fail-fast
    #[arg(long, value_parser = at_least_one, value_name = "N", conflicts_with = "on")]
    pub(crate) max_failures: Option<usize>,
    /// Stop each job after TIME (e.g. 2h, 30min) and keep its checkpoint
    #[arg(long, value_parser = some_time, value_name = "TIME")]
    pub(crate) timeout: Option<Duration>,
    /// Fail without running anything if any job would have to run
    #[arg(long)]
    pub(crate) frozen: bool,
    /// Train with the seeds 0 to 2, then add seeds (at most 8) until the 95 % interval of every PSNR difference in the
    /// report (variants, methods and their bases) is within ±DB, e.g. 0.3
    #[arg(long, value_parser = half_width_db, value_name = "DB", conflicts_with_all = ["replicates", "frozen", "profile", "force"])]
    pub(crate) precision: Option<f64>,
    /// Print where the steps of each training spend their time. On a GPU, also print launches and readbacks per
    /// iteration and, for trainings of this run, the time of each kernel; timing kernels slows a training down
    #[arg(long, conflicts_with = "json")]
    pub(crate) profile: bool,
    #[command(flatten)]
    pub(crate) sweep: SweepArgs,
    /// Treat missing data as a failure
    #[arg(long)]
    pub(crate) require_data: bool,
    /// Print events as JSON lines instead of progress and a summary
    #[arg(long)]
    pub(crate) json: bool,
    /// Log filter for the jobs, e.g. debug or training=trace
    #[arg(long, default_value = "info", value_parser = log_filter, value_name = "FILTER")]
    pub(crate) log: String,
}

impl RunArgs {
    /// An option of this command line that a search does not have. The parser detects it together with `--sweep`, but
    /// not with `[sweep]` of a recipe.
    pub(crate) fn named_for_single_runs(&self) -> Option<&'static str> {
        let named = [
            ("--frozen", self.frozen),
            ("--precision", self.precision.is_some()),
            ("--profile", self.profile),
            ("--budget", self.recipe.with.budget.is_some()),
            ("--only", !self.selection.only.is_empty()),
            ("--force", !self.selection.force.is_empty()),
            ("--json", self.json),
            ("--rehash", self.selection.rehash),
            ("--require-data", self.require_data),
        ];
        named.into_iter().find(|(_, is_named)| *is_named).map(|(option, _)| option)
    }
}

#[derive(Debug, Args)]
pub(crate) struct WorkerArgs {
    /// Name of the run: a folder of STORE/runs (default: the newest shared run)
    pub(crate) run: Option<String>,
    /// Divide the list of jobs into N parts and look for work in part K first, so that workers do not contend for the same
    /// jobs, e.g. 2/4
    #[arg(long, value_parser = part, value_name = "K/N", default_value = "1/1")]
    pub(crate) part: (usize, usize),
    /// Run up to N jobs at the same time (default: the number of threads)
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub(crate) jobs: Option<usize>,
    /// Use N threads for all jobs together (default: all of this machine)
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// Device to compute on (default: that of the run)
    #[arg(long, value_name = "DEVICE")]
    pub(crate) device: Option<String>,
    /// End after TIME without a free job, even if other workers still run jobs
    #[arg(long, value_parser = humantime::parse_duration, value_name = "TIME")]
    pub(crate) idle: Option<Duration>,
    /// Be a batch job of this wave
    #[arg(long, hide = true, value_name = "N")]
    pub(crate) wave: Option<usize>,
    /// Compute the cell of this job's array element in batch N
    #[arg(long, hide = true, value_name = "N", requires = "wave")]
    pub(crate) batch: Option<usize>,
    /// Close the wave
    #[arg(long, hide = true, requires = "wave")]
    pub(crate) report: bool,
    /// End with this process
    #[arg(long, hide = true, value_name = "PID")]
    pub(crate) parent: Option<u32>,
}

#[derive(Debug, Args)]
pub(crate) struct AttachArgs {
    /// Name of the run: a folder of STORE/runs (default: the newest run on a cluster)
    pub(crate) run: Option<String>,
    /// Print events as JSON lines
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    #[command(flatten)]
    pub(crate) data: DataArgs,
    /// Check only this GPU, and require that it is usable: a part of its name, its PCI id (e.g. 10de:2335), its PCI
    /// bus, or gpu for the one that is likely fastest; cpu checks none, auto checks all (the default)
    #[arg(long, env = "PIPELINE_DEVICE", value_name = "ADAPTER", value_parser = NonEmptyStringValueParser::new())]
    pub(crate) device: Option<String>,
    /// Also check what runs on a cluster need: the store's file system, Slurm and, if named, a cluster file
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub(crate) cluster: Option<Option<PathBuf>>,
}
