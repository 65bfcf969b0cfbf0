//! Masks in files.

use std::path::{Path, PathBuf};

use captures::{MapFile, MapFiles, open_folder, per_view};
use engine::{Failure, FailureKind, JobContext};
use scene::maps::fit_to_view;
use scene::maps::formats::{self, Content};
use scene::mask_file::MOSTLY_SET;
use scene::{Capture, Mask, Split, View, ViewFolder};

use crate::Params;
use crate::params::Polarity;

/// Reads the masks in `dir`; every training view must have one. If `dir` has no files, its folders have the masks of
/// one object each, which are united.
pub(crate) fn masks(
    context: &JobContext,
    dir: &Path,
    capture: &Capture,
    params: &Params,
) -> anyhow::Result<Vec<Option<Mask>>> {
    let files = open_folder(dir, &formats::EXTENSIONS, "masks")?;
    // If there are other files, a JSON file is not a mask.
    let folder = if files.is_empty() { open_folder(dir, &["json"], "masks")? } else { files };
    let objects = if folder.is_empty() { objects(dir)? } else { Vec::new() };
    let folders = if objects.is_empty() { vec![folder] } else { objects };
    // An object may be absent from some frames, which then have no file for it.
    let is_one = folders.len() == 1;
    let is_required = |view: &View| is_one && view.split == Split::Train;
    let found = |folder| MapFiles::find(folder, Content::Mask, capture, params.naming, [0, 0], is_required);
    let found = folders.iter().map(found).collect::<anyhow::Result<Vec<_>>>()?;
    context.measure("files_without_a_view", found.iter().map(|found| found.unused).sum::<usize>())?;
    let of_view = |index: usize| {
        let files = found.iter().filter_map(|found| found.files[index].as_ref());
        let set = files.map(|file| set(file, &capture.views[index], params));
        set.reduce(|a, b| Ok(a?.or(&b?))).transpose()
    };
    let masks = per_view(context, capture.views.len(), of_view)?;
    if let Some(view) = capture
        .views
        .iter()
        .zip(&masks)
        .find_map(|(view, mask)| (mask.is_none() && view.split == Split::Train).then_some(view))
    {
        let message = format!("training view {} has no mask of any object", view.name);
        return Err(Failure::new(FailureKind::MissingData, message).at(dir).into());
    }
    if params.polarity == Polarity::Auto && folders.iter().any(ViewFolder::names_images) {
        check_polarity(&masks, dir)?;
    }
    let moves = |mask: Mask| if params.polarity == Polarity::SetRests { inverted(mask) } else { mask };
    checked(masks.into_iter().map(|mask| mask.map(moves)).collect(), dir)
}

/// The folders in `dir` that have masks; no hidden folders.
fn objects(dir: &Path) -> anyhow::Result<Vec<ViewFolder>> {
    let entries = fs_err::read_dir(dir)?.collect::<std::io::Result<Vec<_>>>()?;
    let shown = entries.iter().filter(|entry| !entry.file_name().as_encoded_bytes().starts_with(b"."));
    let mut paths: Vec<PathBuf> = shown.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    paths.sort();
    let folders = paths.iter().map(|path| open_folder(path, &formats::EXTENSIONS, "masks"));
    let folders = folders.collect::<anyhow::Result<Vec<_>>>()?;
    Ok(folders.into_iter().filter(|folder| !folder.is_empty()).collect())
}

/// The set pixels of a file.
fn set(file: &MapFile, view: &View, params: &Params) -> anyhow::Result<Mask> {
    let (values, _) = fit_to_view(file.read()?, &view.camera.intrinsics, &file.path)?;
    let inside = values.values.iter().map(|value| *value > f32::from(params.threshold)).collect();
    Ok(Mask { width: values.width, height: values.height, inside })
}

fn inverted(mask: Mask) -> Mask {
    Mask { inside: mask.inside.iter().map(|inside| !inside).collect(), ..mask }
}

/// Refuses masks with names of COLMAP's if most pixels are set.
fn check_polarity(masks: &[Option<Mask>], dir: &Path) -> anyhow::Result<()> {
    let (set, all) =
        masks.iter().flatten().fold((0, 0), |(set, all), mask| (set + mask.count(), all + mask.inside.len()));
    if set as f64 <= MOSTLY_SET * all as f64 {
        return Ok(());
    }
    let message = format!(
        "{:.0} % of the pixels are set in masks that are named like those that COLMAP reads, which mark what is static",
        100.0 * set as f64 / all as f64
    );
    let hint = "set polarity = \"set-rests\" if they do, or polarity = \"set-moves\" if set pixels move";
    Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(dir).into())
}

/// The masks of `dir`; an error if every pixel of every mask moves.
pub(crate) fn checked(masks: Vec<Option<Mask>>, dir: &Path) -> anyhow::Result<Vec<Option<Mask>>> {
    if masks.iter().flatten().all(|mask| mask.count() == mask.inside.len()) {
        let hint = "check polarity; threshold must be at least the grey level of pixels that are not set";
        return Err(Failure::new(FailureKind::BadInput, "every pixel of every mask moves").hint(hint).at(dir).into());
    }
    Ok(masks)
}
