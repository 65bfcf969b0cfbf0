//! Maps that estimators wrote into a folder.

use std::path::Path;

use engine::{Failure, FailureKind};
use scene::{Capture, FlowMap, PointCloud, Split, View};

use crate::alignment::Fit;
use crate::folder::{ViewFolder, bad};
use crate::formats::{self, Content};
use crate::params::{Alignment, DepthKind, MapKind};
use crate::{FlowPrior, Params, Videos, ViewMaps, depth, flow, normals, raster};

/// The sub-folder of depth maps.
pub const DEPTH: &str = "depth";
/// Flow to a later frame, under the name of the earlier one.
pub const FLOW_FORWARD: &str = "flow_fwd";
/// Flow to an earlier frame, under the name of the later one.
const FLOW_BACKWARD: &str = "flow_bwd";
/// Normals.
pub const NORMALS: &str = "normal";

/// The files of a folder, matched with the views of a capture.
pub struct Files<'a> {
    capture: &'a Capture,
    params: &'a Params,
    videos: Videos,
    points: Option<PointCloud>,
    depth: Vec<Option<std::path::PathBuf>>,
    flow_forward: Vec<Option<std::path::PathBuf>>,
    flow_backward: Vec<Option<std::path::PathBuf>>,
    normals: Vec<Option<std::path::PathBuf>>,
    /// Files that belong to no view.
    pub unused: usize,
}

/// What happened to one view.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// How depth was aligned.
    pub fit: Option<Fit>,
    /// Share of the flow that is believed.
    pub flow_kept: Option<f64>,
    /// There is flow, but it leads to no training view.
    pub flow_leads_nowhere: bool,
    /// The flow is zero everywhere.
    pub flow_is_zero: bool,
}

impl<'a> Files<'a> {
    /// Finds the files in `dir`. Every training view must have every kind of map that some view has, unless missing ones
    /// are allowed; kinds that the recipe names must be there.
    pub fn find(dir: &Path, capture: &'a Capture, params: &'a Params) -> anyhow::Result<Self> {
        if !dir.is_dir() {
            let hint = "is --data-root right, and are the maps there?";
            return Err(Failure::new(FailureKind::MissingData, "no such folder of maps").hint(hint).at(dir).into());
        }
        let videos = Videos::of(capture);
        let mut unused = 0;
        let mut files = |kind: MapKind, name: &str, needs: &dyn Fn(&View) -> bool| -> anyhow::Result<Vec<_>> {
            let folder = ViewFolder::open(&dir.join(name), &formats::EXTENSIONS)?.filter(|_| params.wants(kind));
            let Some(folder) = folder else { return Ok(vec![None; capture.views.len()]) };
            let (found, more) =
                folder.of_views(capture, |view| view.split == Split::Train && !params.allow_missing && needs(view))?;
            unused += more;
            Ok(found.into_iter().map(|path| path.map(Path::to_path_buf)).collect())
        };
        let stride = i64::from(params.flow.stride);
        let is_training = |at: Option<usize>| at.is_some_and(|at| capture.views[at].split == Split::Train);
        let leads_on = |view: &View| is_training(videos.after(view, stride));
        let depth = files(MapKind::Depth, DEPTH, &|_| true)?;
        let normals = files(MapKind::Normals, NORMALS, &|_| true)?;
        let flow_forward = files(MapKind::Flow, FLOW_FORWARD, &leads_on)?;
        let flow_backward = files(MapKind::Flow, FLOW_BACKWARD, &|view| is_training(videos.after(view, -stride)))?;
        for (kind, name, files) in [
            (MapKind::Depth, DEPTH, &depth),
            (MapKind::Flow, FLOW_FORWARD, &flow_forward),
            (MapKind::Normals, NORMALS, &normals),
        ] {
            if params.maps.contains(&kind) && files.iter().all(Option::is_none) {
                let failure = Failure::new(FailureKind::MissingData, "no map of a kind that the recipe names");
                return Err(failure.at(dir.join(name)).into());
            }
        }
        if [&depth, &flow_forward, &normals].iter().all(|files| files.iter().all(Option::is_none)) {
            let hint = format!("maps lie in the folders {DEPTH}, {FLOW_FORWARD}, {FLOW_BACKWARD} and {NORMALS}");
            return Err(Failure::new(FailureKind::MissingData, "no maps here").hint(hint).at(dir).into());
        }
        let aligns = params.depth.alignment() != Alignment::None && depth.iter().any(Option::is_some);
        let points = if aligns { capture.load_points()? } else { None };
        Ok(Self { capture, params, videos, points, depth, flow_forward, flow_backward, normals, unused })
    }

    /// The maps of a view, and what happened to them.
    pub fn maps(&self, index: usize) -> anyhow::Result<(ViewMaps, Outcome)> {
        let (camera, params) = (&self.capture.views[index].camera, self.params);
        let mut outcome = Outcome::default();
        let mut maps = ViewMaps::default();
        if let Some(path) = &self.depth[index] {
            let is_png = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
            if is_png && params.depth.kind != DepthKind::InverseDepth && params.depth.units_per_value.is_none() {
                let hint = "set depth.units_per_value, as 0.001 for millimetres in a scene in metres";
                return Err(bad("integer depth without a scale").hint(hint).at(path).into());
            }
            let (values, _) = raster::fitted(formats::read(path, Content::Depth)?, &camera.intrinsics, path)?;
            let (map, fit) = depth::depth_view(&values, camera, &params.depth, self.points.as_ref(), path)?;
            (maps.depth, outcome.fit) = (Some(map), fit);
        }
        if let Some(path) = &self.normals[index] {
            let is_png = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
            let (values, _) = raster::fitted(formats::read(path, Content::Normals)?, &camera.intrinsics, path)?;
            maps.normals = Some(normals::normals_view(&values, camera, &params.normals, is_png, path)?);
        }
        if let Some(path) = &self.flow_forward[index] {
            maps.flow = self.flow(index, path, &mut outcome)?;
        }
        Ok((maps, outcome))
    }

    /// The flow of a training view to a later training view of the same video. Flow from or to other views was estimated
    /// from images that training must not know.
    fn flow(&self, index: usize, path: &Path, outcome: &mut Outcome) -> anyhow::Result<Option<FlowPrior>> {
        let view = &self.capture.views[index];
        let to = self.videos.after(view, self.params.flow.stride.into());
        let is_training = |at: &usize| self.capture.views[*at].split == Split::Train;
        let Some(to) = to.filter(is_training).filter(|_| view.split == Split::Train) else {
            outcome.flow_leads_nowhere = true;
            return Ok(None);
        };
        let read = |path: &Path| -> scene::Result<FlowMap> {
            let (values, scale) = raster::fitted(formats::read(path, Content::Flow)?, &view.camera.intrinsics, path)?;
            Ok(flow::flow_map(&values, scale))
        };
        let forward = read(path)?;
        if flow::known_share(&forward) == 0.0 {
            return Err(bad("a flow map without any value").at(path).into());
        }
        outcome.flow_is_zero = forward.flow_px.iter().all(|flow| *flow == [0.0; 2]);
        let backward = self.flow_backward[to].as_deref().map(read).transpose()?;
        let map = flow::believed(&forward, backward.as_ref(), &self.params.flow);
        outcome.flow_kept = Some(flow::known_share(&map));
        let target = &self.capture.views[to];
        Ok(Some(FlowPrior { map, camera_to: target.camera, time_to_secs: target.time_secs, view_to: Some(to) }))
    }
}
