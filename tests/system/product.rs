//! The program under test, and a small recipe to run it on.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

/// Two small scenes and two methods. Density control acts and spherical harmonics grow within the few iterations.
/// Opacities are reset to a value from which so short a training recovers.
const TINY: &str = r#"
extends = ["@RECIPES@/common/benchmark.toml"]
name = "tiny"
[axes]
scene = ["bouncing-spheres", "swinging-arm"]
method = ["static3dgs", "deformable4dgs"]
seed = [0]
[nodes.capture]
stage = "scene-synthesis"
over = ["scene"]
params = { scene = "{scene}", width = 32, height = 32, frames = 8, val_views = 2, test_views = 2, samples_per_pixel = 4 }
[nodes.train.params]
initial_points = { random_count = 200 }
harmonics = { interval = 10 }
density = { from = 10, interval = 10, prune_interval = 10, opacity_reset_interval = 25, opacity_reset_to = 0.3, max_count = 400 }
curve = { points = 3, views = 1 }
deformable4dgs = { channels = 4, spatial_resolution = 8, time_resolution = 4 }
[[set]]
when = { method = "static3dgs" }
nodes.train.params.iterations = { train = 40 }
[[set]]
when = { method = "deformable4dgs" }
nodes.train.params.iterations = { coarse = 10, fine = 30 }
"#;

/// Number of jobs of [`TINY`]: 2 captures, 2 coarse phases, 4 trainings, renders and metrics each, and the report.
pub(crate) const TINY_JOBS: usize = 2 + 2 + 3 * 4 + 1;

/// The workspace's root folder.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the workspace").to_owned()
}

/// The program with these arguments, isolated from the environment's variables and from adapters.
pub(crate) fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pipeline-under-test"));
    command.args(arguments).env_remove("PIPELINE_STORE").env_remove("PIPELINE_DATA").stdin(Stdio::null());
    // Equal numbers on every machine, unless a test names a GPU.
    command.env("PIPELINE_DEVICE", "cpu");
    command
}

/// Exit code and output of a finished program.
pub(crate) struct Ended {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Ended {
    /// Runs the program to its end.
    ///
    /// # Panics
    ///
    /// If a signal ended the program, which then has no exit code.
    pub(crate) fn of(mut command: Command) -> Self {
        Self::from(command.output().expect("the program starts"))
    }

    /// Standard output.
    ///
    /// # Panics
    ///
    /// If the program failed.
    pub(crate) fn ok(self) -> String {
        assert_eq!(self.code, 0, "{}\n{}", self.stderr, self.stdout);
        self.stdout
    }
}

impl From<Output> for Ended {
    fn from(output: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("the program prints UTF-8");
        let code = output.status.code().expect("the program was not killed");
        Self { code, stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

/// A temporary folder with a recipe and a store.
pub(crate) struct World {
    dir: TempDir,
}

impl World {
    /// [`TINY`] and an empty store.
    pub(crate) fn tiny() -> Self {
        Self::with_edit("", "")
    }

    /// [`TINY`] with `from` replaced by `to`, and an empty store.
    pub(crate) fn with_edit(from: &str, to: &str) -> Self {
        assert!(TINY.contains(from), "the recipe lacks {from}");
        Self::of(&if from.is_empty() { TINY.to_owned() } else { TINY.replace(from, to) })
    }

    /// A recipe and an empty store. `@RECIPES@` in the text stands for the folder of all recipes.
    pub(crate) fn of(text: &str) -> Self {
        let recipes = root().join("recipes").display().to_string();
        let world = Self { dir: TempDir::new().expect("a folder for the test") };
        std::fs::write(world.recipe(), text.replace("@RECIPES@", &recipes)).expect("the recipe is written");
        world
    }

    /// A path in the folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// The path of the recipe.
    pub(crate) fn recipe(&self) -> PathBuf {
        self.path("tiny.toml")
    }

    /// The text without what differs between machines and versions of the code: the folder's path becomes `WORLD`, the
    /// workspace's `ROOT`, and plan ids `ID`.
    pub(crate) fn timeless(&self, text: &str) -> String {
        let text = text.replace(&self.dir.path().display().to_string(), "WORLD");
        let text = text.replace(&root().display().to_string(), "ROOT");
        let mut parts = text.split("plan id ");
        let first = parts.next().unwrap_or_default().to_owned();
        let is_digit = |c: char| c.is_ascii_hexdigit();
        parts.fold(first, |text, part| text + "plan id ID" + part.trim_start_matches(is_digit))
    }

    /// The command `VERB RECIPE ARGUMENTS…` on this world's store.
    pub(crate) fn command(&self, verb: &str, arguments: &[&str]) -> Command {
        let mut command = program(&[verb]);
        command.arg(self.recipe()).args(arguments).arg("--store").arg(self.path("store"));
        command.current_dir(self.dir.path());
        command
    }

    /// Runs `VERB RECIPE ARGUMENTS…` to its end.
    pub(crate) fn call(&self, verb: &str, arguments: &[&str]) -> Ended {
        Ended::of(self.command(verb, arguments))
    }

    /// Starts a run in the background.
    pub(crate) fn start_run(&self) -> Child {
        self.command("run", &[]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
    }

    /// Runs all jobs.
    ///
    /// # Panics
    ///
    /// If the run fails.
    pub(crate) fn run(&self, arguments: &[&str]) -> RunEvents {
        let mut all = vec!["--json"];
        all.extend(arguments);
        RunEvents::read(&self.call("run", &all).ok())
    }
}

/// The events of a run with `--json`.
pub(crate) struct RunEvents {
    /// Job → digest of its artifact.
    pub(crate) contents: BTreeMap<String, String>,
    /// Counts at the end of the run, e.g. of `executed` jobs.
    pub(crate) counts: BTreeMap<String, u64>,
}

impl RunEvents {
    pub(crate) fn read(lines: &str) -> Self {
        let (mut contents, mut counts) = (BTreeMap::new(), BTreeMap::new());
        for line in lines.lines() {
            let event: Value = serde_json::from_str(line).expect("a line of JSON");
            match event["event"].as_str() {
                Some("finished") => {
                    let content = event["content"].as_str().expect("a finished job has an artifact");
                    contents.insert(event["node"].as_str().expect("a job's name").into(), content.into());
                }
                Some("run-finished") => counts = serde_json::from_value(event["counts"].clone()).expect("counts"),
                _ => (),
            }
        }
        Self { contents, counts }
    }

    /// The artifacts that do not depend on a clock: all but the report, which prints times.
    pub(crate) fn timeless(&self) -> BTreeMap<&str, &str> {
        self.timeless_of(TINY_JOBS)
    }

    /// Like [`RunEvents::timeless`], of a run of this number of jobs.
    pub(crate) fn timeless_of(&self, jobs: usize) -> BTreeMap<&str, &str> {
        let timeless = self.contents.iter().filter(|(node, _)| !node.starts_with("report"));
        let timeless: BTreeMap<&str, &str> = timeless.map(|(node, content)| (&**node, &**content)).collect();
        assert_eq!(timeless.len(), jobs - 1);
        timeless
    }
}
