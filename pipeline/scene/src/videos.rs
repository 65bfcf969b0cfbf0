//! Temporal neighbours of views: the video of each camera, by frame number.

use std::collections::{BTreeMap, BTreeSet};

use crate::{Capture, Split, View};

/// The videos that the views of a capture were taken from.
///
/// Frame numbers count the frames of one camera. If numbers of different splits collide, each split is a separate
/// video: official splits are then separate recordings.
pub struct Videos {
    is_split: bool,
    by_frame: BTreeMap<(Option<Split>, u32, u32), usize>,
    cameras: usize,
}

impl Videos {
    /// Groups the views of a capture into videos.
    pub fn of(capture: &Capture) -> Self {
        let index = |is_split: bool| -> BTreeMap<_, _> {
            capture.views.iter().enumerate().map(|(at, view)| (key(view, view.frame_index, is_split), at)).collect()
        };
        let shared = index(false);
        let is_split = shared.len() < capture.views.len();
        let cameras: BTreeSet<u32> = capture.views.iter().map(|view| view.camera_index).collect();
        Self { is_split, by_frame: if is_split { index(true) } else { shared }, cameras: cameras.len() }
    }

    /// The index within [`Capture::views`] of the view that the same camera took `frames` frames later (earlier if
    /// negative).
    pub fn after(&self, view: &View, frames: i64) -> Option<usize> {
        let frame = u32::try_from(i64::from(view.frame_index) + frames).ok()?;
        self.by_frame.get(&key(view, frame, self.is_split)).copied()
    }

    /// The number that names a view's file in a folder of numbered files: its frame number, if that identifies one
    /// view.
    pub fn number(&self, view: &View) -> Option<u32> {
        (!self.is_split && self.cameras == 1).then_some(view.frame_index)
    }
}

/// The key of a frame: its split (if splits are separate videos), camera and frame number.
fn key(view: &View, frame_index: u32, is_split: bool) -> (Option<Split>, u32, u32) {
    (is_split.then_some(view.split), view.camera_index, frame_index)
}
