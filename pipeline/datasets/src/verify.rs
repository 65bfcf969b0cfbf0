//! Comparison of the files with their records, and of their numbers with the manifest.

use std::collections::BTreeMap;
use std::path::Path;

use engine::Failure;
use walkdir::WalkDir;

use crate::files::digest;
use crate::layout::Pattern;
use crate::manifest::{Archive, Manifest, Scene};
use crate::records;

/// The state of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// As stated, in words.
    Fine(String),
    /// The folder does not exist.
    Absent,
    /// Damaged or incomplete, in words.
    Wrong(Vec<String>),
}

/// Compares the folder of a scene with the numbers of the manifest, without reading any image.
pub fn compare(manifest: &Manifest, scene: &Scene, folder: &Path) -> Finding {
    if !folder.is_dir() {
        return Finding::Absent;
    }
    let (mut right, mut wrong) = (Vec::new(), Vec::new());
    for (split, stated) in [("train", scene.train), ("val", scene.val), ("test", scene.test)] {
        let Some(stated) = stated else { continue };
        let Some(found) = images_of(manifest, split, folder) else { continue };
        let text = format!("{found} {split} images");
        if found == stated { right.push(text) } else { wrong.push(format!("{text} instead of {stated}")) }
    }
    compare_files(manifest, scene, folder, &mut right, &mut wrong);
    match (wrong.is_empty(), right.is_empty()) {
        (false, _) => Finding::Wrong(wrong),
        (true, false) => Finding::Fine(right.join(", ")),
        (true, true) => Finding::Fine("its folder exists; the manifest states no numbers that can be compared".into()),
    }
}

/// Compares the stated images, cameras, and frames per camera with the files that the layout's `images` matches, or
/// `videos` or `test` in their place. Frames of videos are not counted. Recordings may be longer than stated, not shorter.
fn compare_files(manifest: &Manifest, scene: &Scene, folder: &Path, right: &mut Vec<String>, wrong: &mut Vec<String>) {
    if (scene.images, scene.cameras, scene.frames) == (None, None, None) {
        return;
    }
    let pattern = |key: &str| Some((key.to_owned(), Pattern::parse(manifest.layout.get(key)?.as_str()?, folder)?));
    let patterns: Vec<(String, Pattern)> = ["images", "videos", "test"].iter().filter_map(|key| pattern(key)).collect();
    let found: Vec<(&str, &Pattern, BTreeMap<String, u64>)> = patterns
        .iter()
        .map(|(key, pattern)| (key.as_str(), pattern, pattern.files_by_camera(folder)))
        .filter(|(_, _, files)| !files.is_empty())
        .collect();
    if found.is_empty() && !patterns.is_empty() {
        let keys: Vec<&str> = patterns.iter().map(|(key, _)| key.as_str()).collect();
        wrong.push(format!("no file matches the layout of the manifest ({})", keys.join(", ")));
    }
    let mut judge = |is_right: bool, text: String, stated: u64| {
        if is_right { right.push(text) } else { wrong.push(format!("{text} instead of {stated}")) }
    };
    let images = found.iter().find(|(key, ..)| *key == "images");
    if let (Some(stated), Some((_, _, files))) = (scene.images, images) {
        let count: u64 = files.values().sum();
        judge(count == stated, format!("{count} images"), stated);
    }
    if let (Some(stated), Some((.., files))) =
        (scene.cameras, found.iter().find(|(_, pattern, _)| pattern.has_cameras()))
    {
        judge(files.len() as u64 == stated, format!("{} cameras", files.len()), stated);
    }
    if let (Some(stated), Some((_, _, files))) = (scene.frames, images) {
        let (camera, fewest) =
            files.iter().min_by_key(|(_, count)| **count).expect("only patterns with files are kept");
        let at = if camera.is_empty() { String::new() } else { format!(" of camera {camera}") };
        let text = if fewest >= &stated { format!("{fewest} frames") } else { format!("{fewest} frames{at}") };
        judge(*fewest >= stated, text, stated);
    }
}

/// The number of files that the pattern `images` of the layout matches.
fn images_of(manifest: &Manifest, split: &str, folder: &Path) -> Option<u64> {
    let pattern = manifest.layout.get("images")?.as_str()?.strip_prefix("{scene}/")?;
    let (below, extension) = pattern.rsplit_once("/*.").filter(|_| pattern.contains("{split}"))?;
    let entries = std::fs::read_dir(folder.join(below.replace("{split}", split))).into_iter().flatten().flatten();
    let is_image =
        |entry: &std::fs::DirEntry| entry.path().extension().is_some_and(|found| found.eq_ignore_ascii_case(extension));
    Some(entries.filter(is_image).count() as u64)
}

/// Like [`compare`]; files that were fetched are hashed again as well.
pub fn verify(manifest: &Manifest, scene: &Scene, data_root: &Path) -> Result<Finding, Failure> {
    let folder = manifest.folder_of(scene, data_root);
    let counted = compare(manifest, scene, &folder);
    if counted == Finding::Absent {
        return Ok(counted);
    }
    let records = records::read(data_root)?;
    let (mut hashed, mut wrong) = (0, Vec::new());
    for (path, stated) in records.iter().flat_map(|record| &record.files) {
        let file = data_root.join(path);
        if !file.starts_with(&folder) {
            continue;
        }
        hashed += 1;
        match digest(&file) {
            Ok(found) if found == *stated => (),
            Ok((size, _)) => {
                wrong.push(format!("{} has changed ({size} bytes, fetched with {})", path.display(), stated.0))
            }
            Err(failure) => wrong.push(failure.message),
        }
    }
    Ok(match (counted, hashed) {
        (Finding::Wrong(more), _) => Finding::Wrong(more.into_iter().chain(wrong).collect()),
        (_, _) if !wrong.is_empty() => Finding::Wrong(wrong),
        (Finding::Fine(text), 0) => {
            let files = WalkDir::new(&folder).into_iter().flatten().filter(|entry| entry.file_type().is_file()).count();
            Finding::Fine(format!(
                "{text}; {files} files, not hashed: they were not fetched with `pipeline data fetch`"
            ))
        }
        (Finding::Fine(text), hashed) => Finding::Fine(format!("{text}; {hashed} files as fetched")),
        (Finding::Absent, _) => Finding::Absent,
    })
}

/// Hashes a file that is stored as it is, and compares it with the manifest and with its record; nothing for an archive of
/// scenes.
pub fn verify_file(manifest: &Manifest, archive: &Archive, data_root: &Path) -> Result<Option<Finding>, Failure> {
    let Some(file) = archive.file(manifest, data_root) else { return Ok(None) };
    if !file.exists() {
        return Ok(Some(Finding::Absent));
    }
    let (size, sha256) = match digest(&file) {
        Ok(found) => found,
        Err(failure) => return Ok(Some(Finding::Wrong(vec![failure.message]))),
    };
    let mut wrong = Vec::new();
    if let Some(stated) = archive.size.filter(|stated| *stated != size) {
        wrong.push(format!("{size} bytes; the manifest states {stated}"));
    }
    if let Some(stated) = archive.sha256.as_ref().filter(|_| !archive.fits(&sha256)) {
        wrong.push(format!("its SHA-256 is {sha256}; the manifest states {stated}"));
    }
    let below = file.strip_prefix(data_root).unwrap_or(&file);
    let records = records::read(data_root)?;
    let recorded = records.iter().find_map(|record| record.files.get(below));
    if let Some((bytes, _)) = recorded.filter(|recorded| **recorded != (size, sha256.clone())) {
        wrong.push(format!("it has changed ({size} bytes, fetched with {bytes})"));
    }
    if !wrong.is_empty() {
        return Ok(Some(Finding::Wrong(wrong)));
    }
    let known = match (archive.sha256.as_ref().map(String::len), recorded) {
        (Some(_), _) if archive.has_hash() => "the SHA-256 of the manifest".to_owned(),
        (Some(digits), _) => format!("the first {digits} digits of its SHA-256 as the manifest states"),
        (None, Some(_)) => "as fetched".to_owned(),
        (None, None) => format!("SHA-256 {sha256}, which neither the manifest nor a fetch states"),
    };
    Ok(Some(Finding::Fine(format!("{size} bytes, {known}"))))
}
