//! The files of a data folder that the views of a capture need.

use std::path::Path;

use engine::{Failure, FailureKind};
use scene::{Capture, MatchedFiles, Naming, Videos, View, ViewFolder};

/// Opens a folder with one file per view; [`FailureKind::MissingData`] if it does not exist. `what` names its content.
pub fn open_folder(dir: &Path, extensions: &[&str], what: &str) -> anyhow::Result<ViewFolder> {
    let missing = || Failure::new(FailureKind::MissingData, format!("no such folder of {what}")).at(dir);
    Ok(ViewFolder::open(dir, extensions)?.ok_or_else(missing)?)
}

/// Matches the files of a folder with the views of a capture. A view that `needs` a file and has none is
/// [`FailureKind::MissingData`]; it is an error if `naming` does not decide which file belongs to which view.
pub fn match_required<'a>(
    folder: &'a ViewFolder,
    capture: &Capture,
    naming: Naming,
    needs: impl Fn(&View) -> bool,
) -> anyhow::Result<MatchedFiles<'a>> {
    let matched = folder.match_views(capture, naming)?;
    let views = capture.views.iter().zip(&matched.files);
    let missing: Vec<&str> =
        views.filter(|(view, file)| file.is_none() && needs(view)).map(|(view, _)| view.name.as_str()).collect();
    let message = match missing.as_slice() {
        [] => return Ok(matched),
        [view] => format!("view {view} has no file in this folder"),
        [first, ..] => format!("{} views have no file in this folder, e.g. {first}", missing.len()),
    };
    let number = Videos::of(capture).number(&capture.views[0]).map_or("", |_| " or the number of its frame");
    let hint = format!("a file has the name of its view in the capture{number}");
    Err(Failure::new(FailureKind::MissingData, message).hint(hint).at(folder.dir()).into())
}
