//! Maps of estimators, read from a folder.

use std::path::Path;

use captures::{MapFile, MapFiles};
use engine::{Failure, FailureKind};
use scene::maps::alignment::Fit;
use scene::maps::fit_to_view;
use scene::maps::formats::{self, Content};
use scene::{Capture, FloatImage, FlowMap, PointCloud, Split, Videos, View, ViewFolder};

use crate::params::MapKind;
use crate::tracks::Tracks;
use crate::{FlowPrior, Params, ViewMaps, depth, flow, from_points, normals};

/// Subfolder of depth maps.
pub(crate) const DEPTH: &str = "depth";
/// Subfolder of forward flow: from a frame to a later one, in a file with the name of the earlier frame.
pub(crate) const FLOW_FORWARD: &str = "flow_fwd";
/// Subfolder of backward flow: from a frame to an earlier one, in a file with the name of the later frame.
const FLOW_BACKWARD: &str = "flow_bwd";
/// Subfolder of the tracks of a whole video, which give forward flow where there is none.
pub(crate) const TRACKS: &str = "tracks";
/// Subfolder of normal maps.
pub(crate) const NORMALS: &str = "normal";

/// The maps of a folder, matched with the views of a capture.
pub(crate) struct Files<'a> {
    capture: &'a Capture,
    params: &'a Params,
    videos: Videos,
    points: Option<PointCloud>,
    filled: Filled,
    found: Found,
}

/// The files of every kind. Lists have one entry per view.
struct Found {
    depth: Vec<Option<MapFile>>,
    flow_forward: Vec<Option<MapFile>>,
    flow_backward: Vec<Option<MapFile>>,
    normals: Vec<Option<MapFile>>,
    tracks: Option<Tracks>,
    /// Number of files that belong to no view.
    unused: usize,
}

/// The direction of flow.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Direction {
    Forward,
    Backward,
}

/// A kind of maps that describes one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Still {
    Depth,
    Normals,
}

/// The depth of views without files of depth.
enum Filled {
    None,
    /// The depth of the capture.
    Own,
    /// Interpolated between the points of the capture.
    Interpolated(PointCloud),
}

/// Quality measures of the import of one view.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outcome {
    /// The alignment of its depth, if one was made.
    pub(crate) fit: Option<Fit>,
    /// Share of pixels whose flow is known and consistent, if it has flow.
    pub(crate) flow_kept: Option<f64>,
    /// Whether its flow was dropped because it leads to no training view.
    pub(crate) flow_leads_nowhere: bool,
    /// Whether its flow is zero everywhere.
    pub(crate) flow_is_zero: bool,
}

impl<'a> Files<'a> {
    /// Finds the files in `dir`. Unless `allow_missing` is set, every training view needs a file in each subfolder that
    /// exists. Kinds of maps that the recipe names must exist.
    pub(crate) fn find(dir: &Path, capture: &'a Capture, params: &'a Params) -> anyhow::Result<Self> {
        if !dir.is_dir() {
            let hint = "check --data-root and the recipe's folder";
            return Err(Failure::new(FailureKind::MissingData, "no such folder of maps").hint(hint).at(dir).into());
        }
        let videos = Videos::of(capture);
        let found = Found::find(dir, capture, params, &videos)?;
        found.check(dir, params)?;
        let has_depth = found.depth.iter().any(Option::is_some);
        let points = if has_depth { capture.load_points()? } else { None };
        let filled = match params.fill_depth && params.wants(MapKind::Depth) && !has_depth {
            true if capture.views.iter().any(|view| view.depth.is_some()) => Filled::Own,
            true => Filled::Interpolated(from_points::points(capture)?),
            false => Filled::None,
        };
        Ok(Self { capture, params, videos, points, filled, found })
    }

    /// Number of files that belong to no view.
    pub(crate) fn unused(&self) -> usize {
        self.found.unused
    }

    /// Whether the depth is interpolated between the points of the capture.
    pub(crate) fn interpolates(&self) -> bool {
        matches!(self.filled, Filled::Interpolated(_))
    }

    /// Reads, converts and checks the maps of a view.
    pub(crate) fn maps(&self, index: usize) -> anyhow::Result<(ViewMaps, Outcome)> {
        let (camera, params) = (&self.capture.views[index].camera, self.params);
        let mut outcome = Outcome::default();
        let mut maps = ViewMaps::default();
        if let Some(file) = &self.found.depth[index] {
            let path = &file.path;
            if file.is_png() && !params.depth.kind.is_relative() && params.depth.units_per_value.is_none() {
                let hint = "set depth.units_per_value, e.g. 0.001 for millimetres in a scene in metres";
                return Err(bad_input("integer depth without a scale").hint(hint).at(path).into());
            }
            let (values, _) = fit_to_view(file.read()?, &camera.intrinsics, path)?;
            let (map, fit) = depth::depth_view(&values, camera, &params.depth, self.points.as_ref(), path)?;
            (maps.depth, outcome.fit) = (Some(map), fit);
        } else {
            maps.depth = match &self.filled {
                Filled::None => None,
                Filled::Own => self.capture.load_depth(&self.capture.views[index])?,
                Filled::Interpolated(points) => from_points::depth_view(points, camera),
            };
        }
        if let (Some(file), Some(values)) = (&self.found.normals[index], self.stored(Still::Normals, index)?) {
            maps.normals = Some(normals::normals_view(&values, camera, &params.normals, file.is_png(), &file.path)?);
        }
        if let Some(file) = &self.found.flow_forward[index] {
            maps.flow = self.flow(index, Some(file), &mut outcome)?;
        } else if self.found.tracks.is_some() {
            maps.flow = self.flow(index, None, &mut outcome)?;
        }
        Ok((maps, outcome))
    }

    /// The flow of a view from the file of the view `file`, and the view where it leads; none without such a file, or if either
    /// is not a training view.
    pub(crate) fn flow_of(
        &self,
        direction: Direction,
        index: usize,
        file: usize,
    ) -> anyhow::Result<Option<(FlowMap, &View)>> {
        let view = &self.capture.views[index];
        let stride = i64::from(self.params.flow.stride);
        let (files, step) = match direction {
            Direction::Forward => (&self.found.flow_forward, stride),
            Direction::Backward => (&self.found.flow_backward, -stride),
        };
        let to = self.videos.after(view, step).map(|to| &self.capture.views[to]);
        let (Some(to), Some(file)) = (to, files[file].as_ref()) else { return Ok(None) };
        if [view, to].iter().any(|view| view.split != Split::Train) {
            return Ok(None);
        }
        let (values, scale) = fit_to_view(file.read()?, &view.camera.intrinsics, &file.path)?;
        Ok(Some((flow::flow_map(&values, scale), to)))
    }

    /// The misfit of the depth in the file of the view `file` with the points in the view `index`, if both exist.
    pub(crate) fn depth_misfit(&self, index: usize, file: usize) -> anyhow::Result<Option<f64>> {
        let camera = &self.capture.views[index].camera;
        let (Some(points), Some(file)) = (&self.points, &self.found.depth[file]) else { return Ok(None) };
        let (values, _) = fit_to_view(file.read()?, &camera.intrinsics, &file.path)?;
        Ok(depth::misfit(&values, camera, &self.params.depth, points)?)
    }

    /// Whether depth can be compared with the points of the capture.
    pub(crate) fn has_points(&self) -> bool {
        self.points.is_some()
    }

    /// The map of a view as stored, at the size of the view.
    pub(crate) fn stored(&self, kind: Still, index: usize) -> anyhow::Result<Option<FloatImage>> {
        let files = match kind {
            Still::Depth => &self.found.depth,
            Still::Normals => &self.found.normals,
        };
        let Some(file) = &files[index] else { return Ok(None) };
        Ok(Some(fit_to_view(file.read()?, &self.capture.views[index].camera.intrinsics, &file.path)?.0))
    }

    /// The capture that the files belong to.
    pub(crate) fn capture(&self) -> &Capture {
        self.capture
    }

    /// The flow from a training view to a later training view of the same video. Flow from or to any other view is
    /// dropped, because it was estimated from an image that training must not see.
    fn flow(&self, index: usize, file: Option<&MapFile>, outcome: &mut Outcome) -> anyhow::Result<Option<FlowPrior>> {
        let view = &self.capture.views[index];
        let to = self.videos.after(view, self.params.flow.stride.into());
        let is_training = |at: &usize| self.capture.views[*at].split == Split::Train;
        let Some(to) = to.filter(is_training).filter(|_| view.split == Split::Train) else {
            outcome.flow_leads_nowhere = file.is_some();
            return Ok(None);
        };
        let read = |file: &MapFile| -> scene::Result<FlowMap> {
            let (values, scale) = fit_to_view(file.read()?, &view.camera.intrinsics, &file.path)?;
            Ok(flow::flow_map(&values, scale))
        };
        let forward = match (file, &self.found.tracks) {
            (Some(file), _) => read(file)?,
            (None, Some(tracks)) => tracks.flow(view, &self.capture.views[to]),
            (None, None) => return Ok(None),
        };
        if flow::known_share(&forward) == 0.0 {
            let Some(file) = file else { return Ok(None) };
            return Err(bad_input("the flow map has no value").at(&file.path).into());
        }
        outcome.flow_is_zero = forward.flow_px.iter().all(|flow| *flow == [0.0; 2]);
        let backward = self.found.flow_backward[to].as_ref().map(read).transpose()?;
        let map = flow::consistent(&forward, backward.as_ref(), &self.params.flow);
        outcome.flow_kept = Some(flow::known_share(&map));
        let target = &self.capture.views[to];
        Ok(Some(FlowPrior { map, camera_to: target.camera, time_to_secs: target.time_secs, view_to: Some(to) }))
    }
}

impl Found {
    fn find(dir: &Path, capture: &Capture, params: &Params, videos: &Videos) -> anyhow::Result<Self> {
        let mut unused = 0;
        let mut files = |kind: MapKind, name: &str, needs: &dyn Fn(&View) -> bool| -> anyhow::Result<Vec<_>> {
            let folder = ViewFolder::open(&dir.join(name), &formats::EXTENSIONS)?.filter(|_| params.wants(kind));
            let Some(folder) = folder else { return Ok(vec![None; capture.views.len()]) };
            let (content, ends) = match name {
                DEPTH => (Content::Depth, [0, 0]),
                NORMALS => (Content::Normals, [0, 0]),
                FLOW_FORWARD => (Content::Flow, [0, params.flow.stride]),
                _ => (Content::Flow, [params.flow.stride; 2]),
            };
            let is_required = |view: &View| view.split == Split::Train && !params.allow_missing && needs(view);
            let found = MapFiles::find(&folder, content, capture, params.naming, ends, is_required)?;
            unused += found.unused;
            Ok(found.files)
        };
        let stride = i64::from(params.flow.stride);
        let is_training = |at: Option<usize>| at.is_some_and(|at| capture.views[at].split == Split::Train);
        let depth = files(MapKind::Depth, DEPTH, &|_| true)?;
        let normals = files(MapKind::Normals, NORMALS, &|_| true)?;
        let flow_forward = files(MapKind::Flow, FLOW_FORWARD, &|view| is_training(videos.after(view, stride)))?;
        let flow_backward = files(MapKind::Flow, FLOW_BACKWARD, &|view| is_training(videos.after(view, -stride)))?;
        let wants_tracks = params.wants(MapKind::Flow) && flow_forward.iter().all(Option::is_none);
        let tracks = if wants_tracks { Tracks::find(&dir.join(TRACKS), capture, &params.flow)? } else { None };
        Ok(Self { depth, flow_forward, flow_backward, normals, tracks, unused })
    }

    /// Fails if a kind of maps that the recipe names is missing, or if there are no maps at all.
    fn check(&self, dir: &Path, params: &Params) -> Result<(), Failure> {
        let missing = |message: &str| Failure::new(FailureKind::MissingData, message);
        let kinds = [
            (MapKind::Depth, DEPTH, &self.depth, params.fill_depth),
            (MapKind::Flow, FLOW_FORWARD, &self.flow_forward, self.tracks.is_some()),
            (MapKind::Normals, NORMALS, &self.normals, false),
        ];
        for (kind, name, files, has_other_source) in kinds {
            if params.maps.contains(&kind) && files.iter().all(Option::is_none) && !has_other_source {
                return Err(missing("no maps of a kind that the recipe requests").at(dir.join(name)));
            }
        }
        if self.tracks.is_none() && kinds.iter().all(|(_, _, files, _)| files.iter().all(Option::is_none)) {
            let hint = format!(
                "maps belong in the subfolders {DEPTH}, {FLOW_FORWARD}, {FLOW_BACKWARD} and {NORMALS}, tracks in {TRACKS}"
            );
            return Err(missing("no maps in this folder").hint(hint).at(dir));
        }
        Ok(())
    }
}

fn bad_input(message: &str) -> Failure {
    Failure::new(FailureKind::BadInput, message)
}
