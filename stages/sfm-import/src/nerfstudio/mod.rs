//! A single `transforms.json`, as nerfstudio (Tancik et al. 2023), instant-ngp (Müller et al. 2022) and the exports of
//! Polycam, Record3D, KIRI Engine and Metashape to these write it. ScanNet++ (Yeshwanth et al. 2023) has it in a folder of its
//! own, next to that of the images.

mod splits;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use scene::Split;

use crate::colmap;
use crate::error::{Result, bad};
use crate::files;
use crate::image_names::{natural_order, view_name};
use crate::params::{Format, Params};
use crate::source::SourceCapture;
use crate::split;
use crate::transforms::{
    ListedFrame, Splits, StatedFrame, TransformsFile, between_frames, cloud, drop_repeated, frames, image_path,
    is_static, long_gap, number_by_time, number_static, other_unit, relative, set_pixels, stated_bounds, time_map,
};

/// The name of the file.
pub(crate) const FILE: &str = "transforms.json";

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    file_path(dir).is_file()
}

/// The path of the file.
fn file_path(dir: &Path) -> PathBuf {
    let (own, of_scannetpp) = (dir.join(FILE), dir.join("nerfstudio").join(FILE));
    let is_scannetpp = !own.is_file() && dir.join(files::RESIZED).is_dir() && of_scannetpp.is_file();
    if is_scannetpp { of_scannetpp } else { own }
}

/// Reads the frames of the file; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let file = TransformsFile::read(file_path(dir))?;
    let mut listed = listed(dir, &file, &mut warnings)?;
    drop_repeated(&mut listed, &mut warnings);
    let official = splits::official(&file, &mut listed, params, &mut warnings)?;
    let is_static = is_static(&listed, params, &mut warnings)?;
    let mut frames = frames(dir, &listed, params, &mut warnings)?;
    if is_static {
        number_static(&mut frames)
    } else {
        number_by_time(&mut frames, Splits::OfOneRecording, &mut warnings)
    }
    if is_static && !params.is_static() && colmap::layout::sparse_dir(dir).is_some() {
        let note = "if the images are frames of a video of something that moves, set format = \"colmap\"";
        warnings.push(note.into());
    }
    let wants_test = official.is_some() || params.every_nth > 0;
    let mut rules = vec![official.unwrap_or_else(|| split::hold_out(&mut frames, is_static, params))];
    let time_map = time_map(&frames, is_static);
    let about_times = [long_gap(&frames, &time_map), other_unit(&time_map), between_frames(&frames)];
    warnings.extend(about_times.into_iter().flatten());
    rules.extend(split::refine(&mut frames, params));
    Ok(SourceCapture {
        name: files::name(dir),
        format: Format::Nerfstudio,
        dataset: "nerfstudio",
        wants_test,
        split_rule: rules.join(", "),
        time_rule: if is_static { "one instant".into() } else { "(file time - min) / (max - min)".into() },
        time_map,
        frames,
        points: Vec::new(),
        set_pixels: set_pixels(&listed),
        cloud: cloud(dir, &file, &mut warnings),
        stated_bounds: stated_bounds(&file, &mut warnings),
        quality: None,
        warnings,
    })
}

/// The frames that have an image, in the natural order of their names, as training views or as those of `test_frames`.
fn listed<'a>(dir: &Path, file: &'a TransformsFile, warnings: &mut Vec<String>) -> Result<Vec<ListedFrame<'a>>> {
    let (train, test) = (&file.document.frames, &file.document.test_frames);
    let stated = train.iter().map(|frame| (Split::Train, frame)).chain(test.iter().map(|frame| (Split::Test, frame)));
    let (bad_ones, stated): (Vec<_>, Vec<_>) = stated.partition(|(_, frame)| frame.is_bad());
    if !bad_ones.is_empty() {
        warnings.push(format!("{} frames are marked by is_bad and are left out", bad_ones.len()));
    }
    let has_image = |(_, frame): &&(Split, &StatedFrame)| !frame.file_path.trim().is_empty();
    let with_image: Vec<(Split, &'a StatedFrame)> = stated.iter().filter(has_image).copied().collect();
    if with_image.is_empty() && !stated.is_empty() {
        let hint = "this is a path for rendering: training needs frames with images";
        return Err(bad("no frame names an image: every file_path is empty").hint(hint).at(&file.path));
    }
    if with_image.len() < stated.len() {
        warnings.push(format!("{} frames have an empty file_path and are skipped", stated.len() - with_image.len()));
    }
    let blame = |failure: engine::Failure| failure.at(&file.path);
    let names: Vec<PathBuf> = with_image.iter().map(|(_, frame)| relative(&frame.file_path)).collect();
    let root = common_folder(&names);
    let mut listed = Vec::new();
    for ((split, stated), name) in with_image.into_iter().zip(&names) {
        let image = image_path(dir, &stated.file_path).map_err(blame)?;
        let name = view_name(&name.strip_prefix(&root).unwrap_or(name).to_string_lossy());
        listed.push(ListedFrame { name, split, stated, file, image });
    }
    listed.sort_by(|a, b| natural_order(&a.stated.file_path, &b.stated.file_path));
    Ok(listed)
}

/// The longest folder that contains all files.
fn common_folder(names: &[PathBuf]) -> PathBuf {
    let folders: BTreeSet<&Path> = names.iter().filter_map(|name| name.parent()).collect();
    let mut folders = folders.into_iter();
    let first = folders.next().unwrap_or(Path::new("")).to_path_buf();
    folders.fold(first, |common, folder| {
        let equal = common.components().zip(folder.components()).take_while(|(a, b)| a == b);
        equal.map(|(part, _)| part).collect()
    })
}
