//! Recognises the format of a folder and reads it.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::cloud_file::CloudSource;
use crate::error::{Result, bad};
use crate::estimators::{megasam, monst3r, vggt};
use crate::files::{children, unreadable, unreadable_folders};
use crate::foreign::{next_step, next_step_for_file};
use crate::params::{Format, Params};
use crate::source::SourceCapture;
use crate::{
    blender, colmap, depth_cloud, depth_scale, easy_volcap, immersive, llff, mask_polarity, model_cloud, n3v, nerfies,
    nerfstudio, nvidia, oddities, panoptic, scannet, technicolor, tum,
};

/// How many folders below a folder an archive may keep its captures.
const DEPTH: usize = 3;
/// The number of folders that are searched at each level: in a folder of captures, one of the first ones is a capture.
const FOLDERS: usize = 20;

/// Reads the capture in `dir`; opens only the headers of images, and a few masks to find their polarity.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut capture = read_views(dir, params)?;
    let points = match &capture.cloud {
        Some(CloudSource::File(file)) => file.load(&capture.cameras(), &mut capture.warnings)?,
        Some(CloudSource::Depth) => depth_cloud::points(&capture.frames)?,
        Some(CloudSource::Model(sparse)) => model_cloud::points(sparse, &capture.frames, &mut capture.warnings)?,
        Some(CloudSource::Sweep(_)) | None => Vec::new(), // triangulation takes a while
    };
    capture.points.extend(points);
    let with_mask = capture.frames.iter().filter_map(|frame| Some((frame.mask.as_deref()?, frame.image.as_path())));
    let masks: Vec<(&Path, &Path)> = with_mask.collect();
    let (set_pixels, note) = mask_polarity::decided(capture.set_pixels, &masks);
    capture.set_pixels = set_pixels;
    capture.warnings.extend(note);
    let found = oddities::warnings(&capture);
    capture.warnings.extend(found);
    let scale = depth_scale::warning(&capture);
    capture.warnings.extend(scale);
    Ok(capture)
}

/// Like [`read`], without the points of a cloud file or of depth.
pub(crate) fn read_views(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut capture = read_format(dir, params)?;
    capture.number_equal_names();
    capture.warnings.extend(unreadable_folders(dir).iter().map(Failure::to_string));
    Ok(capture)
}

fn read_format(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let format = recognise(dir, params.format)?;
    refuse_rig_parameters(format, params).map_err(|failure| failure.at(dir))?;
    match format {
        Format::Colmap => colmap::read(dir, params),
        Format::Nerfies => nerfies::read(dir, params),
        Format::N3v => n3v::read(dir, params),
        Format::EasyVolcap => easy_volcap::read(dir, params),
        Format::Panoptic => panoptic::read(dir, params),
        Format::Technicolor => technicolor::read(dir, params),
        Format::Llff => llff::read(dir, params),
        Format::Nvidia => nvidia::read(dir, params),
        Format::Nerfstudio => nerfstudio::read(dir, params),
        Format::Immersive => immersive::read(dir, params),
        Format::Tum => tum::read(dir, params),
        Format::ScanNet => scannet::read(dir, params),
        Format::Vggt => vggt::read(dir, params),
        Format::MegaSam => megasam::read(dir, params),
        Format::Monst3r => monst3r::read(dir, params),
        _ => blender::read(dir, params),
    }
}

/// Refuses parameters that only captures with one video or folder per camera have.
fn refuse_rig_parameters(format: Format, params: &Params) -> Result<()> {
    let given = [
        ("test_cameras", !params.test_cameras.is_empty()),
        ("first_frame", params.first_frame.is_some()),
        ("frame_count", params.frame_count.is_some()),
    ];
    let Some((key, _)) = given.into_iter().find(|(_, is_given)| *is_given && !Format::RIGS.contains(&format)) else {
        return Ok(());
    };
    let rigs = Format::RIGS.map(Format::name).join(", ");
    let hint = format!("remove it; it is for the formats {rigs}");
    Err(bad(format!("{key} has no effect on a capture of the format {}", format.name())).hint(hint))
}

/// The format of the files in `dir`. It must be `wanted`, unless that is [`Format::Auto`].
pub(crate) fn recognise(dir: &Path, wanted: Format) -> Result<Format> {
    if dir.is_file() {
        let hint = next_step_for_file(dir).unwrap_or_else(|| "name the folder that contains the file".into());
        return Err(bad("a capture is a folder, but this is a file").hint(hint).at(dir));
    }
    if let Some(failure) = unreadable(dir) {
        return Err(failure);
    }
    if !dir.is_dir() {
        let hint = "check --data-root, and download the data";
        return Err(Failure::new(FailureKind::MissingData, "no such data folder").hint(hint).at(dir));
    }
    let found = formats_of(dir);
    match (wanted, found.as_slice()) {
        (Format::Colmap, _) if colmap::layout::sparse_dir(dir).is_some() => Ok(Format::Colmap),
        (Format::Nerfstudio, _) if nerfstudio::is_present(dir) => Ok(Format::Nerfstudio),
        (Format::Auto, [format]) => Ok(*format),
        (Format::Auto, [first, second, ..]) => {
            let message = format!("the folder contains both a {} and a {} capture", first.name(), second.name());
            let hint = format!(
                "choose one by the parameter format = \"{}\" or format = \"{}\" of the import, or by --format of `pipeline inspect`",
                first.name(),
                second.name()
            );
            Err(bad(message).hint(hint).at(dir))
        }
        (wanted, found) if found.contains(&wanted) => Ok(wanted),
        _ => Err(unrecognised(dir, wanted)),
    }
}

/// Every format whose files are in `dir`.
fn formats_of(dir: &Path) -> Vec<Format> {
    let present = [
        (Format::Blender, blender::is_present(dir)),
        // instant-ngp's loader accepts both; the split files say more.
        (Format::Nerfstudio, nerfstudio::is_present(dir) && !blender::is_present(dir)),
        (Format::Colmap, is_colmap(dir)),
        (Format::Nerfies, nerfies::is_present(dir)),
        (Format::N3v, n3v::is_present(dir)),
        (Format::EasyVolcap, easy_volcap::is_present(dir)),
        (Format::Panoptic, panoptic::is_present(dir)),
        (Format::Technicolor, technicolor::is_present(dir)),
        (Format::Nvidia, nvidia::is_present(dir)),
        (Format::Llff, is_llff(dir)),
        (Format::Immersive, immersive::is_present(dir)),
        (Format::Tum, tum::is_present(dir)),
        (Format::ScanNet, scannet::is_present(dir)),
        (Format::Vggt, vggt::is_present(dir)),
        (Format::MegaSam, megasam::is_present(dir)),
        (Format::Monst3r, monst3r::is_present(dir)),
    ];
    present.into_iter().filter(|(_, is_present)| *is_present).map(|(format, _)| format).collect()
}

/// Whether `dir` is a COLMAP capture. A model in `colmap/` or `sparse_/` is ignored if nerfstudio made transforms from it, or if
/// the scripts of 4DGaussians (Wu et al. 2024) made it from a data set.
fn is_colmap(dir: &Path) -> bool {
    let has_transforms = || ["transforms.json", "transforms_train.json"].iter().any(|name| dir.join(name).is_file());
    let has_other_poses = || has_transforms() || n3v::is_present(dir) || nerfies::is_present(dir);
    let is_made = |model: &Path| ["colmap", "sparse_"].iter().any(|folder| model.starts_with(dir.join(folder)));
    colmap::layout::sparse_dir(dir).is_some_and(|model| !is_made(&model) || !has_other_poses())
}

/// Whether `dir` is an LLFF capture. Rigs and COLMAP models with more information may have the same files.
fn is_llff(dir: &Path) -> bool {
    llff::is_present(dir) && !n3v::is_present(dir) && !nvidia::is_present(dir) && !is_colmap(dir)
}

/// The error for a folder without the wanted format: it lists the files found and the supported layouts, or names a folder in
/// it that cannot be read.
fn unrecognised(dir: &Path, wanted: Format) -> Failure {
    let below = captures_below(dir);
    if let (true, Some(failure)) = (below.is_empty(), unreadable_folders(dir).into_iter().next()) {
        return failure;
    }
    let what = match wanted {
        Format::Auto => "no capture in a known format",
        Format::Blender => "not a Blender/D-NeRF capture",
        Format::Nerfstudio => "not a nerfstudio capture",
        Format::Colmap => "not a COLMAP capture",
        Format::Nerfies => "not a Nerfies/HyperNeRF capture",
        Format::N3v => "not a Neural 3D Video capture",
        Format::EasyVolcap => "not an EasyVolcap capture",
        Format::Panoptic => "not a CMU Panoptic capture",
        Format::Technicolor => "not a Technicolor capture",
        Format::Llff => "not an LLFF capture",
        Format::Nvidia => "not a capture of NVIDIA's Dynamic Scenes",
        Format::ScanNet => "not an exported scene of ScanNet",
        Format::Immersive => "not a capture of Immersive Light Field Video",
        Format::Tum => "not an RGB-D sequence in the layout of TUM",
        Format::Vggt => "no predictions.npz of VGGT",
        Format::MegaSam => "no output of MegaSaM",
        Format::Monst3r => "no output of MonST3R",
    };
    let mut found: Vec<String> = children(dir);
    let hint = if found.is_empty() {
        "the folder is empty: download the data".to_owned()
    } else if let Some(child) = below.first() {
        format!(
            "this is a folder of captures: name one of them, e.g. {}",
            child.file_name().unwrap_or_default().display()
        )
    } else if let Some(other) = formats_of(dir).first() {
        format!("it is a {} capture: set format = \"{}\", or remove the key", other.name(), other.name())
    } else if let Some(deeper) = capture_within(dir, DEPTH) {
        format!("name the folder of the capture, {}", deeper.display())
    } else {
        next_step(dir)
    };
    let more = found.len().saturating_sub(8);
    found.truncate(8);
    let listed = format!("{}{}", found.join(", "), if more > 0 { format!(" and {more} more") } else { String::new() });
    let listed = if listed.is_empty() { "nothing".into() } else { listed };
    bad(format!("{what} (found {listed})")).hint(hint).at(dir)
}

/// The sorted folders directly below `dir` that are recognised as captures.
pub(crate) fn captures_below(dir: &Path) -> Vec<PathBuf> {
    let mut captures: Vec<PathBuf> = children(dir).iter().map(|name| dir.join(name)).collect();
    captures.retain(|path| path.is_dir() && is_capture(path));
    captures
}

/// The first capture at most `depth` folders below `dir`.
fn capture_within(dir: &Path, depth: usize) -> Option<PathBuf> {
    let folders = children(dir).into_iter().map(|name| dir.join(name)).filter(|path| path.is_dir()).take(FOLDERS);
    let folders: Vec<PathBuf> = folders.collect();
    let below = |path: &PathBuf| if depth > 1 { capture_within(path, depth - 1) } else { None };
    folders.iter().find(|path| is_capture(path)).cloned().or_else(|| folders.iter().find_map(below))
}

/// Whether the files of at least one format are in `dir`.
pub(crate) fn is_capture(dir: &Path) -> bool {
    !formats_of(dir).is_empty()
}
