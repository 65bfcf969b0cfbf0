//! Estimators of depth, flow, masks, … as commands in a TOML file.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use serde::Deserialize;

use crate::error::{Result, bad, io};
use crate::frames::IMAGES;
use crate::masks_folder::MASKS;
use crate::request::COLMAP_STEPS;
use crate::steps::{Step, Steps};

/// Maximum number of files in an output folder that are counted for progress.
const COUNTED: usize = 100_000;

/// The file: `[[estimator]]` tables.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Estimators {
    estimator: Vec<Estimator>,
}

/// One command.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Estimator {
    /// Name of the step.
    pub(crate) name: String,
    /// What it estimates.
    pub(crate) kind: Kind,
    /// A command for the shell, with `{frames}` and `{out}` in the place of folders.
    command: String,
    /// The version of the tool and its weights; the step runs again if it changes.
    #[serde(default)]
    version: String,
    /// Parameters of the importer that describe the files, e.g. `kind = "inverse-depth"`.
    #[serde(default)]
    import: toml::Table,
}

/// What an estimator writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Kind {
    /// Depth of every frame.
    Depth,
    /// Optical flow to the next frame.
    Flow,
    /// Optical flow to the frame before.
    FlowBackward,
    /// Surface normals.
    Normals,
    /// Tracks of points.
    Tracks,
    /// Masks of what moves.
    Masks,
    /// Visual tokens and text embeddings.
    Features,
}

impl Kind {
    /// The folder of its files in the capture, as the importers expect it.
    fn folder(self) -> &'static str {
        match self {
            Self::Depth => "maps/depth",
            Self::Flow => "maps/flow_fwd",
            Self::FlowBackward => "maps/flow_bwd",
            Self::Normals => "maps/normal",
            Self::Tracks => "maps/tracks",
            Self::Masks => MASKS,
            Self::Features => "features",
        }
    }

    /// The table of import parameters that describes its files.
    fn import(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Flow | Self::FlowBackward | Self::Tracks => "flow",
            Self::Normals => "normals",
            Self::Masks => "masks",
            Self::Features => "features",
        }
    }

    /// Whether its files are maps of the frames, which need the same lens as the imported images.
    pub(crate) fn is_map(self) -> bool {
        !matches!(self, Self::Masks | Self::Features)
    }
}

/// Refuses estimators of masks, whose results a given folder of masks would replace.
pub(crate) fn refuse_masks(estimators: &[Estimator]) -> Result<()> {
    match estimators.iter().find(|estimator| estimator.kind == Kind::Masks) {
        Some(Estimator { name, .. }) => {
            let message = format!("--masks would replace the masks of estimator {name:?}");
            Err(bad(message).hint("omit --masks, or remove this estimator from the file"))
        }
        None => Ok(()),
    }
}

/// Reads the file of estimators.
pub(crate) fn read(path: &Path) -> Result<Vec<Estimator>> {
    let text = std::fs::read_to_string(path).map_err(|error| io(&error, path))?;
    let read: Estimators = toml::from_str(&text).map_err(|error| {
        let hint =
            "[[estimator]] has name, kind, command and optionally version and import; see `pipeline prepare --help`";
        bad(error.to_string().trim().to_owned()).hint(hint).at(path)
    })?;
    for (index, estimator) in read.estimator.iter().enumerate() {
        estimator.check(&read.estimator[..index]).map_err(|failure| failure.at(path))?;
    }
    Ok(read.estimator)
}

impl Estimator {
    fn check(&self, before: &[Self]) -> Result<()> {
        let Self { name, kind, command, .. } = self;
        let is_plain = |symbol: char| symbol.is_ascii_alphanumeric() || "-_".contains(symbol);
        if name.is_empty() || !name.chars().all(is_plain) {
            return Err(bad(format!("estimator {name:?}: a name has letters, digits, - and _")));
        }
        let is_taken = ["frames", "masks"].iter().chain(&COLMAP_STEPS).any(|step| step == name);
        if is_taken || before.iter().any(|other| other.name == *name) {
            return Err(
                bad(format!("estimator {name:?}: another step has this name")).hint("e.g. sam2 or depth-anything")
            );
        }
        if before.iter().any(|other| other.kind == *kind) {
            return Err(
                bad(format!("estimator {name:?}: another one writes {}", kind.folder())).hint("keep one per kind")
            );
        }
        match ["{frames}", "{out}"].iter().find(|place| !command.contains(**place)) {
            Some(place) => Err(bad(format!("estimator {name:?}: its command lacks {place}"))
                .hint("e.g. command = \"python run.py --img-path {frames} --outdir {out}\"")),
            None => Ok(()),
        }
    }
}

/// Parameters of the importers by table.
pub(crate) fn imports(estimators: &[Estimator]) -> BTreeMap<String, toml::Table> {
    let mut all: BTreeMap<String, toml::Table> = BTreeMap::new();
    for estimator in estimators {
        all.entry(estimator.kind.import().into()).or_default().extend(estimator.import.clone());
    }
    all
}

/// Runs an estimator on the frames.
pub(crate) fn run(steps: &mut Steps<'_>, estimator: &Estimator) -> Result<()> {
    let (name, folder) = (&estimator.name, estimator.kind.folder());
    let step = Step {
        name,
        commands: vec![estimator.command.clone()],
        tool: Ok(estimator.version.clone()),
        inputs: vec![("images", IMAGES.into())],
        outputs: vec![folder],
    };
    steps.run(step, |steps| {
        let scratch = steps.scratch(name)?;
        let frames = quoted(&steps.dir.join(IMAGES));
        let line = estimator.command.replace("{frames}", &frames).replace("{out}", &quoted(&scratch));
        let mut command = Command::new("sh");
        command.arg("-c").arg(line);
        let total = count(&steps.dir.join(IMAGES));
        steps.execute(name, command, &|_| Some((count(&scratch), total))).map_err(|mut failure| {
            failure.message = failure.message.replacen("sh failed", &format!("estimator {name} failed"), 1);
            failure
        })?;
        let written = count(&scratch);
        if written == 0 {
            let hint = "its command must write files into {out}";
            return Err(bad(format!("estimator {name} wrote nothing")).hint(hint));
        }
        steps.publish(&scratch, folder)?;
        Ok((Vec::new(), format!("{written} files in {folder}")))
    })
}

/// The number of files in a folder and below it.
fn count(dir: &Path) -> u64 {
    let files = walkdir::WalkDir::new(dir).follow_links(true).into_iter().flatten();
    files.filter(|entry| entry.file_type().is_file()).take(COUNTED).count() as u64
}

/// A path as one word of the shell.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', "'\\''"))
}
