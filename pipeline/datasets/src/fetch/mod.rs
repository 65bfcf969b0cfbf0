//! Downloads the archives of a data set and unpacks them into its folders.

mod transfer;
mod unpack;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use engine::{Failure, FailureKind};

use crate::files::{digest, io, move_file, world};
use crate::manifest::{Access, Archive, Manifest};
use crate::records::{self, Record};

use self::unpack::Stopped;
#[cfg(test)]
pub(crate) use self::unpack::unpack as unpack_for_tests;

/// The usual value of [`Request::silence`]. Servers of archives answer within seconds, but busy ones may pause for
/// longer.
pub const SILENCE: Duration = Duration::from_secs(60);

/// What to fetch, and how.
pub struct Request<'a> {
    /// The data set.
    pub manifest: &'a Manifest,
    /// One of its scenes; all if unset.
    pub scene: Option<&'a str>,
    /// The folder that contains the data sets.
    pub data_root: &'a Path,
    /// Whether the user accepts the licence.
    pub accepts_licence: bool,
    /// Whether archives are kept after they are unpacked.
    pub keeps_archives: bool,
    /// Number of downloads at the same time.
    pub parallel: usize,
    /// How long a server may send nothing before its connection is cut and the download is continued; see [`SILENCE`].
    pub silence: Duration,
    /// Called at every step; may be called from several threads.
    pub on_event: &'a (dyn Fn(&Archive, Event) + Sync),
}

/// A step of a fetch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// Downloaded bytes, and the total if the server states it.
    Bytes(u64, Option<u64>),
    /// The connection was cut or the server is busy; the download is retried.
    Retry(String),
    /// The download is complete and is being unpacked.
    Unpacking,
}

/// What a fetch did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fetched {
    /// A download, with its record.
    New(Record),
    /// Everything in this archive exists already.
    Present(String),
}

/// Fetches the missing files; returns the outcome of each archive. An error means that nothing was tried.
pub fn fetch(request: &Request) -> Result<Vec<Result<Fetched, Failure>>, Failure> {
    let archives = wanted(request)?;
    let queue = Mutex::new(archives.into_iter());
    let done = Mutex::new(Vec::new());
    let next = || queue.lock().expect("no thread panics").next();
    std::thread::scope(|scope| {
        for _ in 0..request.parallel.max(1) {
            scope.spawn(|| {
                while let Some(archive) = next() {
                    let fetched = one(request, archive);
                    done.lock().expect("no thread panics").push(fetched);
                }
            });
        }
    });
    Ok(done.into_inner().expect("no thread panics"))
}

/// The archives of the wanted scenes.
fn wanted<'a>(request: &Request<'a>) -> Result<Vec<&'a Archive>, Failure> {
    let manifest = request.manifest;
    let bad = |message: String| Failure::new(FailureKind::BadInput, message);
    if let Some(name) = request.scene.filter(|name| manifest.scene(name).is_none()) {
        let names: Vec<&str> = manifest.scene.iter().map(|scene| scene.name.as_str()).collect();
        return Err(bad(format!("{} has no scene {name}", manifest.name)).hint(format!("it has {}", names.join(", "))));
    }
    let folder = request.data_root.join(&manifest.folder);
    if manifest.access != Access::Open {
        let failure =
            Failure::new(FailureKind::MissingData, format!("{} cannot be fetched by a program", manifest.name));
        let hint = format!("{}; homepage: {}; put its scenes below", manifest.by_hand, manifest.homepage);
        return Err(failure.hint(hint).at(folder));
    }
    if manifest.accept_licence && !request.accepts_licence {
        let message = format!("the licence of {} must be accepted first: {}", manifest.name, manifest.licence);
        return Err(bad(message).hint(format!("read {}, and add --accept-licence", manifest.homepage)));
    }
    let has = |archive: &&Archive| request.scene.is_none_or(|name| archive.scenes.iter().any(|other| other == name));
    let archives: Vec<&Archive> = manifest.archive.iter().filter(has).collect();
    if archives.is_empty() {
        let failure = Failure::new(FailureKind::MissingData, "no address is known for this".to_string());
        return Err(failure.hint(format!("{}; homepage: {}", manifest.by_hand, manifest.homepage)).at(folder));
    }
    Ok(archives)
}

/// The destinations of an archive's parts: the folder of each scene by its name in the archive.
fn places(request: &Request, archive: &Archive) -> BTreeMap<String, PathBuf> {
    let scenes = archive.scenes.iter().filter_map(|name| request.manifest.scene(name));
    let wanted = scenes.filter(|scene| request.scene.is_none_or(|name| scene.name == name));
    let named = wanted.map(|scene| {
        let inside = scene.archived_as.as_ref().unwrap_or(&scene.name);
        (inside.clone(), request.manifest.folder_of(scene, request.data_root))
    });
    named.collect()
}

/// The missing parts of an archive: the folders of its scenes, or its file.
struct Missing {
    places: BTreeMap<String, PathBuf>,
    file: Option<PathBuf>,
}

impl Missing {
    /// Nothing if everything in the archive exists.
    fn of(request: &Request, archive: &Archive) -> Option<Self> {
        let mut places = places(request, archive);
        places.retain(|_, folder| !folder.exists());
        let file = archive.file(request.manifest, request.data_root).filter(|file| !file.exists());
        (!places.is_empty() || file.is_some()).then_some(Self { places, file })
    }
}

/// Holds the lock of an archive below one data root, so that no other fetch downloads or unpacks it.
fn lock(request: &Request, archive: &Archive) -> Result<std::fs::File, Failure> {
    let folder = records::folder(request.data_root);
    fs_err::create_dir_all(&folder).map_err(io)?;
    let path = folder.join(format!("{}.lock", archive.stored_as()));
    let file = engine::lock::open(&path).map_err(|error| io(error).at(&path))?;
    if engine::lock::try_exclusive(&file).map_err(|error| io(error).at(&path))? {
        return Ok(file);
    }
    Err(world("another fetch downloads or unpacks the same archive").hint("wait for it").at(path))
}

/// Where a damaged or refused archive is kept.
fn refused_path(download: &Path) -> PathBuf {
    download.with_added_extension("refused")
}

/// Renames an archive whose content is at fault, so that the next fetch downloads it again.
fn set_apart(download: &Path, stopped: Stopped) -> Failure {
    let failure = match stopped {
        Stopped::Machine(failure) => return failure,
        Stopped::Archive(failure) => failure,
    };
    let refused = refused_path(download);
    if let Err(error) = fs_err::rename(download, &refused) {
        return failure.hint(format!("remove the archive before the next fetch ({error})")).at(download);
    }
    let hint = failure.hint.clone().unwrap_or_default();
    failure.hint(format!("{hint}; the archive was renamed, and the next fetch downloads it again")).at(refused)
}

/// Fetches one archive, unless everything in it exists. The lock is held until the record is written.
fn one(request: &Request, archive: &Archive) -> Result<Fetched, Failure> {
    let present = || Ok(Fetched::Present(archive.url.clone()));
    if Missing::of(request, archive).is_none() {
        return present(); // without writing anything: the folder may be read-only
    }
    let _lock = lock(request, archive)?;
    // Another fetch may have ended between the first check and the lock.
    let Some(Missing { places, file }) = Missing::of(request, archive) else { return present() };
    let folder = records::folder(request.data_root).join(&request.manifest.name);
    fs_err::create_dir_all(&folder).map_err(io)?;
    let report = |event: Event| (request.on_event)(archive, event);
    let named = |failure: Failure| Failure { message: format!("{}: {}", archive.url, failure.message), ..failure };
    let (download, size, sha256) = transfer::download(archive, &folder, request.silence, &report).map_err(named)?;
    report(Event::Unpacking);
    let written = match &file {
        Some(file) => {
            let parent = file.parent().unwrap_or(request.data_root);
            fs_err::create_dir_all(parent).map_err(io)?;
            // Named after the archive, whose lock excludes other writers.
            move_file(&download, file, &parent.join(format!(".fetching-{}", archive.stored_as())))?;
            vec![file.clone()]
        }
        None => {
            let limit = archive.unpacked_bytes.unwrap_or_else(|| unpack::default_limit(size));
            let unpacked = unpack::unpack(&download, &places, archive.scenes.len(), limit);
            let written = unpacked.map_err(|stopped| named(set_apart(&download, stopped)))?;
            let _ = fs_err::remove_file(refused_path(&download)); // usually there is none
            if !request.keeps_archives {
                fs_err::remove_file(&download).map_err(io)?;
            }
            written
        }
    };
    let below = |path: &PathBuf| path.strip_prefix(request.data_root).unwrap_or(path).to_owned();
    let files = written.iter().map(|path| Ok((below(path), digest(path)?))).collect::<Result<_, Failure>>()?;
    let replaced: Vec<PathBuf> = places.values().chain(&file).map(below).collect();
    let record = Record { url: archive.url.clone(), size, sha256, was_known: archive.has_hash(), files };
    records::add(request.data_root, record.clone(), &replaced)?;
    Ok(Fetched::New(record))
}
