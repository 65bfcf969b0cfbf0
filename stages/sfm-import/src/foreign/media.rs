//! Videos, images and files without poses.

use std::path::Path;

use super::listing::Listing;
use crate::image_names::image_names;

/// Estimates poses of photos from several cameras.
const RECONSTRUCT_PHOTOS: &str =
    "colmap automatic_reconstructor --workspace_path . --image_path images --data_type individual --dense 0";

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

/// Images without poses.
pub(super) fn images(listing: &Listing) -> Option<String> {
    let names = image_names(listing.dir);
    let first = names.first()?;
    let folder = Path::new(first).components().next().filter(|_| first.contains('/'));
    let folder = folder.map_or(".".into(), |folder| folder.as_os_str().to_string_lossy().into_owned());
    Some(format!(
        "{} images without poses. Run in this folder: `pipeline prepare {folder} --out DIR`; it runs COLMAP, and DIR is a COLMAP \
         capture. Where COLMAP fails, use the COLMAP export of VGGT or MASt3R",
        names.len()
    ))
}
