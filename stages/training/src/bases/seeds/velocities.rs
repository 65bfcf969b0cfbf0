//! Velocities of the pixels of a moving subject, from optical flow where it is given, otherwise from block matching with
//! the neighbouring training views.

use std::borrow::Cow;

use glam::{DVec2, DVec3};
use scene::{DepthMap, Mask, View};

use super::matching::{Frame, displacements};
use crate::data::LoadedView;
use crate::method::Start;

/// One training view with its moving pixels.
pub(super) struct Subject<'a> {
    pub(super) loaded: &'a LoadedView,
    pub(super) view: &'a View,
    pub(super) moving: Mask,
    /// The depth of all pixels, including the moving ones.
    pub(super) depth: Cow<'a, DepthMap>,
    /// Whether the depth is given for the static surroundings only. A point of the subject then keeps its distance from
    /// the image plane, because depth that is interpolated between a few points differs between frames by far more than
    /// the subject moves along the viewing axis.
    pub(super) keeps_depth: bool,
}

impl Subject<'_> {
    /// The world point that a pixel shows; `None` where its depth is unknown.
    pub(super) fn point(&self, [column, row]: [i32; 2]) -> Option<DVec3> {
        let at = row as usize * self.depth.width as usize + column as usize;
        let depth = f64::from(self.depth.depth_view[at]);
        (depth > 0.0).then(|| self.view.camera.unproject(center(column, row), depth))
    }

    fn frame(&self) -> Frame<'_> {
        Frame { pixels: &self.loaded.pixels, moving: &self.moving }
    }

    fn shows(&self, [column, row]: [i32; 2]) -> bool {
        let (width, height) = (self.moving.width as i32, self.moving.height as i32);
        let inside = (0..width).contains(&column) && (0..height).contains(&row);
        inside && self.moving.inside[(row * width + column) as usize]
    }
}

fn center(column: i32, row: i32) -> DVec2 {
    DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5)
}

/// World velocities, per unit of normalised time, of pixels of a subject towards another training view of it: where
/// block matching finds them there. `None` if the other view shows nothing that moves.
pub(super) fn towards(from: &Subject<'_>, to: &Subject<'_>, places: &[[i32; 2]]) -> Option<Vec<DVec3>> {
    let found = displacements(&from.frame(), &to.frame(), places)?;
    let duration = to.loaded.time - from.loaded.time;
    let velocity = |(place, [right, down]): (&[i32; 2], [i32; 2])| {
        let target = [place[0] + right, place[1] + down];
        let here = from.point(*place)?;
        let depth = from.depth.depth_view[place[1] as usize * from.depth.width as usize + place[0] as usize];
        let there = if to.shows(target) && !from.keeps_depth { to.point(target) } else { None };
        let there = there.unwrap_or_else(|| to.view.camera.unproject(center(target[0], target[1]), f64::from(depth)));
        Some((there - here) / duration)
    };
    Some(places.iter().zip(found).map(|pair| velocity(pair).unwrap_or(DVec3::ZERO)).collect())
}

/// World velocities of pixels by the optical flow that is given for their view; `None` where it is unknown. The point
/// keeps its distance from the image plane.
pub(super) fn by_flow(start: &Start<'_>, subject: &Subject<'_>, places: &[[i32; 2]]) -> Option<Vec<Option<DVec3>>> {
    let flow = start.supplements.view(subject.loaded.index)?.flow.as_ref()?;
    let time_to = start.scene().time_map.normalized(flow.time_to_secs);
    let duration = time_to - subject.loaded.time;
    if flow.map.width != subject.moving.width || flow.map.height != subject.moving.height || duration == 0.0 {
        return None;
    }
    let velocity = |place: &[i32; 2]| {
        let at = place[1] as usize * flow.map.width as usize + place[0] as usize;
        let [right, down] = flow.map.flow_px[at].map(f64::from);
        let here = subject.point(*place)?;
        let depth = f64::from(subject.depth.depth_view[at]);
        let target = center(place[0], place[1]) + DVec2::new(right, down);
        target.is_finite().then(|| (flow.camera_to.unproject(target, depth) - here) / duration)
    };
    Some(places.iter().map(velocity).collect())
}
