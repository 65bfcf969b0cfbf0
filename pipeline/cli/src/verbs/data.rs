//! `data`: the data sets whose manifests are built into the program, and those of a user's own manifest.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use datasets::{Access, Archive, Event, Fetched, Finding, Manifest, Request, Scene};
use engine::{Failure, FailureKind, exit};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use super::library;
use crate::args::DataVerb;
use crate::error::CliError;
use crate::output::{bytes, count, note, print, print_line};
use crate::stages::manifests;

pub(crate) fn data(verb: &DataVerb) -> Result<u8, CliError> {
    match verb {
        DataVerb::List { data } => list(&data.root),
        DataVerb::Show { name } => {
            print(library::text(manifests(), name, "data set")?)?;
            Ok(exit::OK)
        }
        DataVerb::Fetch { name, data, accept_licence, keep_archives, jobs } => {
            let (manifest, scene) = find(name)?;
            let bars = Bars::default();
            let request = Request {
                manifest: &manifest,
                scene: scene.as_deref(),
                data_root: &data.root,
                accepts_licence: *accept_licence,
                keeps_archives: *keep_archives,
                parallel: *jobs,
                silence: datasets::SILENCE,
                on_event: &|archive, event| bars.show(archive, &event),
            };
            report(datasets::fetch(&request).map_err(anyhow::Error::from)?)
        }
        DataVerb::Verify { name, data } => verify(name.as_deref(), &data.root),
    }
}

/// The manifests that are built in.
fn built_in() -> Result<Vec<Manifest>, CliError> {
    let parse = |(name, text): &(&str, &str)| Manifest::parse(text, Path::new(name)).map_err(anyhow::Error::from);
    Ok(manifests().iter().map(parse).collect::<Result<_, _>>()?)
}

/// The data set and the scene of `SET`, `SET/SCENE`, `FILE.toml` or `FILE.toml/SCENE`.
fn find(name: &str) -> Result<(Manifest, Option<String>), CliError> {
    const FILE: &str = ".toml";
    if let Some(end) = name.find(FILE).map(|at| at + FILE.len()) {
        let (file, rest) = name.split_at(end);
        let read = std::fs::read_to_string(file);
        let unread =
            |error| Failure::new(FailureKind::BadInput, format!("cannot read the manifest ({error})")).at(file);
        let text = read.map_err(|error| anyhow::Error::from(unread(error)))?;
        let manifest = Manifest::parse(&text, Path::new(file)).map_err(anyhow::Error::from)?;
        return Ok((manifest, rest.strip_prefix('/').map(str::to_owned)));
    }
    let (set, scene) = name.split_once('/').map_or((name, None), |(set, scene)| (set, Some(scene.to_owned())));
    let text = library::text(manifests(), set, "data set")?;
    Ok((Manifest::parse(text, Path::new(set)).map_err(anyhow::Error::from)?, scene))
}

fn list(data_root: &Path) -> Result<u8, CliError> {
    let sets = present(data_root)?;
    let width = name_width(&sets);
    let lines: String = sets.iter().map(|set| set.text(data_root, width) + &set.source_text(width)).collect();
    let archives = || sets.iter().flat_map(|set| &set.manifest.archive);
    let known = archives().filter(|archive| archive.sha256.is_some()).count();
    let tried = archives().filter(|archive| archive.tried.is_some()).count();
    print(&format!(
        "{lines}\n{} to download: the SHA-256 of {known} is known, {tried} were tried; fetched files are recorded with their hashes\n",
        count(archives().count(), "file")
    ))?;
    Ok(exit::OK)
}

/// A data set, with the number of its existing scenes (or files, if it has no scenes).
pub(crate) struct DataSet {
    manifest: Manifest,
    pub(crate) exist: usize,
}

impl DataSet {
    /// One line: the data set in a column of `width`, how many of its scenes exist, and where.
    pub(crate) fn text(&self, data_root: &Path, width: usize) -> String {
        let Manifest { name, title, folder, scene, archive, .. } = &self.manifest;
        let all = if scene.is_empty() { count(archive.len(), "file") } else { count(scene.len(), "scene") };
        let place: PathBuf = data_root.join(folder).components().collect(); // without a final `.`
        format!("{name:<width$} {} of {all} in {}: {title}\n", self.exist, place.display())
    }

    /// One line: how to get it.
    fn source_text(&self, width: usize) -> String {
        let Manifest { access, accept_licence, archive, licence, by_hand, .. } = &self.manifest;
        let licence = if *accept_licence { format!("; licence to be accepted: {licence}") } else { String::new() };
        let how = match access {
            Access::Open => format!("{} to fetch", count(archive.len(), "file")),
            Access::Browser => "by hand".into(),
            Access::Request => "on request".into(),
            Access::Unpublished => "not published".into(),
        };
        let hand = if by_hand.is_empty() { String::new() } else { format!("; {}", by_hand.trim()) };
        format!("{:<width$} {how}{licence}{hand}\n", "")
    }
}

/// The width of the column of names.
pub(crate) fn name_width(sets: &[DataSet]) -> usize {
    sets.iter().map(|set| set.manifest.name.len()).max().unwrap_or(0)
}

/// All data sets, in the order of their names.
pub(crate) fn present(data_root: &Path) -> Result<Vec<DataSet>, CliError> {
    let data_set = |manifest: Manifest| {
        let scenes = manifest.scene.iter().filter(|scene| manifest.folder_of(scene, data_root).is_dir()).count();
        let files = manifest.archive.iter().filter_map(|archive| archive.file(&manifest, data_root));
        let files = files.filter(|file| file.is_file()).count();
        DataSet { manifest, exist: scenes + files }
    };
    Ok(built_in()?.into_iter().map(data_set).collect())
}

/// Hashes and counts what exists; the exit code says whether anything differs, or nothing of what is named exists.
fn verify(name: Option<&str>, data_root: &Path) -> Result<u8, CliError> {
    let wanted = match name {
        Some(name) => vec![find(name)?],
        None => built_in()?.into_iter().map(|manifest| (manifest, None)).collect(),
    };
    let (mut is_equal, mut exists) = (true, name.is_none());
    for (manifest, only) in &wanted {
        let missing = only.as_deref().filter(|only| manifest.scene(only).is_none());
        if let Some(unknown) = missing {
            let names: Vec<&str> = manifest.scene.iter().map(|scene| scene.name.as_str()).collect();
            let hint = format!("it has {}", names.join(", "));
            return Err(CliError::nothing(format!("{} has no scene {unknown}", manifest.name), hint));
        }
        let scenes = manifest.scene.iter().filter(|scene| only.as_ref().is_none_or(|only| *only == scene.name));
        let scenes = scenes.map(|scene| {
            let finding = datasets::verify(manifest, scene, data_root)?;
            Ok((format!("{}/{}", manifest.name, scene.name), finding))
        });
        let archives = manifest.archive.iter().filter(|_| only.is_none());
        let files = archives.filter_map(|archive| {
            let to = archive.to.as_ref()?.display();
            let finding = datasets::verify_file(manifest, archive, data_root).transpose()?;
            Some(finding.map(|finding| (format!("{}/{to}", manifest.name), finding)))
        });
        for found in scenes.chain(files) {
            let (label, finding) = found.map_err(|failure: Failure| anyhow::Error::from(failure))?;
            exists |= finding != Finding::Absent;
            match finding {
                Finding::Absent if name.is_none() => (),
                Finding::Absent => print_line(&format!("{label}: missing"))?,
                Finding::Fine(text) => print_line(&format!("{label}: {text}"))?,
                Finding::Wrong(wrong) => {
                    is_equal = false;
                    wrong.iter().try_for_each(|wrong| print_line(&format!("{label}: WRONG: {wrong}")))?;
                }
            }
        }
    }
    Ok(if is_equal && exists { exit::OK } else { exit::DIFFERS })
}

/// Prints what was fetched, then returns the first failure; the others are noted.
fn report(outcomes: Vec<Result<Fetched, Failure>>) -> Result<u8, CliError> {
    let mut failures = Vec::new();
    for outcome in outcomes {
        match outcome {
            Ok(fetched) => print_line(&summary_of(&fetched))?,
            Err(failure) => failures.push(failure),
        }
    }
    let mut failures = failures.into_iter();
    let first = failures.next();
    failures.for_each(|failure| note(&failure.to_string()));
    first.map_or(Ok(exit::OK), |failure| Err(anyhow::Error::from(failure).into()))
}

/// What a fetch did, in words.
fn summary_of(fetched: &Fetched) -> String {
    match fetched {
        Fetched::Present(url) => format!("{url}: all of its files exist already"),
        Fetched::New(record) => {
            let files = count(record.files.len(), "file");
            let known = if record.was_known {
                "as the manifest states"
            } else {
                "recorded: the manifest states no complete hash for comparison"
            };
            format!("{}: {}, {files}, SHA-256 {} ({known})", record.url, bytes(record.size), record.sha256)
        }
    }
}

/// Progress on standard error: bars on a terminal, otherwise only unusual events.
#[derive(Default)]
struct Bars {
    all: MultiProgress,
    by_url: Mutex<BTreeMap<String, ProgressBar>>,
}

impl Bars {
    fn show(&self, archive: &Archive, event: &Event) {
        let mut bars = self.by_url.lock().expect("no thread panics");
        let bar = bars.entry(archive.url.clone()).or_insert_with(|| {
            let style = ProgressStyle::with_template("{bar:30} {bytes}/{total_bytes} {bytes_per_sec} {eta} {msg}");
            let bar = ProgressBar::new(archive.size.unwrap_or(0)).with_message(archive.url.clone());
            self.all.add(bar.with_style(style.expect("the template is valid")))
        });
        match event {
            Event::Bytes(here, total) => {
                total.iter().for_each(|total| bar.set_length(*total));
                bar.set_position(*here);
            }
            Event::Retry(why) => self.all.suspend(|| note(&format!("{}: {why}; trying again", archive.url))),
            Event::Unpacking => bar.finish(),
        }
    }
}

/// How to get the data at these absolute paths: one command or instruction per data set.
pub(crate) fn how_to_get<'a>(
    missing: impl Iterator<Item = &'a Path>,
    data_root: &Path,
) -> Result<Vec<String>, CliError> {
    let manifests = built_in()?;
    let absolute = std::path::absolute(data_root).map_err(anyhow::Error::from)?;
    let mut found: BTreeMap<&str, (&Manifest, Vec<&Scene>)> = BTreeMap::new();
    for path in missing {
        for manifest in &manifests {
            let Some(scene) = manifest.scene_at(path, &absolute) else { continue };
            let scenes = &mut found.entry(&manifest.name).or_insert((manifest, Vec::new())).1;
            if !scenes.iter().any(|other| other.name == scene.name) {
                scenes.push(scene);
            }
        }
    }
    let advice = |(name, (manifest, scenes)): (&str, (&Manifest, Vec<&Scene>))| {
        let what = match scenes[..] {
            [scene] => format!("{name}/{}", scene.name),
            _ => name.to_owned(),
        };
        let licence = if manifest.accept_licence { " --accept-licence" } else { "" };
        match manifest.access {
            Access::Open => {
                format!("fetch it with `pipeline data fetch {what} --data-root {}{licence}`", data_root.display())
            }
            _ => format!("`pipeline data show {name}` explains how to get {what}"),
        }
    };
    Ok(found.into_iter().map(advice).collect())
}

/// The manifests' facts about the capture in a folder: its counts, compared with the files, and its flaw. The place of the
/// folder below a data root decides among data sets with scenes of one name.
pub(crate) fn known(dir: &Path, format: &str) -> Result<Vec<String>, CliError> {
    let manifests = built_in()?;
    let scenes = || manifests.iter().flat_map(|manifest| manifest.scene.iter().map(move |scene| (manifest, scene)));
    let stated = |manifest: &Manifest, scene: &Scene| scene.format.as_ref().unwrap_or(&manifest.format).clone();
    let in_place: Vec<_> =
        scenes().filter(|(manifest, scene)| dir.ends_with(manifest.folder_of(scene, Path::new("")))).collect();
    let by_name = scenes().filter(|(manifest, scene)| {
        let folder = scene.folder.as_deref().unwrap_or(Path::new(&scene.name));
        dir.ends_with(folder) && stated(manifest, scene).eq_ignore_ascii_case(format)
    });
    let found = if in_place.is_empty() { by_name.collect() } else { in_place };
    let mut lines = Vec::new();
    for (manifest, scene) in found {
        let (label, stated) = (format!("  known as    {}/{}", manifest.name, scene.name), stated(manifest, scene));
        if !stated.eq_ignore_ascii_case(format) {
            let [read, stated] = [format, &stated].map(str::to_lowercase);
            let advice = format!("`pipeline data show {}` lists its files", manifest.name);
            lines.push(format!("{label}: read as {read}, although this data set has the format {stated}: {advice}"));
            continue;
        }
        match datasets::compare(manifest, scene, dir) {
            Finding::Fine(text) => lines.push(format!("{label}: {text}")),
            Finding::Wrong(wrong) => lines.push(format!("{label}: WRONG: {}", wrong.join(", "))),
            Finding::Absent => (),
        }
        lines.extend(scene.flaw.as_ref().map(|flaw| format!("  flaw        {}", flaw.trim().replace('\n', " "))));
    }
    Ok(lines)
}
