//! Small stages for the engine's own tests: write a text, append to a text, join two texts, and list texts.
//! Refers to the crate as `engine`, so that the integration test can include this file as well.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use engine::{
    Artifact, Decision, Facts, Failure, FailureKind, JobContext, ParamProblem, PlanContext, Port, Resolution, Source,
    Stage,
};
use serde::{Deserialize, Serialize};

/// An artifact: a folder with the file `text.txt`.
pub(crate) struct Text(pub(crate) String);

impl Text {
    /// Writes the text into the folder `dir`.
    pub(crate) fn write(dir: &Path, text: &str) -> anyhow::Result<Self> {
        std::fs::write(dir.join("text.txt"), text)?;
        Ok(Self(text.to_owned()))
    }
}

impl Artifact for Text {
    const NAME: &'static str = "text";
    const SCHEMA: u32 = 1;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        Ok(Self(std::fs::read_to_string(dir.join("text.txt"))?))
    }

    fn check(&self) -> anyhow::Result<()> {
        anyhow::ensure!(!self.0.contains("invalid"), "the text contains `invalid`");
        Ok(())
    }
}

/// Test stage: writes a text from a parameter and a source file.
pub(crate) struct Write;

/// Parameters of [`Write`].
#[derive(Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct WriteParams {
    /// The text.
    pub(crate) text: String,
    /// A file that is appended to the text; relative to the data root. One in the folder `optional` may be missing.
    pub(crate) source: Option<PathBuf>,
}

impl Stage for Write {
    type Params = WriteParams;
    type Output = Text;
    const ID: &'static str = "test-write";
    const ABOUT: &'static str = "writes a text";

    fn ports() -> Vec<Port> {
        Vec::new()
    }

    fn sources(params: &WriteParams) -> Vec<Source> {
        let source =
            |path: &PathBuf| Source { name: "text", path: path.clone(), optional: path.starts_with("optional") };
        params.source.iter().map(source).collect()
    }

    /// `empty`, unless there is a source file that is missing.
    fn facts(params: &WriteParams, context: &PlanContext<'_>) -> Facts {
        let source_bytes = match &params.source {
            Some(path) => std::fs::metadata(context.data_root.join(path)).ok().map(|found| found.len()),
            None => Some(0),
        };
        match source_bytes {
            Some(bytes) => Facts::default().with("empty", params.text.is_empty() && bytes == 0),
            None => Facts::default(),
        }
    }

    fn run(context: &JobContext, params: &WriteParams) -> anyhow::Result<Text> {
        // An optional source may be missing.
        let source = match context.source("text") {
            Ok(path) => std::fs::read_to_string(path)?,
            Err(_) => String::new(),
        };
        Text::write(context.output_dir(), &format!("{}{source}", params.text))
    }
}

/// Test stage: appends a letter to a text in each step, with a checkpoint per step. Fails on request.
pub(crate) struct Work;

/// Parameters of [`Work`].
#[derive(Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct WorkParams {
    /// The text that each step appends; the letters `a` to `c` are the values of an axis of all.
    pub(crate) letter: String,
    /// The number of steps.
    pub(crate) steps: usize,
    /// The time that each step takes.
    pub(crate) sleep_millis: u64,
    /// A number without effect.
    pub(crate) rate: f64,
    /// Truncates the result to this number of letters, so that different parameters can have equal results.
    pub(crate) keep: usize,
    /// The way to fail: `error`, `missing`, `diverged`, `full`, `panic`, `abort`, `hang`; empty for success.
    pub(crate) fail: String,
}

impl Default for WorkParams {
    fn default() -> Self {
        Self { letter: "x".into(), steps: 1, sleep_millis: 0, rate: 0.001, keep: usize::MAX >> 12, fail: "".into() }
    }
}

impl Stage for Work {
    type Params = WorkParams;
    type Output = Text;
    const ID: &'static str = "test-work";
    const ABOUT: &'static str = "appends letters to a text";
    const ON_DEVICE: bool = true;

    fn ports() -> Vec<Port> {
        vec![Port::one::<Text>("text")]
    }

    fn check_params(params: &WorkParams) -> Vec<ParamProblem> {
        let problem = ParamProblem { key: "steps".into(), message: "must be at least 1".into(), hint: None };
        if params.steps == 0 { vec![problem] } else { Vec::new() }
    }

    fn values(key: &str) -> Option<Vec<String>> {
        (key == "letter").then(|| ["a", "b", "c"].map(str::to_owned).into())
    }

    fn run(context: &JobContext, params: &WorkParams) -> anyhow::Result<Text> {
        fail(&params.fail)?;
        let checkpoint = context.checkpoint_dir().join("steps");
        let start = context.input::<Text>("text")?.0;
        let mut text = std::fs::read_to_string(&checkpoint).unwrap_or(start.clone());
        context.measure("resumed_steps", text.len() - start.len())?;
        context.measure("device", &context.device)?;
        for step in text.len() - start.len()..params.steps {
            std::thread::sleep(Duration::from_millis(params.sleep_millis));
            text += &params.letter;
            std::fs::write(checkpoint.with_extension("new"), &text)?;
            std::fs::rename(checkpoint.with_extension("new"), &checkpoint)?;
            context.progress(step as u64 + 1, params.steps as u64, format!("{} letters", text.len()));
            if context.should_stop() && step + 1 < params.steps {
                return Err(context.interrupted());
            }
        }
        let kept: String = text.chars().take(params.keep).collect();
        Text::write(context.output_dir(), &kept)
    }
}

fn fail(how: &str) -> anyhow::Result<()> {
    match how {
        "error" => anyhow::bail!("failed on request"),
        "missing" => Err(Failure::new(FailureKind::MissingData, "data is missing on request").into()),
        "diverged" => Err(Failure::new(FailureKind::Diverged, "weights at iteration 7").into()),
        "panic" => panic!("panicked on request"),
        "full" => std::fs::write("/dev/full", "x").context("cannot write the text"),
        "abort" => std::process::abort(),
        "hang" => loop {
            std::thread::sleep(Duration::from_secs(1));
        },
        _ => Ok(()),
    }
}

/// Test stage: concatenates a required text, an optional one (unless it is known to be empty) and one of several
/// endings.
pub(crate) struct Join;

/// Parameters of [`Join`].
#[derive(Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct JoinParams {
    /// Whether to read the optional text; by default unless it is known to be empty.
    pub(crate) suffix: Option<bool>,
    /// Whether the job repeats another one.
    pub(crate) repeats: bool,
}

impl Stage for Join {
    type Params = JoinParams;
    type Output = Text;
    const ID: &'static str = "test-join";
    const ABOUT: &'static str = "joins two texts";

    fn ports() -> Vec<Port> {
        let text = Port::one::<Text>("text").relaying_measurements();
        vec![text, Port::optional::<Text>("suffix"), Port::choice::<Text>("ending")]
    }

    fn resolve(params: JoinParams, context: &PlanContext<'_>) -> Result<Resolution<JoinParams>, Vec<ParamProblem>> {
        let (on, reason) = match (params.suffix, context.facts("suffix").map(|facts| facts.flag("empty"))) {
            (Some(true), None) => {
                let hint = Some("wire `suffix` to a node, or remove the key".into());
                return Err(vec![ParamProblem {
                    key: "suffix".into(),
                    message: "nothing is wired to it".into(),
                    hint,
                }]);
            }
            (Some(on), _) => (on, "named"),
            (None, None) => (false, "not wired"),
            (None, Some(Some(true))) => (false, "empty"),
            (None, Some(Some(false))) => (true, "not empty"),
            (None, Some(None)) => (true, "unknown before it is read"),
        };
        let mut resolution = Resolution::unchanged(JoinParams { suffix: Some(on), ..params });
        resolution.repeats = resolution.params.repeats.then(|| "asked to".into());
        resolution.unread.extend((!on).then_some("suffix"));
        resolution.decisions.push(Decision { effect: "suffix".into(), on, reason: reason.into() });
        // The first ending that is known not to be empty.
        let endings = context.inputs.get("ending").into_iter().flatten();
        let ending = endings.map(|facts| facts.flag("empty")).position(|empty| empty == Some(false));
        resolution.chosen.extend(ending.map(|ending| ("ending", ending)));
        Ok(resolution)
    }

    fn run(context: &JobContext, _params: &JoinParams) -> anyhow::Result<Text> {
        context.measure("of_text", &context.input_record("text")?.measurements)?;
        let mut text = context.input::<Text>("text")?.0;
        for port in ["suffix", "ending"] {
            text += &context.optional_input::<Text>(port)?.map(|text| text.0).unwrap_or_default();
        }
        Text::write(context.output_dir(), &text)
    }
}

/// Test stage: lists any number of texts with their coordinates, and the kinds of failures.
pub(crate) struct List;

/// Parameters of [`List`].
#[derive(Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ListParams {
    /// The first line.
    pub(crate) title: String,
}

impl Stage for List {
    type Params = ListParams;
    type Output = Text;
    const ID: &'static str = "test-list";
    const ABOUT: &'static str = "lists texts";

    fn ports() -> Vec<Port> {
        vec![Port::many::<Text>("texts")]
    }

    fn run(context: &JobContext, params: &ListParams) -> anyhow::Result<Text> {
        let mut lines = params.title.clone();
        for input in context.inputs::<Text>("texts")? {
            let value = input.artifact.map_or_else(|failure| format!("{:?}", failure.kind), |text| text.0);
            lines += &format!("\n{:?} {value}", input.record.coordinates);
        }
        Text::write(context.output_dir(), &lines)
    }
}
