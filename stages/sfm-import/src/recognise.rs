//! Which of the formats a folder holds.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::params::Format;
use crate::source::{Result, bad};
use crate::{blender, colmap, n3v, nerfies};

/// The format of `dir`: what its files say, which must be `wanted` unless that is [`Format::Auto`].
pub fn recognise(dir: &Path, wanted: Format) -> Result<Format> {
    if dir.is_file() {
        return Err(bad("a capture is a folder, this is a file").hint("name the folder that the file lies in").at(dir));
    }
    if !dir.is_dir() {
        let hint = "is --data-root right, and is the data downloaded?";
        return Err(Failure::new(FailureKind::MissingData, "no such data folder").hint(hint).at(dir));
    }
    let found = formats_of(dir);
    match (wanted, found.as_slice()) {
        (Format::Auto, [format]) => Ok(*format),
        (Format::Auto, [first, second, ..]) => {
            let message = format!("the folder holds both a {} and a {} capture", first.name(), second.name());
            let hint = format!("set format = \"{}\" or format = \"{}\"", first.name(), second.name());
            Err(bad(message).hint(hint).at(dir))
        }
        (wanted, found) if found.contains(&wanted) => Ok(wanted),
        _ => Err(unrecognised(dir, wanted)),
    }
}

/// Every format whose files `dir` holds.
fn formats_of(dir: &Path) -> Vec<Format> {
    let present = [
        (Format::Blender, blender::is_here(dir)),
        (Format::Colmap, colmap::layout::sparse_dir(dir).is_some()),
        (Format::Nerfies, nerfies::is_here(dir)),
        (Format::N3v, n3v::is_here(dir)),
    ];
    present.into_iter().filter(|(_, is_here)| *is_here).map(|(format, _)| format).collect()
}

/// The error for a folder that is not what was wanted: what was found, and what is supported.
fn unrecognised(dir: &Path, wanted: Format) -> Failure {
    let what = match wanted {
        Format::Auto => "not a Blender/D-NeRF, COLMAP, Nerfies/HyperNeRF or Neural 3D Video capture",
        Format::Blender => "not a Blender/D-NeRF capture",
        Format::Colmap => "not a COLMAP capture",
        Format::Nerfies => "not a Nerfies/HyperNeRF capture",
        Format::N3v => "not a Neural 3D Video capture",
    };
    let mut found: Vec<String> = children(dir);
    let has = |name: &str| found.iter().any(|entry| entry == name);
    let hint = if found.is_empty() {
        "the folder is empty: is the data downloaded?".to_owned()
    } else if let Some(child) = captures_below(dir).first() {
        format!("it is a folder of captures: choose one, as {}", child.file_name().unwrap_or_default().display())
    } else if has("cameras.bin") || has("cameras.txt") {
        "this looks like part of a COLMAP model: name the folder that holds both the model and the images".into()
    } else if has("transforms.json") {
        "a single transforms.json (nerfstudio) is not read: split it into transforms_{train,val,test}.json".into()
    } else if has("dataset.json") || has("camera") {
        "the Nerfies/HyperNeRF layout needs camera/, metadata.json and dataset.json: is the data complete?".into()
    } else if has("poses_bounds.npy") {
        "poses_bounds.npy is read beside cameras (cam00/images, cam01/images, …, as Neural 3D Video has them), not beside \
         one folder of images (LLFF); a COLMAP model would be"
            .into()
    } else if !n3v::camera_names(dir).is_empty() {
        "the Neural 3D Video layout needs poses_bounds.npy beside its cameras: is the data complete?".into()
    } else {
        "supported: transforms_{train,val,test}.json (Blender, D-NeRF), images/ beside \
         sparse/0/{cameras,images,points3D}.{bin,txt} (COLMAP), camera/, rgb/ and metadata.json (Nerfies, HyperNeRF, \
         DyCheck), or poses_bounds.npy beside cam00/images, cam01/images, … (Neural 3D Video)"
            .into()
    };
    let more = found.len().saturating_sub(8);
    found.truncate(8);
    let listed = format!("{}{}", found.join(", "), if more > 0 { format!(" and {more} more") } else { String::new() });
    let listed = if listed.is_empty() { "nothing".into() } else { listed };
    bad(format!("{what} (found {listed})")).hint(hint).at(dir)
}

/// The folders directly below `dir` that are recognised as captures, sorted.
pub fn captures_below(dir: &Path) -> Vec<PathBuf> {
    let mut captures: Vec<PathBuf> = children(dir).iter().map(|name| dir.join(name)).collect();
    captures.retain(|path| path.is_dir() && !formats_of(path).is_empty());
    captures
}

/// Names of the entries of `dir`, sorted; none where it is no folder.
pub fn children(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
