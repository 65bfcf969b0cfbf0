//! The command line.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::builder::NonEmptyStringValueParser;
use clap::{Args, Parser, Subcommand, ValueEnum, value_parser};
use engine::DeviceClass;
use table_generation::Column;

use crate::amount::{Amount, parse_limit, parse_metric};

/// Trains, renders, measures and tabulates dynamic Gaussian-splatting methods, as a recipe says.
#[derive(Debug, Parser)]
#[command(name = "pipeline", version, propagate_version = true, after_help = EXIT_CODES)]
pub struct Cli {
    /// Folder that keeps results, logs and checkpoints
    #[arg(long, global = true, env = "PIPELINE_STORE", default_value = "store", value_name = "DIR")]
    pub store: PathBuf,
    #[command(subcommand)]
    pub verb: Verb,
}

const EXIT_CODES: &str = "Exit codes: 0 ok, 2 usage, 3 recipe or other input invalid, 4 nothing selected or nothing ran, 5 --frozen would have had \
to run, 10 some jobs failed, 11 table or check differs, 12 store damaged, 13 the machine failed, 75 checkpointed, \
130/143 interrupted, 141 the reader of the output went away.";

#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Runs what is not in the store yet and prints the tables
    Run(RunArgs),
    /// Tells what a run would do, and why
    Plan(PlanArgs),
    /// Tells why one job runs, and where its parameters come from
    Explain(NodeArgs),
    /// Tells what is done, running, failed and still to do
    Status(StatusArgs),
    /// Draws the job graph
    Graph(GraphArgs),
    /// Shows one job's result: folder, parameters, key, measurements
    Show(ShowArgs),
    /// Prints the last table, or tells whether it is the one that was committed
    Table(TableArgs),
    /// Compares two results, paired by row, scene and seed
    Compare(CompareArgs),
    /// Writes a model in a format of other programs
    Export(ExportArgs),
    /// Films a trained model: PNG frames at any times, from any cameras
    Render(RenderArgs),
    /// Tells what is recognised in a capture's folder
    Inspect {
        /// The capture's folder, or one of several captures
        dir: PathBuf,
        /// Print nothing but a recipe that trains on what is there
        #[arg(long)]
        recipe: bool,
    },
    /// Judges images, whoever made them
    Eval(EvalArgs),
    /// Looks after the store
    #[command(subcommand)]
    Cache(CacheVerb),
    /// Looks whether this machine has what runs need
    Doctor {
        /// Folder that recipes' sources are relative to
        #[arg(long, env = "PIPELINE_DATA", default_value = "data", value_name = "DIR")]
        data_root: PathBuf,
        /// Look at this GPU only, which must be usable: part of its name, its PCI id as 10de:2335, its
        /// PCI bus, or gpu for the likely fastest; with cpu, at none
        #[arg(long, value_name = "ADAPTER", value_parser = NonEmptyStringValueParser::new())]
        device: Option<String>,
    },
    /// Prints completions for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Runs one job; started by `run`
    #[command(hide = true)]
    ExecJob {
        /// The job's specification
        job: PathBuf,
    },
}

/// A recipe and what it is applied to.
#[derive(Clone, Debug, Args)]
pub struct RecipeArgs {
    /// The recipe, a TOML file
    pub recipe: PathBuf,
    #[command(flatten)]
    pub with: Conditions,
}

/// What a recipe is applied to, and what is changed in it.
#[derive(Clone, Debug, Args)]
pub struct Conditions {
    /// Folder that the recipe's sources are relative to
    #[arg(long, env = "PIPELINE_DATA", default_value = DATA_ROOT, value_name = "DIR")]
    pub data_root: PathBuf,
    /// Overrides a value of the recipe, as nodes.train.params.schedule_scale=0.5; can be repeated
    #[arg(short = 's', long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Train with the seeds 0 to N − 1 instead of those of the recipe
    #[arg(long, value_parser = replicates, value_name = "N")]
    pub replicates: Option<usize>,
    /// Give every training the schedule, shorter or longer than its own, that takes about so long, as 60s or 10m; which one
    /// is measured when it starts, so that such a result is not reproducible bit for bit
    #[arg(long, value_parser = budget, value_name = "TIME")]
    pub budget: Option<Duration>,
    /// What trains and renders: cpu, gpu (the likely fastest adapter), auto (a GPU if there is one that is not software,
    /// else the CPU), or an adapter by part of its name, its PCI id or its PCI bus; CPU and GPU keep separate results
    #[arg(long, env = "PIPELINE_DEVICE", default_value = AUTO, value_name = "DEVICE", value_parser = NonEmptyStringValueParser::new())]
    pub device: String,
}

/// The device if none is named.
const AUTO: &str = "auto";

/// The folder of data if none is named.
const DATA_ROOT: &str = "data";

/// The variables of the environment that options are read from.
pub const VARIABLES: [&str; 3] = ["PIPELINE_STORE", "PIPELINE_DATA", "PIPELINE_DEVICE"];

impl Conditions {
    /// Whether nothing of the recipe is changed.
    pub fn is_plain(&self) -> bool {
        self.set.is_empty() && self.replicates.is_none() && self.budget.is_none()
    }

    /// The arguments that make the same again, on a device of this class. Where data lies changes nothing: `DATA` stands
    /// for the folder.
    pub fn arguments(&self, device: DeviceClass) -> Vec<String> {
        let mut arguments: Vec<String> = self.set.iter().flat_map(|set| ["-s".into(), set.clone()]).collect();
        arguments.extend(self.replicates.iter().flat_map(|count| ["--replicates".into(), count.to_string()]));
        let budget = self.budget.map(|budget| humantime::format_duration(budget).to_string().replace(' ', ""));
        arguments.extend(budget.into_iter().flat_map(|budget| ["--budget".into(), budget]));
        arguments.extend(["--device".into(), device.as_str().into()]);
        let is_elsewhere = self.data_root != Path::new(DATA_ROOT);
        arguments.extend(["--data-root", "DATA"].map(String::from).into_iter().filter(|_| is_elsewhere));
        arguments
    }
}

/// Which jobs of a recipe.
#[derive(Clone, Debug, Args)]
pub struct SelectionArgs {
    /// Only these jobs and what they need, as train/lego or train/*/static*; can be repeated
    #[arg(long, value_name = "PATTERN")]
    pub only: Vec<String>,
    /// Run these jobs even if their results are there; can be repeated
    #[arg(long, value_name = "PATTERN")]
    pub force: Vec<String>,
    /// Hash all sources again, whatever their time stamps say
    #[arg(long)]
    pub rehash: bool,
}

#[derive(Debug, Args)]
pub struct RunArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    #[command(flatten)]
    pub selection: SelectionArgs,
    /// Jobs at the same time (default: as many as there are threads)
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub jobs: Option<usize>,
    /// Threads of all jobs together (default: all of this machine)
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub threads: Option<usize>,
    /// Launch nothing more after the first failure
    #[arg(long, conflicts_with = "max_failures")]
    pub fail_fast: bool,
    /// Launch nothing more after so many failures
    #[arg(long, value_parser = at_least_one, value_name = "N")]
    pub max_failures: Option<usize>,
    /// Stop a job that runs longer, as 2h or 30min; its progress is kept
    #[arg(long, value_parser = humantime::parse_duration, value_name = "TIME")]
    pub timeout: Option<Duration>,
    /// Fail, running nothing, if anything would have to run
    #[arg(long)]
    pub frozen: bool,
    /// Print what the steps of every training spend their time on; on a GPU, its launches and readbacks per iteration and,
    /// for trainings that run now, the time of every kernel (which makes them slower)
    #[arg(long, conflicts_with = "json")]
    pub profile: bool,
    /// Missing data is a failure
    #[arg(long)]
    pub require_data: bool,
    /// Print events as JSON lines instead of tables
    #[arg(long)]
    pub json: bool,
    /// What the jobs' logs hold, as debug or training=trace
    #[arg(long, default_value = "info", value_parser = log_filter, value_name = "FILTER")]
    pub log: String,
}

#[derive(Debug, Args)]
pub struct PlanArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    #[command(flatten)]
    pub selection: SelectionArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct NodeArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    /// The job's name, as train/lego/static3dgs/0
    pub node: String,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct StatusArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct GraphArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    /// The language to draw in
    #[arg(long, value_enum, default_value_t)]
    pub format: GraphFormat,
    /// One box per kind of job
    #[arg(long)]
    pub collapse: bool,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum GraphFormat {
    /// Graphviz
    #[default]
    Dot,
    /// Mermaid, as Markdown pages render it
    Mermaid,
}

#[derive(Debug, Args)]
pub struct ShowArgs {
    #[command(flatten)]
    pub node: NodeArgs,
    /// Print only the folder of the artifact
    #[arg(long, conflicts_with = "json")]
    pub path: bool,
}

#[derive(Debug, Args)]
pub struct TableArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    /// The format
    #[arg(long, value_enum, default_value_t)]
    pub format: TableFormat,
    /// Instead compare the table with this file, within its tolerances; exit code 11 if a number, row or protocol differs
    #[arg(long, value_name = "FILE", conflicts_with = "format")]
    pub check: Option<PathBuf>,
    /// Instead write the table to this file, to check against; tolerances of a file that is there stay
    #[arg(long, value_name = "FILE", conflicts_with_all = ["format", "check"])]
    pub write_check: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct CompareArgs {
    /// What B is compared with: a recipe, the folder of a report, or its report.json; options hold for recipes, so that a
    /// recipe is compared with itself by keeping its report: cp -r store/results/NAME/report/ KEPT
    pub a: PathBuf,
    /// The same
    pub b: PathBuf,
    #[command(flatten)]
    pub with: Conditions,
    /// Compare this row of A with that row of B, as static3dgs=mcgs (default: rows of equal names); can be repeated
    #[arg(long, value_parser = two_rows, value_name = "ROW_A=ROW_B")]
    pub rows: Vec<(String, String)>,
    /// Print this metric, as psnr or training_secs (default: psnr, ssim, training_secs); can be repeated
    #[arg(long = "metric", value_parser = parse_metric, value_name = "METRIC", conflicts_with = "json")]
    pub metrics: Vec<Column>,
    /// Fail with exit code 11 where the mean of a row is worse in B by more, as 0.1dB, ssim=0.01 or training_secs=20%,
    /// or where B lacks the value; can be repeated
    #[arg(long, value_parser = parse_limit, value_name = "METRIC=AMOUNT")]
    pub fail_if_worse: Vec<(Column, Amount)>,
    /// Print JSON, with all metrics
    #[arg(long)]
    pub json: bool,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum TableFormat {
    /// Markdown
    #[default]
    Md,
    /// LaTeX
    Latex,
    /// Comma-separated, unrounded
    Csv,
    /// JSON, unrounded, with the action key of every cell
    Json,
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    /// The training job, as train/lego/deformable4dgs/0
    pub node: String,
    /// The format
    #[arg(long, value_enum, default_value_t)]
    pub format: ExportFormat,
    /// Times in seconds of the capture, as FIRST:LAST:COUNT
    #[arg(long, value_parser = parse_times, value_name = "FIRST:LAST:COUNT", allow_hyphen_values = true)]
    pub times: Times,
    /// The folder to write into
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

#[derive(Debug, Args)]
pub struct RenderArgs {
    #[command(flatten)]
    pub recipe: RecipeArgs,
    /// Training jobs, e.g. train/lego/deformable4dgs/0; several with --gif
    #[arg(required = true, value_name = "JOB")]
    pub jobs: Vec<String>,
    /// Times in seconds of the capture; 0.5:0.5:60 freezes the motion (default with --views: the times of these views)
    #[arg(long, value_parser = parse_times, value_name = "FIRST:LAST:COUNT", allow_hyphen_values = true)]
    #[arg(required_unless_present = "views")]
    pub times: Option<Times>,
    /// Capture views that the camera moves through, e.g. test_0000,test_0004, or all views of a split: train, val or test
    /// (default: the camera stands at the first test view)
    #[arg(long, value_delimiter = ',', value_name = "VIEW,…")]
    pub views: Vec<String>,
    /// Highlight the region that matches a prompt of the model (e.g. ball); l4dgs only
    #[arg(long)]
    pub prompt: Option<String>,
    /// Write PNG frames into this folder, which must be new or empty
    #[arg(long, value_name = "DIR", required_unless_present = "gif", conflicts_with = "gif")]
    pub out: Option<PathBuf>,
    /// Write a looping animated GIF with the jobs side by side
    #[arg(long, value_name = "FILE")]
    pub gif: Option<PathBuf>,
    /// Start the GIF with the capture's own images; the film must follow views of the capture
    #[arg(long, requires = "gif")]
    pub truth: bool,
    /// Enlarge every panel of the GIF by this factor
    #[arg(long, requires = "gif", value_name = "N", default_value_t = 1, value_parser = value_parser!(u32).range(1..=16))]
    pub scale: u32,
    /// Frames per second of the GIF, rounded to hundredths of a second per frame
    #[arg(long, requires = "gif", value_name = "N", default_value_t = 10, value_parser = value_parser!(u32).range(1..=50))]
    pub fps: u32,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum ExportFormat {
    /// One PLY file of Gaussians per time, as common viewers open them
    #[default]
    PlySeq,
}

#[derive(Debug, Args)]
pub struct EvalArgs {
    /// Folder with the images to judge
    #[arg(long, value_name = "DIR")]
    pub renders: PathBuf,
    /// Folder with the true images of the same names
    #[arg(long, value_name = "DIR")]
    pub truth: PathBuf,
    /// Folder with the weights of LPIPS: torchvision's alexnet-owt-7be5be79.pth, vgg16-397923af.pth,
    /// squeezenet1_1-b8a52dc0.pth, and alex.pth, vgg.pth, squeeze.pth of LPIPS 0.1; what is there is used
    #[arg(long, value_name = "DIR")]
    pub lpips_weights: Option<PathBuf>,
    /// Print JSON with the values of every image
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Subcommand)]
pub enum CacheVerb {
    /// Hashes every file of the store
    Verify {
        /// Move what is damaged aside, so that the next run makes it again
        #[arg(long)]
        repair: bool,
    },
    /// Removes results that nothing recent needs
    Gc(GcArgs),
    /// Tells what takes how much space
    Du,
}

#[derive(Debug, Args)]
pub struct GcArgs {
    /// Only tell what would go
    #[arg(long)]
    pub dry_run: bool,
    /// Keep everything that was used within this time
    #[arg(long, value_parser = humantime::parse_duration, default_value = "30d", value_name = "TIME")]
    pub max_age: Duration,
    /// Keep everything that the last so many runs planned
    #[arg(long, default_value_t = 10, value_name = "N")]
    pub keep_runs: usize,
}

/// Times in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Times(pub Vec<f64>);

/// `ROW_A=ROW_B`; the names of rows may hold `=` themselves, as `l4dgs ablation=full`, and then both do.
fn two_rows(text: &str) -> Result<(String, String), String> {
    let signs: Vec<usize> = text.match_indices('=').map(|(at, _)| at).collect();
    let middle = (signs.len() % 2 == 1).then(|| signs[signs.len() / 2]);
    let (a, b) = middle.map(|at| (&text[..at], &text[at + 1..])).unwrap_or_default();
    if a.is_empty() || b.is_empty() {
        return Err(format!("expected ROW_A=ROW_B, as static3dgs=mcgs, not {text}"));
    }
    Ok((a.into(), b.into()))
}

/// A count of which 0 makes no sense.
fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&count| count > 0).ok_or_else(|| "expected a number from 1 on".to_owned())
}

/// More seeds than this are a slip of the finger.
const MAX_REPLICATES: usize = 1000;

fn replicates(text: &str) -> Result<usize, String> {
    let count = at_least_one(text)?;
    if count <= MAX_REPLICATES { Ok(count) } else { Err(format!("at most {MAX_REPLICATES} seeds, not {count}")) }
}

fn budget(text: &str) -> Result<Duration, String> {
    let time = humantime::parse_duration(text).map_err(|error| error.to_string())?;
    if time.is_zero() { Err("a training needs some time, as 60s".into()) } else { Ok(time) }
}

/// A filter that the jobs will understand.
fn log_filter(text: &str) -> Result<String, String> {
    engine::job::check_log_filter(text).map(|()| text.to_owned())
}

/// More files than this in one folder are a slip of the finger: an hour at 25 per second is 90,000.
const MAX_TIMES: usize = 100_000;

/// `FIRST:LAST:COUNT`: evenly spaced times with both ends.
pub fn parse_times(text: &str) -> Result<Times, String> {
    let wrong = || format!("expected FIRST:LAST:COUNT, as 0:1:30, not {text}");
    let [first, last, count] = text.split(':').collect::<Vec<_>>()[..] else { return Err(wrong()) };
    let number = |text: &str| text.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(wrong);
    let (first, last) = (number(first)?, number(last)?);
    let count: usize = count.parse().ok().filter(|&count| count > 0).ok_or_else(wrong)?;
    if count > MAX_TIMES {
        return Err(format!("at most {MAX_TIMES} times, not {count}"));
    }
    // A single time is the first one.
    let step = if count > 1 { (last - first) / (count - 1) as f64 } else { 0.0 };
    Ok(Times((0..count).map(|index| first + step * index as f64).collect()))
}
