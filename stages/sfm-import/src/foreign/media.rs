//! Videos, images and files without poses.

use std::collections::{BTreeMap, BTreeSet};

use super::listing::Listing;
use crate::image_names::image_names;

/// Estimates poses of photos from several cameras.
const RECONSTRUCT_PHOTOS: &str =
    "colmap automatic_reconstructor --workspace_path . --image_path images --data_type individual --dense 0";

/// What to do if COLMAP finds no poses.
const WITHOUT_COLMAP: &str = "Where COLMAP fails, use the COLMAP export of VGGT or MASt3R";

/// A capture that `pipeline prepare` has not finished.
pub(super) fn unfinished_preparation(listing: &Listing) -> Option<String> {
    listing.has("prepare.json").then(|| {
        format!(
            "`pipeline prepare` has not found poses here yet: run the same command again, with `--out {}`; the results of finished \
             steps are kept, and .prepare/logs has the output of the others. {WITHOUT_COLMAP}",
            listing.dir.display()
        )
    })
}

/// A part of a COLMAP project.
pub(super) fn part_of_colmap(listing: &Listing) -> Option<String> {
    if listing.has_any(&["cameras.bin", "cameras.txt"]) {
        return Some(
            "this looks like a part of a COLMAP model: images.bin or images.txt, which has the poses, is missing. Name the \
             folder that contains both the whole model (sparse/0) and the images"
                .into(),
        );
    }
    listing.has("database.db").then(|| {
        "a COLMAP database without a model: run `mkdir -p sparse && colmap mapper --database_path database.db --image_path \
         images --output_path sparse`"
            .into()
    })
}

/// A transforms file of another name.
pub(super) fn renamed_transforms(listing: &Listing) -> Option<String> {
    let file = listing.marked("json", &["\"transform_matrix\"", "\"camera_angle_x\"", "\"fl_x\""])?;
    Some(format!("{file} looks like a transforms file: rename it to transforms.json, next to the images that it names"))
}

/// Archives.
pub(super) fn archives(listing: &Listing) -> Option<String> {
    let file = *listing.with_extension(&["zip", "tar", "gz", "tgz", "7z"]).first()?;
    Some(format!("{file} is an archive: unpack it and name the folder that it contains"))
}

/// One or several videos.
pub(super) fn videos(listing: &Listing) -> Option<String> {
    let videos = listing.with_extension(&["mp4", "mov", "m4v", "avi", "mkv", "webm", "insv"]);
    let first = *videos.first()?;
    let extract = "ffmpeg -i \"$v\" -qscale:v 2 \"images/$d%05d.jpg\"";
    Some(if videos.len() == 1 {
        format!(
            "a video without poses. Run in its folder: `pipeline prepare \"{first}\" --out DIR`, with --masks if something \
             moves; it runs FFmpeg and COLMAP, and DIR is a COLMAP capture"
        )
    } else {
        let extract = extract.replace("$d", "${v%.*}/");
        format!(
            "{} videos without poses. Run: `for v in {}; do mkdir -p \"images/${{v%.*}}\"; {extract}; done`, one folder per \
             camera, then `{RECONSTRUCT_PHOTOS}`; it writes sparse/0, and this folder is a COLMAP capture",
            videos.len(),
            pattern(&videos),
        )
    })
}

/// The shell pattern of files with one extension, or their names.
fn pattern(names: &[&str]) -> String {
    let extension = |name: &str| name.rsplit_once('.').map(|(_, extension)| extension.to_owned());
    match extension(names[0]) {
        Some(first) if names.iter().all(|name| extension(name).as_ref() == Some(&first)) => format!("*.{first}"),
        _ => names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(" "),
    }
}

/// A path as one word of a shell.
fn quoted(path: &str) -> String {
    let is_plain = |symbol: char| symbol.is_alphanumeric() || "._-/".contains(symbol);
    if path.chars().all(is_plain) { path.into() } else { format!("\"{path}\"") }
}

/// Images without poses: those of the folder with the most of them, or of all folders that may be cameras of a rig.
pub(super) fn images(listing: &Listing) -> Option<String> {
    let all = image_names(listing.dir);
    let photos: Vec<&str> = all.iter().map(String::as_str).filter(|name| !is_map(name)).collect();
    let names = if photos.is_empty() { all.iter().map(String::as_str).collect() } else { photos };
    let mut folders: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for name in names {
        let (folder, file) = name.split_once('/').unwrap_or((".", name));
        folders.entry(folder).or_default().push(file);
    }
    let most = folders.values().map(Vec::len).max()?;
    let (first, files) = folders.iter().find(|(_, files)| files.len() == most)?;
    let prepare = format!("it runs COLMAP, and DIR is a COLMAP capture. {WITHOUT_COLMAP}");
    let cameras = cameras(&folders, files);
    if cameras.len() < 2 {
        return Some(format!(
            "{most} images without poses. Run in this folder: `pipeline prepare {} --out DIR`; {prepare}",
            quoted(first)
        ));
    }
    let listed: usize = cameras.iter().map(|camera| folders[camera].len()).sum();
    // `prepare` reads every image below the folder.
    let move_others = if listed == all.len() { "" } else { "move all other images out of this folder, and " };
    Some(format!(
        "{listed} images without poses in the folders {}. If these are the cameras of a rig, {move_others}run in this folder: `pipeline \
         prepare . --out DIR`; otherwise name one of them in place of the dot; {prepare}",
        cameras.join(", ")
    ))
}

/// The folders with most of the names of `files`, as the folders of a rig's cameras have. Copies of `images` at other sizes are
/// no cameras.
fn cameras<'a>(folders: &BTreeMap<&'a str, Vec<&str>>, files: &[&str]) -> Vec<&'a str> {
    if folders.contains_key("images") || files.iter().any(|file| file.contains('/')) {
        return Vec::new();
    }
    let known: BTreeSet<&str> = files.iter().copied().collect();
    let common = |others: &[&str]| others.iter().filter(|name| known.contains(**name)).count();
    folders.iter().filter(|(_, others)| 2 * common(others) > files.len()).map(|(folder, _)| *folder).collect()
}

/// Whether a name has a word for masks or maps of images.
fn is_map(name: &str) -> bool {
    let lower = name.to_lowercase();
    let mut words = lower.split(|symbol: char| !symbol.is_alphabetic());
    words.any(|word| ["depth", "mask", "seg", "conf", "normal", "flow"].iter().any(|map| word.starts_with(map)))
}

/// Images in formats that are not read, in the folder or in one of its folders.
pub(super) fn other_images(listing: &Listing) -> Option<String> {
    let other = |listing: &Listing| {
        let found = listing.with_extension(&["bmp", "heic", "heif", "avif", "dng", "exr", "ppm", "tga"]);
        found.first().map(|first| (found.len(), (*first).to_owned()))
    };
    let below = || listing.names.iter().find_map(|name| other(&Listing::of(&listing.dir.join(name))));
    let (count, first) = other(listing).or_else(below)?;
    let extension = first.rsplit_once('.')?.1;
    Some(format!(
        "{count} images in a format that is not read, e.g. {first}: convert the images to PNG or JPEG, e.g. with ImageMagick's `mogrify \
         -format png *.{extension}`, and run `pipeline inspect` again"
    ))
}
