//! The command line: every verb with its options. The docstrings below are the help texts.

mod goal;
mod prepare;
mod recipe;
mod run;
mod sweep;
mod values;

pub(crate) use self::goal::Goal;
pub(crate) use self::prepare::PrepareArgs;
pub(crate) use self::sweep::{SweepArgs, SweepSettings};
pub(crate) use recipe::{AUTO, Conditions, DataArgs, NodeArgs, RecipeArgs, STORE, SelectionArgs, VARIABLES, command};
pub(crate) use run::{AttachArgs, DoctorArgs, RunArgs, WorkerArgs};
pub(crate) use values::{ExportFormat, GraphFormat, TableFormat, Times};

use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgGroup, Args, Parser, Subcommand, value_parser};
use metric_evaluation::Background;
use rendering::{Selection, Show};
use table_generation::Column;

use crate::amount::{Amount, parse_limit};
use values::{at_least_one, background, capture_format, file_with_extension, parse_times, row_pair, trimmed};

/// Train, render, evaluate and tabulate dynamic Gaussian-splatting methods as a recipe describes.
#[derive(Debug, Parser)]
#[command(name = "pipeline", version, propagate_version = true, after_help = EXIT_CODES)]
pub(crate) struct Cli {
    /// Folder for results, logs and checkpoints
    #[arg(long, global = true, env = "PIPELINE_STORE", default_value = STORE, value_name = "DIR")]
    pub(crate) store: PathBuf,
    #[command(subcommand)]
    pub(crate) verb: Verb,
}

const EXIT_CODES: &str = "\
Exit codes: 0 success, 2 usage, 3 invalid recipe or other input, 4 nothing selected or nothing ran, 5 --frozen and a job \
would have to run, 10 some jobs failed, 11 a table or check differs, 12 damaged store, 13 machine failure, \
14 some results are degenerate (no better than a constant image), 75 checkpointed, 130/143 interrupted, \
141 standard output was closed.";

#[derive(Debug, Subcommand)]
pub(crate) enum Verb {
    /// Run the jobs whose results are missing from the store, and print a summary with the path of the report
    Run(Box<RunArgs>),
    /// Join a run that several processes share, and take jobs that no other process holds
    Worker(WorkerArgs),
    /// Follow a run that was submitted to a cluster, and print its results
    Attach(AttachArgs),
    /// Cancel the batch jobs of a run; trainings are given the time to save their progress
    Cancel {
        /// Name of the run: a folder of STORE/runs (default: the newest run on a cluster)
        run: Option<String>,
    },
    /// Show which jobs a run would execute, and why
    Plan(PlanArgs),
    /// Explain why one job runs and where each of its parameters comes from
    Explain(NodeArgs),
    /// Count the jobs that are done, running, failed and still to do
    Status(StatusArgs),
    /// Print the job graph
    Graph(GraphArgs),
    /// Show the result of one job: folder, parameters, key, measurements
    Show(ShowArgs),
    /// Print the latest table, or check it against a committed one
    Table(TableArgs),
    /// Compare two results, paired by row, scene and seed. Intervals are over scenes, or over the seeds of a single scene
    Compare(CompareArgs),
    /// Export a trained model to a format that other programs read
    Export(ExportArgs),
    /// Render trained models at any times and along the cameras of the capture: PNG frames, a GIF or a contact sheet
    Render(RenderArgs),
    /// Make a capture from a video or a folder of images, with FFmpeg, COLMAP and your own estimators. Results are
    /// kept: a killed run continues, and a second run executes nothing
    Prepare(PrepareArgs),
    /// Describe what a folder of captures contains and what can be imported
    Inspect {
        /// Folder of one capture or of several
        dir: PathBuf,
        /// Print only a recipe that trains on the captures
        #[arg(long)]
        recipe: bool,
        /// Read the captures in this format, where a folder has the files of several: the parameter `format` of the import
        #[arg(long, value_parser = capture_format, value_name = "NAME", default_value = "auto")]
        format: sfm_import::Format,
    },
    /// List, print or copy the recipes that are built into this program
    #[command(subcommand)]
    Recipes(RecipesVerb),
    /// List, print, fetch or verify public data sets: folders, files, counts, flaws, licences
    #[command(subcommand)]
    Data(DataVerb),
    /// Compute image metrics for a folder of images from any source
    Eval(EvalArgs),
    /// Maintain the store
    #[command(subcommand)]
    Cache(CacheVerb),
    /// Check this machine for the requirements of runs: store, data, GPUs
    Doctor(DoctorArgs),
    /// Print a completion script for a shell
    Completions {
        /// Shell to complete commands for
        shell: clap_complete::Shell,
    },
    /// Run one job; `run` starts this as a child process
    #[command(hide = true)]
    ExecJob {
        /// File with the job's specification
        job: PathBuf,
    },
}

#[derive(Debug, Args)]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    #[command(flatten)]
    pub(crate) selection: SelectionArgs,
    /// Accept the option of `run`, so that its command line can be pasted.
    #[arg(long, hide = true, value_parser = at_least_one, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// Print how much of the work is likely to be done after TIME, e.g. 8h
    #[arg(long, value_parser = humantime::parse_duration, value_name = "TIME", conflicts_with = "json")]
    pub(crate) within: Option<Duration>,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct StatusArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct GraphArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    /// Graph language
    #[arg(long, value_enum, default_value_t)]
    pub(crate) format: GraphFormat,
    /// Draw one box per node of the recipe instead of one per job
    #[arg(long)]
    pub(crate) collapse: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ShowArgs {
    #[command(flatten)]
    pub(crate) node: NodeArgs,
    /// Print only the folder of the result
    #[arg(long, conflicts_with = "json")]
    pub(crate) path: bool,
}

#[derive(Debug, Args)]
pub(crate) struct TableArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    /// Output format
    #[arg(long, value_enum, default_value_t)]
    pub(crate) format: TableFormat,
    /// Make the table from the jobs that are finished, e.g. after an interrupted run; the others count as not run
    #[arg(long, conflicts_with_all = ["check", "write_check"])]
    pub(crate) partial: bool,
    /// Compare the table with FILE within its tolerances instead of printing it; exit with 11 if a number, row or
    /// protocol differs
    #[arg(long, value_name = "FILE", conflicts_with = "format")]
    pub(crate) check: Option<PathBuf>,
    /// Write the table to FILE for later checks instead of printing it; the tolerances of an existing FILE are kept
    #[arg(long, value_name = "FILE", conflicts_with_all = ["format", "check"])]
    pub(crate) write_check: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct CompareArgs {
    /// Baseline: a recipe, a report folder, or a report.json. The options below apply to recipes only; to compare a
    /// recipe with itself after a change, keep its report first: cp -r store/results/NAME/report/ KEPT
    pub(crate) a: PathBuf,
    /// Candidate: a recipe, a report folder, or a report.json
    pub(crate) b: PathBuf,
    #[command(flatten)]
    pub(crate) with: Conditions,
    /// Compare row ROW_A of A with row ROW_B of B, e.g. static3dgs=mcgs (default: rows of equal names); can be repeated
    #[arg(long, value_parser = row_pair, value_name = "ROW_A=ROW_B")]
    pub(crate) rows: Vec<(String, String)>,
    /// Print this metric, e.g. psnr or training_secs (default: psnr, ssim and training_secs); can be repeated
    #[arg(long = "metric", value_parser = Column::named, value_name = "METRIC", conflicts_with = "json")]
    pub(crate) metrics: Vec<Column>,
    /// Exit with 11 if the mean of any row is worse in B by more than AMOUNT (e.g. 0.1dB, ssim=0.01,
    /// training_secs=20%), or if B lacks a value or a whole run of A, with --rows of these rows; can be repeated
    #[arg(long, value_parser = parse_limit, value_name = "METRIC=AMOUNT")]
    pub(crate) fail_if_worse: Vec<(Column, Amount)>,
    /// Print JSON with all metrics
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    /// Name of the training job, e.g. train/lego/deformable4dgs/0
    #[arg(value_name = "JOB")]
    pub(crate) node: String,
    /// Output format
    #[arg(long, value_enum, default_value_t)]
    pub(crate) format: ExportFormat,
    /// Evenly spaced times to export, in seconds of the capture
    #[arg(long, value_parser = parse_times, value_name = "FIRST:LAST:COUNT", allow_hyphen_values = true)]
    pub(crate) times: Times,
    #[command(flatten)]
    pub(crate) prompt: PromptArgs,
    /// Folder to write to
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

/// A prompt to a model of l4dgs.
#[derive(Debug, Args)]
pub(crate) struct PromptArgs {
    /// Select what matches PROMPT, one of the model's prompts (e.g. ball) or of --embeddings; l4dgs models only
    #[arg(long)]
    pub(crate) prompt: Option<String>,
    /// What to do with the selected part of the scene: highlight, mask (white on black), remove, keep (remove all
    /// else), or recolour=#rrggbb (default: highlight in a film, keep in an export)
    #[arg(long, value_name = "EDIT", requires = "prompt", value_parser = parse_show)]
    pub(crate) edit: Option<Show>,
    /// Folder with further prompts: prompts.txt (one per line) and text.npy [P, F], from the text encoder of the training.
    /// They compete with the model's own prompts: a prompt selects what matches it better than all others
    #[arg(long, value_name = "DIR", requires = "prompt")]
    pub(crate) embeddings: Option<PathBuf>,
}

impl PromptArgs {
    /// The selection, if there is a prompt; `default` is the edit without `--edit`.
    pub(crate) fn selection(&self, default: Show) -> Option<Selection<'_>> {
        let prompt = self.prompt.as_deref()?;
        Some(Selection { prompt, embeddings: self.embeddings.as_deref(), show: self.edit.unwrap_or(default) })
    }
}

fn parse_show(text: &str) -> Result<Show, String> {
    text.parse()
}

#[derive(Debug, Args)]
#[command(group(ArgGroup::new("frames").args(["times", "views"]).required(true).multiple(true)))]
#[command(group(ArgGroup::new("output").args(["out", "gif", "sheet"]).required(true)))]
pub(crate) struct RenderArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    /// Names of training jobs, e.g. train/lego/deformable4dgs/0; several with --gif or --sheet
    #[arg(required = true, value_name = "JOB")]
    pub(crate) jobs: Vec<String>,
    /// Evenly spaced times to render, in seconds of the capture; 0.5:0.5:60 freezes the motion for 60 frames (default with
    /// --views: the times of these views)
    #[arg(long, value_parser = parse_times, value_name = "FIRST:LAST:COUNT", allow_hyphen_values = true)]
    pub(crate) times: Option<Times>,
    /// Views of the capture to move the camera through, e.g. test_0000,test_0004; train, val and test stand for all views
    /// of a split (default: a fixed camera at the first test view)
    #[arg(long, value_delimiter = ',', value_parser = trimmed, value_name = "VIEW,…")]
    pub(crate) views: Vec<String>,
    #[command(flatten)]
    pub(crate) prompt: PromptArgs,
    /// Write PNG frames to this folder, which must be new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Write a looping animated GIF with the jobs side by side
    #[arg(long, value_name = "FILE", value_parser = file_with_extension("gif"))]
    pub(crate) gif: Option<PathBuf>,
    /// Write a contact sheet (PNG): a row per frame, and the jobs side by side
    #[arg(long, value_name = "FILE", value_parser = file_with_extension("png"))]
    pub(crate) sheet: Option<PathBuf>,
    /// Show the capture's own images in the first panel of the GIF, or of every row of the sheet; every frame must then
    /// show a view of the capture (see --views)
    #[arg(long, conflicts_with = "out")]
    pub(crate) truth: bool,
    /// Enlarge every panel of the GIF or the sheet by this factor
    #[arg(long, conflicts_with = "out", value_name = "N", default_value_t = 1, value_parser = value_parser!(u32).range(1..=16))]
    pub(crate) scale: u32,
    /// Frames per second of the GIF, rounded to hundredths of a second per frame
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = value_parser!(u32).range(1..=50))]
    #[arg(conflicts_with_all = ["out", "sheet"])]
    pub(crate) fps: u32,
}

#[derive(Debug, Args)]
pub(crate) struct EvalArgs {
    /// Folder of the images to evaluate
    #[arg(long, value_name = "DIR")]
    pub(crate) renders: PathBuf,
    /// Folder of the ground-truth images, with the same file names
    #[arg(long, value_name = "DIR")]
    pub(crate) truth: PathBuf,
    /// Folder of LPIPS weights: alexnet-owt-7be5be79.pth, vgg16-397923af.pth and squeezenet1_1-b8a52dc0.pth of
    /// torchvision, alex.pth, vgg.pth and squeeze.pth of LPIPS 0.1. Networks without weights are skipped
    #[arg(long, value_name = "DIR")]
    pub(crate) lpips_weights: Option<PathBuf>,
    /// Composite transparent images on this colour, e.g. the images of D-NeRF as downloaded (default: refuse them)
    #[arg(long, value_name = "COLOUR", value_parser = background())]
    pub(crate) background: Option<Background>,
    /// Print JSON with the values of every image
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum RecipesVerb {
    /// List all recipes; run one as `pipeline run builtin:NAME`
    List,
    /// Print a recipe
    Show {
        /// Name of the recipe, e.g. quickstart
        name: String,
    },
    /// Write a recipe to a file that you can edit
    Copy {
        /// Name of the recipe, e.g. quickstart
        name: String,
        /// File to write, which must not exist (default: NAME.toml)
        file: Option<PathBuf>,
    },
}

#[derive(Debug, Subcommand)]
pub(crate) enum DataVerb {
    /// List the data sets, and how many of their scenes are below the data folder
    List {
        #[command(flatten)]
        data: DataArgs,
    },
    /// Download the missing files of a data set or of one scene, and unpack them below the data folder. Run the same
    /// command again to resume an interrupted download
    Fetch {
        /// Data set, or one of its scenes, e.g. hypernerf or hypernerf/broom2, or a manifest of your own, e.g. own.toml
        name: String,
        #[command(flatten)]
        data: DataArgs,
        /// Accept the licence that `data show` prints
        #[arg(long)]
        accept_licence: bool,
        /// Keep archives after they are unpacked, e.g. for their other scenes
        #[arg(long)]
        keep_archives: bool,
        /// Download up to N files at the same time
        #[arg(long, value_parser = at_least_one, value_name = "N", default_value = "2")]
        jobs: usize,
    },
    /// Compare fetched files with the hashes that the manifest and the record of the fetch state, and the numbers of
    /// images with those of the known scenes; exit with 11 if any differ, or if nothing of NAME exists
    Verify {
        /// Data set, or one of its scenes (default: all that are below the data folder)
        name: Option<String>,
        #[command(flatten)]
        data: DataArgs,
    },
    /// Print the description of a data set
    Show {
        /// Name of the data set, e.g. dnerf
        name: String,
    },
}

#[derive(Debug, Subcommand)]
pub(crate) enum CacheVerb {
    /// Hash every file of the store and list damaged ones
    Verify {
        /// Move damaged files to quarantine, so that the next run recomputes them
        #[arg(long)]
        repair: bool,
    },
    /// Remove results that no recent run needs
    Gc(GcArgs),
    /// Show the disk usage of the store by part
    Du,
}

#[derive(Debug, Args)]
pub(crate) struct GcArgs {
    /// List what would be removed, and remove nothing
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Keep everything that was used within TIME
    #[arg(long, value_parser = humantime::parse_duration, default_value = "30d", value_name = "TIME")]
    pub(crate) max_age: Duration,
    /// Keep everything that the last N runs planned
    #[arg(long, default_value_t = 10, value_name = "N")]
    pub(crate) keep_runs: usize,
}
