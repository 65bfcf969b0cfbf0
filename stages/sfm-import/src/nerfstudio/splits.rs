//! The split that a file states by lists of file names or of test frames.

use std::collections::BTreeSet;
use std::path::PathBuf;

use scene::Split;

use crate::error::{Result, bad};
use crate::params::{Params, TestSplit};
use crate::transforms::{ListedFrame, TransformsFile, relative};

/// Applies `train_filenames`, `val_filenames` and `test_filenames`; returns the name of the split, or `None` without
/// test or validation views.
///
/// The frames of `test_frames` are test views without a list, too. Other frames in none of the lists are dropped, or train if
/// there is no list of training views. Without test views, or if the parameters say so, the validation views are tested on, and
/// no others.
pub(super) fn official(
    file: &TransformsFile,
    frames: &mut Vec<ListedFrame<'_>>,
    params: &Params,
    warnings: &mut Vec<String>,
) -> Result<Option<String>> {
    let document = &file.document;
    let lists = [&document.train_filenames, &document.val_filenames, &document.test_filenames];
    let has_test = frames.iter().any(|frame| frame.split == Split::Test);
    if params.test_split == TestSplit::Val && document.val_filenames.is_none() {
        let hint = "list the validation views, or remove test_split";
        return Err(bad("test_split = \"val\", but the file has no val_filenames").hint(hint).at(&file.path));
    }
    if lists[1].is_none() && lists[2].is_none() {
        if document.train_filenames.is_some() && !has_test {
            warnings.push(
                "train_filenames is ignored, because the file lists no test or validation views: list those, too \
                 (test_filenames)"
                    .into(),
            );
        }
        return Ok(has_test.then(|| "official".into()));
    }
    let known: BTreeSet<PathBuf> = frames.iter().map(path).collect();
    let set = |(key, names): (&str, &Option<Vec<String>>)| match names {
        None => Ok(None),
        Some(names) => {
            let paths: BTreeSet<PathBuf> = names.iter().map(|name| relative(name)).collect();
            match paths.iter().find(|path| !known.contains(*path)) {
                None => Ok(Some(paths)),
                Some(unknown) => {
                    let message = format!("{key} names {}, which is not the file_path of any frame", unknown.display());
                    Err(bad(message).hint("use the file_path of a frame").at(&file.path))
                }
            }
        }
    };
    let keys = ["train_filenames", "val_filenames", "test_filenames"];
    let sets = keys.into_iter().zip(lists).map(set).collect::<Result<Vec<_>>>()?;
    let [train, val, test] = sets.as_slice() else { unreachable!("three keys have three lists") };
    let tests_on_val = params.test_split == TestSplit::Val || test.is_none() && !has_test;
    let (val, test) = if tests_on_val { (&None, val) } else { (val, test) };
    if tests_on_val {
        frames
            .retain(|frame| frame.split != Split::Test || test.as_ref().is_some_and(|set| set.contains(&path(frame))));
    }
    assign(frames, [train, val, test], warnings);
    Ok(Some(if tests_on_val { "official, tested on val" } else { "official" }.into()))
}

/// Sets the split of every frame and drops those in no list. A test view never trains, and neither does a validation view.
fn assign(
    frames: &mut Vec<ListedFrame<'_>>,
    [train, val, test]: [&Option<BTreeSet<PathBuf>>; 3],
    warnings: &mut Vec<String>,
) {
    let (before, mut overlaps) = (frames.len(), 0);
    frames.retain_mut(|frame| {
        let path = path(frame);
        let is_in = |set: &Option<BTreeSet<PathBuf>>| set.as_ref().is_some_and(|set| set.contains(&path));
        let held_out = [(test, Split::Test), (val, Split::Val)].into_iter().find(|(set, _)| is_in(set));
        overlaps += usize::from(held_out.is_some() && is_in(train));
        frame.split = held_out.map_or(frame.split, |(_, split)| split);
        frame.split != Split::Train || train.is_none() || is_in(train)
    });
    if overlaps > 0 {
        warnings.push(format!("{overlaps} test or validation images are also listed for training: they do not train"));
    }
    if frames.len() < before {
        warnings.push(format!("{} frames are in no list of file names and are skipped", before - frames.len()));
    }
}

fn path(frame: &ListedFrame<'_>) -> PathBuf {
    relative(&frame.stated.file_path)
}
