//! Untrusted ZIP archives: every entry is checked before anything is written, and nothing is written outside the folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Read as _, Write as _};
use std::path::{Component, Path, PathBuf};

use engine::{Failure, FailureKind};
use zip::ZipArchive;

use crate::files::{io, sync_file_system, world};

/// Maximum number of entries of an archive; the largest data set has hundreds of thousands.
const MAX_ENTRIES: usize = 5_000_000;
/// Maximum compression ratio of images in an archive, against decompression bombs.
const RATIO: u64 = 20;
/// Bytes to which an archive of any size may unpack in addition, because text may have a larger ratio.
const SLACK: u64 = 1 << 30;
/// Bytes that are unpacked at once.
const BLOCK: usize = 1 << 16;
/// The file type in the upper bits of a Unix mode, and its value for links.
const TYPE_AND_LINK: [u32; 2] = [0o170_000, 0o120_000];

/// Why an archive was not unpacked.
#[derive(Debug)]
pub(crate) enum Stopped {
    /// Its content is damaged or refused: it must not be used again.
    Archive(Failure),
    /// The machine failed, e.g. its disk is full.
    Machine(Failure),
}

impl From<Failure> for Stopped {
    fn from(failure: Failure) -> Self {
        Self::Machine(failure)
    }
}

/// Maximum number of bytes to which an archive of this size may unpack.
pub(super) fn default_limit(size: u64) -> u64 {
    size.saturating_mul(RATIO).saturating_add(SLACK)
}

/// Unpacks the folders that `places` names to their destinations, and returns the files. Each folder appears by one rename,
/// after the files of all folders have been written next to them. `scenes` is the number of scenes of the whole
/// archive.
pub(crate) fn unpack(
    path: &Path,
    places: &BTreeMap<String, PathBuf>,
    scenes: usize,
    limit: u64,
) -> Result<Vec<PathBuf>, Stopped> {
    // Named after the archive, whose lock excludes other writers.
    let stored = path.file_name().unwrap_or_default().display();
    let fresh_of = |folder: &Path| {
        let name = folder.file_name().unwrap_or_default().display();
        folder.parent().unwrap_or(folder).join(format!(".unpacking-{name}-{stored}"))
    };
    let fresh: Vec<(PathBuf, &PathBuf)> = places.values().map(|folder| (fresh_of(folder), folder)).collect();
    let remove = |folder: &Path| if folder.exists() { fs_err::remove_dir_all(folder).map_err(io) } else { Ok(()) };
    fresh.iter().try_for_each(|(fresh, _)| remove(fresh))?; // of a fetch that was killed
    let unpacked = write_all(path, places, scenes, &fresh_of, limit).and_then(|written| {
        // Folders of one set may lie on several disks.
        fresh.iter().try_for_each(|(fresh, _)| sync_file_system(fresh))?;
        fresh.iter().try_for_each(|(fresh, folder)| fs_err::rename(fresh, folder)).map_err(io)?;
        Ok(written)
    });
    if unpacked.is_err() {
        fresh.iter().for_each(|(fresh, _)| drop(remove(fresh))); // the first error is returned
    }
    unpacked
}

/// Writes the files of all folders below their fresh folders; returns where they will be after the renames.
fn write_all(
    path: &Path,
    places: &BTreeMap<String, PathBuf>,
    scenes: usize,
    fresh_of: &dyn Fn(&Path) -> PathBuf,
    limit: u64,
) -> Result<Vec<PathBuf>, Stopped> {
    let mut archive = open(path)?;
    let entries = checked(&mut archive, limit).map_err(Stopped::Archive)?;
    let mut written = Vec::new();
    let mut left = limit;
    for (name, folder) in places {
        let root = root_of(name, scenes, &entries).map_err(Stopped::Archive)?;
        let inside =
            entries.iter().filter_map(|(index, entry)| Some((*index, entry.strip_prefix(&root).ok()?.to_owned())));
        let inside: Vec<(usize, PathBuf)> = inside.collect();
        let fresh = fresh_of(folder);
        for (index, below) in &inside {
            left -= write(&mut archive, *index, &fresh.join(below), left)?;
        }
        written.extend(inside.into_iter().map(|(_, below)| folder.join(below)));
    }
    Ok(written)
}

fn open(path: &Path) -> Result<ZipArchive<BufReader<File>>, Stopped> {
    let file = File::open(path).map_err(|error| io(error).at(path))?;
    ZipArchive::new(BufReader::new(file)).map_err(|error| {
        let hint = "it may be damaged or in several parts: fetch again, or unpack it by hand";
        Stopped::Archive(world(format!("not a readable ZIP archive ({error})")).hint(hint))
    })
}

/// A failure to read an entry.
fn damaged(error: impl std::fmt::Display) -> Failure {
    world(format!("the archive is damaged ({error})")).hint("it was damaged on its way or at its source: fetch again")
}

/// The files of an archive by index. The whole archive is refused if it has a path outside its folder, a link, two names
/// of one file, or more bytes than `limit`. Of entries with the same name, `ZipArchive` lists the last.
fn checked(archive: &mut ZipArchive<BufReader<File>>, limit: u64) -> Result<Vec<(usize, PathBuf)>, Failure> {
    let refused = |what: String| {
        let failure = Failure::new(FailureKind::BadInput, format!("the archive {what}"));
        failure.hint("nothing was unpacked: do not use it, and write to the authors of the data set")
    };
    if archive.len() > MAX_ENTRIES {
        return Err(refused(format!("has {} entries", archive.len())));
    }
    let (mut files, mut seen, mut bytes) = (Vec::new(), BTreeSet::new(), 0_u64);
    for index in 0..archive.len() {
        let entry = archive.by_index_raw(index).map_err(damaged)?;
        let name = entry.name().map_err(damaged)?.into_owned();
        let [kind, link] = TYPE_AND_LINK;
        if entry.unix_mode().is_some_and(|mode| mode & kind == link) {
            return Err(refused(format!("contains a link, {name:?}")));
        }
        let path = inside(&name).ok_or_else(|| refused(format!("has a path outside of its folder, {name:?}")))?;
        bytes = bytes.saturating_add(entry.size());
        if bytes > limit {
            return Err(refused(format!("unpacks to more than {limit} bytes")));
        }
        if entry.is_dir() {
            continue;
        }
        if !seen.insert(path.clone()) {
            return Err(refused(format!("has {name:?} twice")));
        }
        files.push((index, path));
    }
    Ok(files)
}

/// A relative path of plain names.
fn inside(name: &str) -> Option<PathBuf> {
    let is_odd = name.contains(['\\', '\0']) || name.is_empty() || name.as_bytes().get(1) == Some(&b':');
    let path = Path::new(name);
    let plain = path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    (!is_odd && plain).then(|| path.components().filter(|part| matches!(part, Component::Normal(_))).collect())
}

/// The highest folder of this name in an archive; the only folder at its top, if it is unpacked for a single scene.
fn root_of(name: &str, scenes: usize, entries: &[(usize, PathBuf)]) -> Result<PathBuf, Failure> {
    let folder = |(_, path): &(usize, PathBuf)| {
        let found = path.ancestors().skip(1).filter(|above| above.file_name().is_some_and(|last| last == name));
        found.last().map(Path::to_owned)
    };
    let found: BTreeSet<(usize, PathBuf)> =
        entries.iter().filter_map(folder).map(|path| (path.components().count(), path)).collect();
    let missing = || {
        let failure = Failure::new(FailureKind::BadInput, format!("the archive has no folder {name}"));
        failure.hint("the archive was replaced at its source: unpack it by hand")
    };
    let tops: BTreeSet<_> = entries.iter().filter_map(|(_, path)| path.components().next()).collect();
    let only = tops.into_iter().map(|top| Path::new(&top).to_owned());
    let only: Vec<PathBuf> =
        only.filter(|top| entries.iter().all(|(_, path)| path.starts_with(top) && path != top)).collect();
    let named = found.into_iter().next().map(|(_, path)| path);
    named.or(only.into_iter().next().filter(|_| scenes == 1)).ok_or_else(missing)
}

/// Writes one file of at most `left` bytes, whatever size its entry states; returns its size.
fn write(archive: &mut ZipArchive<BufReader<File>>, index: usize, to: &Path, left: u64) -> Result<u64, Stopped> {
    let bad = |error: &dyn std::fmt::Display| Stopped::Archive(damaged(error));
    let mut entry = archive.by_index(index).map_err(|error| bad(&error))?;
    let most = entry.size().min(left);
    fs_err::create_dir_all(to.parent().unwrap_or(to)).map_err(io)?;
    let mut file = fs_err::File::create_new(to).map_err(io)?;
    let (mut block, mut size) = (vec![0; BLOCK], 0);
    loop {
        let count = entry.read(&mut block).map_err(|error| bad(&error))?;
        if count == 0 {
            return Ok(size);
        }
        size += count as u64;
        if size > most {
            let failure = Failure::new(FailureKind::BadInput, "the archive unpacks to more bytes than it states");
            return Err(Stopped::Archive(failure.hint("do not use it, and write to the authors of the data set")));
        }
        file.write_all(&block[..count]).map_err(io)?;
    }
}
