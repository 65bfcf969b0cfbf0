//! Which view comes so many frames before or after another in the same camera's video.

use std::collections::BTreeMap;

use scene::{Capture, Split, View};

/// The videos that the views of a capture were taken from.
///
/// Frame numbers count the frames of one camera. Where numbers of different splits collide (official splits are then
/// separate recordings), each split is a video of its own.
pub struct Videos {
    is_split: bool,
    by_frame: BTreeMap<(Option<Split>, u32, u32), usize>,
    cameras: usize,
}

impl Videos {
    /// The videos of a capture.
    pub fn of(capture: &Capture) -> Self {
        let index = |is_split: bool| -> BTreeMap<_, _> {
            capture.views.iter().enumerate().map(|(at, view)| (key(view, view.frame_index, is_split), at)).collect()
        };
        let shared = index(false);
        let is_split = shared.len() < capture.views.len();
        let cameras: std::collections::BTreeSet<u32> = capture.views.iter().map(|view| view.camera_index).collect();
        Self { is_split, by_frame: if is_split { index(true) } else { shared }, cameras: cameras.len() }
    }

    /// The view that was taken `frames` after another by the same camera (before it, if negative), as an index within
    /// the capture's views.
    pub fn after(&self, view: &View, frames: i64) -> Option<usize> {
        let frame = u32::try_from(i64::from(view.frame_index) + frames).ok()?;
        self.by_frame.get(&key(view, frame, self.is_split)).copied()
    }

    /// The number that names files of this view where they are numbered: its frame, where that names only one view.
    pub fn number(&self, view: &View) -> Option<u32> {
        (!self.is_split && self.cameras == 1).then_some(view.frame_index)
    }
}

fn key(view: &View, frame_index: u32, is_split: bool) -> (Option<Split>, u32, u32) {
    (is_split.then_some(view.split), view.camera_index, frame_index)
}
