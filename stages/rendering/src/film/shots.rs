//! The times and cameras of a film.

use engine::{Failure, FailureKind};
use scene::{Camera, Capture, Split, View};

use super::path::CameraPath;
use crate::inputs::{first_view, times_within};
use crate::prompts::Selection;

/// The times and cameras of a film's frames.
#[derive(Clone, Debug)]
pub struct Film<'a> {
    /// One time per frame, in seconds of the capture. Repeated times freeze the motion. If there are none, the film
    /// follows `views`: each frame has the time and the camera of one view.
    pub times: &'a [f64],
    /// Names of capture views, or of splits (`train`, `val`, `test`) for all of their views. The camera moves through
    /// their cameras evenly over the frames; without views it stands at the first test view.
    pub views: &'a [String],
    /// A prompt, and the edit of the part that it selects.
    pub selection: Option<Selection<'a>>,
}

/// The time and the camera of one frame.
pub(super) struct Shot {
    pub(super) time_secs: f64,
    pub(super) camera: Camera,
}

/// Times and cameras of all frames; there is at least one.
pub(super) fn shots(film: &Film, capture: &Capture) -> anyhow::Result<Vec<Shot>> {
    let views = views(film.views, capture)?;
    if film.times.is_empty() && !views.is_empty() {
        return Ok(views.iter().map(|view| Shot { time_secs: view.time_secs, camera: view.camera }).collect());
    }
    let times = times_within(film.times, capture)?;
    let standing = if views.is_empty() { Some(first_view(capture)?) } else { None };
    let cameras: Vec<Camera> = views.into_iter().chain(standing).map(|view| view.camera).collect();
    let path = CameraPath::through(&cameras);
    let last = (times.len() - 1).max(1) as f64;
    let shot = |(index, time_secs)| Shot { time_secs, camera: path.at(index as f64 / last) };
    Ok(times.into_iter().enumerate().map(shot).collect())
}

/// The views with these names. A name that no view has may be that of a split, and stands for all of its views.
fn views<'c>(names: &[String], capture: &'c Capture) -> anyhow::Result<Vec<&'c View>> {
    let named = |name: &String| -> anyhow::Result<Vec<&'c View>> {
        if let Some(view) = capture.views.iter().find(|view| view.name == *name) {
            return Ok(vec![view]);
        }
        let split = Split::ALL.into_iter().find(|split| split.name() == name);
        let views: Vec<&View> =
            split.into_iter().flat_map(|split| capture.views_of(split)).map(|(_, view)| view).collect();
        if views.is_empty() { Err(no_view(name, capture).into()) } else { Ok(views) }
    };
    Ok(names.iter().map(named).collect::<anyhow::Result<Vec<_>>>()?.concat())
}

fn no_view(name: &str, capture: &Capture) -> Failure {
    let known: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    let (first, last) = (known.first().unwrap_or(&""), known.last().unwrap_or(&""));
    let splits = "train, val and test stand for all views of a split";
    let hint = format!("the capture has {} views, from {first} to {last}; {splits}", known.len());
    Failure::new(FailureKind::BadInput, format!("the capture has no view {name:?}")).hint(hint).at(&capture.dir)
}
