//! `transforms_{train,val,test}.json`: D-NeRF and the synthetic scenes of NeRF (Pumarola et al. 2021, Mildenhall et
//! al. 2020).

use std::path::{Path, PathBuf};

use scene::Split;

use crate::error::Result;
use crate::files;
use crate::params::{Format, Params, TestSplit};
use crate::source::SourceCapture;
use crate::split;
use crate::transforms::{
    ListedFrame, Splits, StatedFrame, TransformsFile, between_frames, cloud, drop_repeated, frames, image_path,
    is_static, long_gap, number_by_time, number_static, other_unit, set_pixels, stated_bounds, time_map,
};

/// A flaw of the benchmark. Published tables omit the scene or test on its validation split.
const LEGO: &str = "D-NeRF's lego: the test images show a different state of the scene than the training images; \
                    set test_split = \"val\" to test on the validation images";

/// One split file.
struct SplitFile {
    label: &'static str,
    split: Split,
    file: TransformsFile,
}

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    path_of(dir, "train").is_file()
}

/// Reads the split files that the parameters select.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let (split_files, official) = split_files(dir, params, &mut warnings)?;
    let listed = split_files.iter().map(|file| listed(dir, file)).collect::<Result<Vec<_>>>()?;
    let mut listed: Vec<ListedFrame<'_>> = listed.into_iter().flatten().collect();
    drop_repeated(&mut listed, &mut warnings);
    let is_static = is_static(&listed, params, &mut warnings)?;
    let timed = listed.iter().any(|frame| frame.stated.time().is_some());
    if timed && dir.ends_with("lego") && params.test_split == TestSplit::Test {
        warnings.push(LEGO.into());
    }
    let mut frames = frames(dir, &listed, params, &mut warnings)?;
    if is_static {
        number_static(&mut frames)
    } else {
        number_by_time(&mut frames, Splits::Apart, &mut warnings)
    }
    let rule = official.unwrap_or_else(|| split::hold_out(&mut frames, is_static, params));
    let mut rules = vec![rule];
    let time_map = time_map(&frames, is_static);
    let about_times = [long_gap(&frames, &time_map), other_unit(&time_map), between_frames(&frames)];
    warnings.extend(about_times.into_iter().flatten());
    rules.extend(split::refine(&mut frames, params));
    let train = &split_files[0].file;
    Ok(SourceCapture {
        name: files::name(dir),
        format: Format::Blender,
        dataset: if timed { "dnerf" } else { "blender" },
        wants_test: split_files.len() > 1 || params.every_nth > 0,
        split_rule: rules.join(", "),
        time_rule: if is_static { "one instant".into() } else { "(file time - min) / (max - min)".into() },
        time_map,
        frames,
        points: Vec::new(),
        set_pixels: set_pixels(&listed),
        cloud: cloud(dir, train, &mut warnings),
        stated_bounds: stated_bounds(train, &mut warnings),
        quality: None,
        warnings,
    })
}

fn path_of(dir: &Path, label: &str) -> PathBuf {
    dir.join(format!("transforms_{label}.json"))
}

/// Parses the training file, the test file, and the official validation file unless that serves as the test file. Returns
/// them with the name of the official split, which is `None` if only the training file exists.
fn split_files(dir: &Path, params: &Params, warnings: &mut Vec<String>) -> Result<(Vec<SplitFile>, Option<String>)> {
    let load = |label, split| Ok(SplitFile { label, split, file: TransformsFile::read(path_of(dir, label))? });
    let train = load("train", Split::Train)?;
    let [has_val, has_test] = ["val", "test"].map(|label| path_of(dir, label).is_file());
    match (params.test_split, has_val, has_test) {
        (TestSplit::Val, ..) => Ok((vec![train, load("val", Split::Test)?], Some("official, tested on val".into()))),
        (TestSplit::Test, true, true) => {
            Ok((vec![train, load("val", Split::Val)?, load("test", Split::Test)?], Some("official".into())))
        }
        (TestSplit::Test, false, true) => {
            warnings.push(
                "transforms_val.json is missing: no official validation views (set val_count to hold out training views)"
                    .into(),
            );
            Ok((vec![train, load("test", Split::Test)?], Some("official".into())))
        }
        (TestSplit::Test, true, false) => {
            warnings.push("transforms_test.json is missing: the validation views serve as test views".into());
            Ok((vec![train, load("val", Split::Test)?], Some("official, tested on val".into())))
        }
        (TestSplit::Test, false, false) => {
            let rule = "of every_nth training images, one is held out for testing";
            warnings.push(format!("transforms_test.json and transforms_val.json are missing: {rule}"));
            Ok((vec![train], None))
        }
    }
}

/// The frames of one file, in the order of the file.
fn listed<'a>(dir: &Path, SplitFile { label, split, file }: &'a SplitFile) -> Result<Vec<ListedFrame<'a>>> {
    let frame = |(index, stated): (usize, &'a StatedFrame)| -> Result<ListedFrame<'a>> {
        let image = image_path(dir, &stated.file_path).map_err(|failure| failure.at(&file.path))?;
        Ok(ListedFrame { name: format!("{label}_{index:03}"), split: *split, stated, file, image })
    };
    file.document.frames.iter().enumerate().map(frame).collect()
}
