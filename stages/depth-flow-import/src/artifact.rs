//! The artifact: depth, flow, normals and velocity of the views of one capture.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use scene::index_file::{self, ViewFiles};
use scene::{Camera, Capture, DepthMap, FlowMap, NormalMap, VelocityMap};
use serde::{Deserialize, Serialize};

/// Name of the index file.
const INDEX_FILE: &str = "priors.json";
/// The end of the source of maps whose depth is interpolated between points.
pub(crate) const SPARSE_POINTS: &str = "sparse-points";
/// What the index describes, for error messages.
const WHAT: &str = "priors";

/// Maps on disk: the index `priors.json` (this structure) and the files that it names.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Priors {
    /// The folder of the artifact; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// The origin of the maps: `capture`, `files`, `sparse-points`, or `files+sparse-points` if files have no depth.
    pub source: String,
    /// One entry per view of the capture, in its order.
    pub views: Vec<PriorView>,
}

/// The maps of one view, as files relative to the artifact's folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorView {
    /// The name of the capture's view.
    pub name: String,
    /// The camera of the view; every map has the size of its image.
    pub camera: Camera,
    /// EXR: view-space z in scene units; 0 where unknown.
    pub depth: Option<PathBuf>,
    /// Optical flow and its target.
    pub flow: Option<FlowRecord>,
    /// EXR: unit normals in the camera's frame (right, down, forward), facing the camera; 0 where unknown.
    pub normals: Option<PathBuf>,
    /// EXR: world velocity of the visible surface in scene units per second.
    pub velocity: Option<PathBuf>,
}

/// Optical flow in a file, with its target; [`FlowPrior`] is the same in memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlowRecord {
    /// EXR: displacement in pixels; NaN where unknown.
    pub map: PathBuf,
    /// The camera at the target.
    pub camera_to: Camera,
    /// The time of the target in seconds.
    pub time_to_secs: f64,
    /// Index of the target view within the views of the capture, if the target is a view.
    pub view_to: Option<usize>,
}

/// Optical flow of one view, with its target.
#[derive(Clone, Debug)]
pub struct FlowPrior {
    /// Displacement in pixels; NaN where unknown or where the forward–backward check failed.
    pub map: FlowMap,
    /// The camera at the target: that of the target view, or this view's own if the flow refers to a static camera.
    pub camera_to: Camera,
    /// The time of the target in seconds.
    pub time_to_secs: f64,
    /// Index of the target view within the views of the capture, if the target is a view.
    pub view_to: Option<usize>,
}

/// The maps of one view in memory.
#[derive(Clone, Debug, Default)]
pub struct ViewMaps {
    /// View-space z in scene units; 0 where unknown.
    pub depth: Option<DepthMap>,
    /// Flow to a later instant.
    pub flow: Option<FlowPrior>,
    /// Unit surface normals in the camera's frame (right, down, forward).
    pub normals: Option<NormalMap>,
    /// World velocity in scene units per second; only synthetic captures have it.
    pub velocity: Option<VelocityMap>,
}

impl Priors {
    /// Whether the depth is only that of the static scene, because it is interpolated between points.
    pub fn depth_is_static(&self) -> bool {
        self.source.ends_with(SPARSE_POINTS)
    }

    /// Reads the depth of a view (an index within the views of the capture), if it has any.
    pub fn load_depth(&self, view: usize) -> scene::Result<Option<DepthMap>> {
        let file = self.views[view].depth.as_deref();
        self.files(view).load(file, DepthMap::read, |map| (map.width, map.height))
    }

    /// Reads the flow of a view (an index within the views of the capture), if it has any.
    pub fn load_flow(&self, view: usize) -> scene::Result<Option<FlowPrior>> {
        let Some(FlowRecord { map, camera_to, time_to_secs, view_to }) = &self.views[view].flow else {
            return Ok(None);
        };
        let map = self.files(view).load(Some(map), FlowMap::read, |map| (map.width, map.height))?;
        let with_target =
            |map| FlowPrior { map, camera_to: *camera_to, time_to_secs: *time_to_secs, view_to: *view_to };
        Ok(map.map(with_target))
    }

    /// Reads the normals of a view (an index within the views of the capture), if it has any.
    pub fn load_normals(&self, view: usize) -> scene::Result<Option<NormalMap>> {
        let file = self.views[view].normals.as_deref();
        self.files(view).load(file, NormalMap::read, |map| (map.width, map.height))
    }

    /// Reads the velocity of a view (an index within the views of the capture), if it has any.
    pub fn load_velocity(&self, view: usize) -> scene::Result<Option<VelocityMap>> {
        let file = self.views[view].velocity.as_deref();
        self.files(view).load(file, VelocityMap::read, |map| (map.width, map.height))
    }

    /// Checks that these maps belong to `capture`: the same views, in the same order, with the same cameras.
    pub fn check_against(&self, capture: &Capture) -> scene::Result<()> {
        capture.check_names(self.views.iter().map(|view| view.name.as_str()))?;
        match self.views.iter().zip(&capture.views).find(|(prior, view)| prior.camera != view.camera) {
            None => Ok(()),
            Some((prior, _)) => {
                Err(scene::Error::new(format!("the camera of view {} differs from that of the priors", prior.name))
                    .hint("they may belong to another capture"))
            }
        }
    }

    /// Writes the maps of one view below `dir` and returns its index entry.
    pub fn write_view(dir: &Path, name: &str, camera: Camera, maps: &ViewMaps) -> scene::Result<PriorView> {
        let write = |kind: &str, write: &dyn Fn(&Path) -> scene::Result<()>| {
            let file = Path::new(kind).join(format!("{name}.exr"));
            index_file::create_dir(&dir.join(kind))?;
            write(&dir.join(&file))?;
            scene::Result::Ok(file)
        };
        let depth = maps.depth.as_ref().map(|map| write("depth", &|path| map.write(path)));
        let normals = maps.normals.as_ref().map(|map| write("normals", &|path| map.write(path)));
        let velocity = maps.velocity.as_ref().map(|map| write("velocity", &|path| map.write(path)));
        let flow = maps.flow.as_ref().map(|flow| {
            let FlowPrior { map, camera_to, time_to_secs, view_to } = flow;
            let map = write("flow", &|path| map.write(path))?;
            scene::Result::Ok(FlowRecord { map, camera_to: *camera_to, time_to_secs: *time_to_secs, view_to: *view_to })
        });
        Ok(PriorView {
            name: name.into(),
            camera,
            depth: depth.transpose()?,
            flow: flow.transpose()?,
            normals: normals.transpose()?,
            velocity: velocity.transpose()?,
        })
    }

    /// Writes the index into `dir`, after the maps of all `views`.
    pub fn save(dir: &Path, source: &str, views: Vec<PriorView>) -> scene::Result<Self> {
        let priors = Self { dir: dir.into(), source: source.into(), views };
        index_file::write(&dir.join(INDEX_FILE), WHAT, &priors)?;
        Ok(priors)
    }

    fn files(&self, view: usize) -> ViewFiles<'_> {
        ViewFiles::of(&self.dir, &self.views[view].camera.intrinsics)
    }

    fn check_view(&self, index: usize) -> anyhow::Result<()> {
        let (files, view) = (self.files(index), &self.views[index]);
        view.camera.check()?;
        let [x, y, z] = &NormalMap::CHANNELS;
        let vectors: &[&[&str]] = &[&[x], &[y], &[z]];
        for file in [&view.normals, &view.velocity].into_iter().flatten() {
            files.check_floats(file, vectors)?;
        }
        if let Some(depth) = &view.depth {
            files.check_floats(depth, &[&DepthMap::CHANNELS])?;
        }
        let Some(flow) = &view.flow else { return Ok(()) };
        let [flow_x, flow_y] = &FlowMap::CHANNELS;
        files.check_floats(&flow.map, &[flow_x, flow_y])?;
        flow.camera_to.check()?;
        ensure!(flow.time_to_secs.is_finite(), "the target time of the flow of view {} is not finite", view.name);
        if let Some(to) = flow.view_to {
            ensure!(
                to != index && to < self.views.len(),
                "the flow of view {} leads to itself or to a missing view, number {to}",
                view.name
            );
            let same_camera = self.views[to].camera == flow.camera_to;
            ensure!(
                same_camera,
                "the flow of view {} leads to {} with a different camera",
                view.name,
                self.views[to].name
            );
        }
        Ok(())
    }
}

impl engine::Artifact for Priors {
    const NAME: &'static str = "priors";
    const SCHEMA: u32 = 1;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        Ok(Self { dir: dir.into(), ..index_file::read(&dir.join(INDEX_FILE), WHAT)? })
    }

    fn check(&self) -> anyhow::Result<()> {
        let any = |view: &PriorView| view.depth.is_some() || view.flow.is_some() || view.normals.is_some();
        ensure!(self.views.iter().any(any), "no view has depth, flow or normals");
        (0..self.views.len()).try_for_each(|view| self.check_view(view))
    }
}

#[cfg(test)]
mod tests {
    use engine::Artifact as _;
    use glam::DVec3;
    use scene::Intrinsics;

    use super::*;

    fn camera(x: f64) -> Camera {
        let intrinsics = Intrinsics { width: 3, height: 2, focal_x: 4.0, focal_y: 4.0, center_x: 1.5, center_y: 1.0 };
        Camera::look_at(intrinsics, DVec3::new(x, -4.0, 0.0), DVec3::ZERO, DVec3::Z)
    }

    fn maps() -> ViewMaps {
        let (width, height) = (3, 2);
        ViewMaps {
            depth: Some(DepthMap { width, height, depth_view: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0] }),
            flow: Some(FlowPrior {
                map: FlowMap {
                    width,
                    height,
                    flow_px: vec![[f32::NAN; 2], [1.0, 2.0], [0.0; 2], [0.0; 2], [0.0; 2], [-1.0; 2]],
                },
                camera_to: camera(1.0),
                time_to_secs: 0.5,
                view_to: Some(1),
            }),
            normals: Some(NormalMap { width, height, normals_view: vec![[0.0, 0.0, -1.0]; 6] }),
            velocity: Some(VelocityMap { width, height, velocity_world: vec![[0.0, 0.5, 0.0]; 6] }),
        }
    }

    fn save(dir: &Path) -> Priors {
        let first = Priors::write_view(dir, "a", camera(0.0), &maps()).unwrap();
        let second = Priors::write_view(dir, "b", camera(1.0), &ViewMaps::default()).unwrap();
        Priors::save(dir, "files", vec![first, second]).unwrap()
    }

    #[test]
    fn saved_priors_read_back() {
        let dir = tempfile::tempdir().unwrap();
        save(dir.path());
        let priors = Priors::open(dir.path()).unwrap();
        priors.check().unwrap();
        assert_eq!(priors.load_depth(0).unwrap(), maps().depth);
        assert_eq!(priors.load_normals(0).unwrap(), maps().normals);
        assert_eq!(priors.load_velocity(0).unwrap(), maps().velocity);
        let flow = priors.load_flow(0).unwrap().unwrap();
        assert!(flow.map.flow_px[0][0].is_nan());
        assert_eq!(flow.map.flow_px[1..], maps().flow.unwrap().map.flow_px[1..]);
        assert_eq!((flow.camera_to, flow.time_to_secs, flow.view_to), (camera(1.0), 0.5, Some(1)));
        assert!(priors.load_depth(1).unwrap().is_none() && priors.load_flow(1).unwrap().is_none());
    }

    #[test]
    fn invalid_flow_targets_and_map_sizes_are_rejected() {
        let dir = tempfile::tempdir().unwrap();
        let priors = save(dir.path());
        let refused = |change: fn(&mut Priors)| {
            let mut changed = priors.clone();
            change(&mut changed);
            changed.check().unwrap_err().to_string()
        };
        assert!(refused(|priors| priors.views[0].flow.as_mut().unwrap().view_to = Some(0)).contains("view, number 0"));
        assert!(refused(|priors| priors.views[0].flow.as_mut().unwrap().view_to = Some(2)).contains("view, number 2"));
        assert!(refused(|priors| priors.views[1].camera = camera(2.0)).contains("a different camera"));
        assert!(refused(|priors| priors.views[0].flow.as_mut().unwrap().time_to_secs = f64::NAN).contains("time"));
        assert!(refused(|priors| priors.views[0].camera.intrinsics.width = 4).contains("normals/a.exr"));
        assert!(refused(|priors| priors.views.truncate(0)).contains("no view has"));
    }
}
