//! The training views in memory, and the facts of the scene that methods may read.

use std::collections::BTreeSet;

use engine::{Facts, Failure, FailureKind};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use scene::cloud::PointCloud;
use scene::statistics::median;
use scene::{Capture, Split, TimeMap, View, facts};
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Real, Tensor};

use crate::shared::{InitialPoints, PointSource};

/// Distance from a camera, in median distances, beyond which points are errors: in single precision, squares of longer
/// distances would overflow, and the positions of all points would be too coarse.
const MAX_DISTANCE: f64 = 1e6;

/// Values per parallel chunk of an image that is converted: tens of microseconds.
const VALUES_PER_CHUNK: usize = 1 << 16;

/// A capture's training views, and the few views on which the quality curve is measured.
pub struct Dataset {
    /// The capture.
    pub capture: Capture,
    /// Facts of the scene for methods.
    pub(crate) scene: SceneFacts,
    /// All training views, in the capture's order.
    pub train: Vec<LoadedView>,
    /// Evenly chosen validation views, or training views if the capture has no validation views.
    pub curve: Vec<LoadedView>,
    /// The split of [`Dataset::curve`].
    pub curve_split: Split,
}

/// The facts of a scene that methods may read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SceneFacts {
    /// The size of the scene ([`scene::SceneScale::extent`]), scene units.
    pub extent: f64,
    /// Factor on published constants in scene units ([`scene::SceneScale::unit`]).
    pub unit_world: f64,
    /// Maps seconds of the capture to the normalised time in [0, 1].
    pub time_map: TimeMap,
    /// The colour behind the Gaussians, in [0, 1].
    pub background: [f32; 3],
    /// Number of distinct times among the training views.
    pub time_count: usize,
}

impl SceneFacts {
    /// The size of the scene in units of published constants: the factor on published learning rates of values that are
    /// not lengths but whose published rates follow the size of the scene.
    pub(crate) fn relative_extent(&self) -> f64 {
        self.extent / self.unit_world
    }

    /// The number of intervals between the training frames of the clip, at least 1.
    pub(crate) fn training_intervals(&self) -> f64 {
        self.time_count.saturating_sub(1).max(1) as f64
    }

    /// The mean interval between training frames in normalised time.
    pub(crate) fn training_interval(&self) -> f64 {
        1.0 / self.training_intervals()
    }
}

/// One training view in the working precision.
#[derive(Clone, Debug)]
pub(crate) struct TrainingView<T: Real> {
    /// Index within the capture's views.
    pub index: usize,
    /// Intrinsics and pose.
    pub camera: PinholeCamera,
    /// Normalised time in [0, 1].
    pub time: f64,
    /// The factor by which the image is reduced (the effect `coarse-to-fine`); 1 for the full size.
    pub reduction: usize,
    /// The image [H, W, 3] in [0, 1].
    pub image: Tensor<T>,
}

/// One view with its 8-bit image.
pub struct LoadedView {
    /// Index within the capture's views.
    pub index: usize,
    /// Intrinsics and pose.
    pub camera: PinholeCamera,
    /// Normalised time in [0, 1].
    pub time: f64,
    /// The image [H, W, 3], 8-bit sRGB.
    pub pixels: Vec<u8>,
}

impl Dataset {
    /// Reads every training view and `curve_views` views for the curve; the images stay in memory with 8 bits per
    /// value.
    pub fn load(capture: Capture, curve_views: usize) -> anyhow::Result<Self> {
        let train_views: Vec<_> = capture.views_of(Split::Train).collect();
        if train_views.is_empty() {
            let failure =
                Failure::new(FailureKind::BadInput, format!("capture {} has no training views", capture.name));
            return Err(failure.at(&capture.dir).into());
        }
        let has_val = capture.views_of(Split::Val).next().is_some();
        let curve_split = if has_val { Split::Val } else { Split::Train };
        let curve_candidates: Vec<_> = capture.views_of(curve_split).collect();
        let scale = capture.scale();
        let scene = SceneFacts {
            extent: scale.extent,
            unit_world: scale.unit,
            time_map: capture.time_map,
            background: capture.background,
            time_count: time_count(&capture),
        };
        let train = load_all(&capture, &train_views)?;
        let curve = load_all(&capture, &evenly(&curve_candidates, curve_views))?;
        Ok(Self { scene, train, curve, curve_split, capture })
    }

    /// The training view with an index of the capture, e.g. that of a view that a step has drawn.
    pub(crate) fn training_view(&self, index: usize) -> &LoadedView {
        self.train.iter().find(|loaded| loaded.index == index).expect("steps draw training views")
    }

    /// The points of the first Gaussians; random ones are drawn in the capture's bounds. The capture's points lack those
    /// at absurd distances ([`MAX_DISTANCE`]).
    pub(crate) fn initial_points(&self, params: &InitialPoints, seed: u64) -> anyhow::Result<PointCloud> {
        let stored = match params.from {
            PointSource::Random => None,
            PointSource::Auto | PointSource::Capture => self.capture.load_points()?,
        };
        let bad = |message: String, hint: &str| Failure::new(FailureKind::BadInput, message).hint(hint);
        match (stored, params.from, self.capture.bounds_world) {
            (Some(points), ..) if !points.is_empty() => {
                let (_, view) = self.capture.views_of(Split::Train).next().expect("a capture has training views");
                Ok(thinned(without_absurd(points, view.camera.position_world()), params.max_count))
            }
            (_, PointSource::Capture, _) => {
                let message = format!("capture {} has no points", self.capture.name);
                Err(bad(message, "set initial_points.from = \"random\"").into())
            }
            (_, _, Some(bounds)) => Ok(PointCloud::random_in(bounds, params.random_count, seed)),
            (_, _, None) => {
                let message = format!("capture {} has neither points nor bounds to draw them in", self.capture.name);
                Err(bad(message, "import it with a point cloud").into())
            }
        }
    }
}

/// Static facts of a capture ([`scene::facts`]), without reading its images.
pub(crate) fn facts_of(capture: &Capture) -> Facts {
    let times = time_count(capture);
    let known = Facts::default().with(facts::TIMES, times);
    // A single time has no motion. With several times, motion is unknown until the images are read.
    if times > 1 { known } else { known.with(facts::MOVING, false) }
}

/// Number of distinct times among the training views.
fn time_count(capture: &Capture) -> usize {
    capture.views_of(Split::Train).map(|(_, view)| view.time_secs.to_bits()).collect::<BTreeSet<u64>>().len()
}

impl LoadedView {
    /// The view in working precision.
    pub(crate) fn to_training<T: Real>(&self) -> TrainingView<T> {
        self.with_image(self.image())
    }

    /// The image [H, W, 3] in working precision, in [0, 1].
    pub(crate) fn image<T: Real>(&self) -> Tensor<T> {
        let levels: Vec<T> = (0..=255).map(|level| T::from_f64(f64::from(level) / 255.0)).collect();
        let pixels = self.pixels.par_iter().with_min_len(VALUES_PER_CHUNK);
        let values = pixels.map(|&value| levels[usize::from(value)]).collect();
        Tensor::from_vec([self.camera.height, self.camera.width, 3], values)
    }

    /// The view with its image in working precision, from [`LoadedView::image`].
    pub(crate) fn with_image<T: Real>(&self, image: Tensor<T>) -> TrainingView<T> {
        TrainingView { index: self.index, camera: self.camera, time: self.time, reduction: 1, image }
    }
}

/// `count` of the items (all if there are fewer), evenly spread, first and last included.
fn evenly<V: Clone>(items: &[V], count: usize) -> Vec<V> {
    let count = count.min(items.len());
    let last = items.len().saturating_sub(1);
    (0..count).map(|at| items[if count > 1 { at * last / (count - 1) } else { last / 2 }].clone()).collect()
}

/// At most `max_count` of the items, evenly chosen, in order.
pub(crate) fn evenly_thinned<V: Copy>(items: Vec<V>, max_count: usize) -> Vec<V> {
    let count = items.len();
    if count <= max_count { items } else { (0..max_count).map(|at| items[at * count / max_count]).collect() }
}

/// The points (at least one) without those farther from a camera than [`MAX_DISTANCE`] median distances.
fn without_absurd(points: PointCloud, camera_world: DVec3) -> PointCloud {
    let distance = |point: &[f32; 3]| Vec3::from(*point).as_dvec3().distance(camera_world);
    let limit = MAX_DISTANCE * median(points.positions.iter().map(distance)).expect("at least one point");
    if limit == 0.0 || !points.positions.iter().any(|point| distance(point) > limit) {
        return points;
    }
    let PointCloud { positions, colors } = points;
    let (positions, colors) = positions.into_iter().zip(colors).filter(|(point, _)| distance(point) <= limit).unzip();
    PointCloud { positions, colors }
}

/// At most `max_count` points, evenly chosen.
fn thinned(points: PointCloud, max_count: usize) -> PointCloud {
    let PointCloud { positions, colors } = points;
    PointCloud { positions: evenly_thinned(positions, max_count), colors: evenly_thinned(colors, max_count) }
}

fn load_all(capture: &Capture, views: &[(usize, &View)]) -> anyhow::Result<Vec<LoadedView>> {
    let load = |&(index, view): &(usize, &View)| {
        let pixels = capture.load_image(view)?.into_raw();
        let time = capture.time_map.normalized(view.time_secs);
        Ok(LoadedView { index, camera: PinholeCamera::from(&view.camera), time, pixels })
    };
    views.par_iter().map(load).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_choice_includes_both_ends_and_never_repeats() {
        let items: Vec<usize> = (0..20).collect();
        assert_eq!(evenly(&items, 5), [0, 4, 9, 14, 19]);
        assert_eq!(evenly(&items, 1), [9]);
        assert_eq!(evenly(&items, 100), items);
        assert!(evenly::<usize>(&[], 3).is_empty());
    }

    #[test]
    fn points_at_absurd_distances_are_left_out_with_their_colours() {
        let positions = vec![[1.0, 0.0, 0.0], [0.0, 1e30, 0.0], [0.0, 0.0, 9.0], [2.0, 0.0, 0.0], [1e4, 0.0, 0.0]];
        let points = PointCloud { colors: (0..5).map(|at| [at; 3]).collect(), positions };
        let kept = without_absurd(points.clone(), DVec3::new(0.0, 0.0, -2.0));
        assert_eq!(kept.positions, [0, 2, 3, 4].map(|at| points.positions[at]));
        assert_eq!(kept.colors, [[0; 3], [2; 3], [3; 3], [4; 3]]);
        assert_eq!(without_absurd(kept.clone(), DVec3::ZERO), kept);
        let coincident = PointCloud { positions: vec![[1.0; 3]; 4], colors: vec![[0; 3]; 4] };
        assert_eq!(without_absurd(coincident.clone(), DVec3::ONE), coincident);
    }

    #[test]
    fn thinning_keeps_the_requested_count_and_the_pairs() {
        let points = PointCloud {
            positions: (0..10).map(|at| [at as f32; 3]).collect(),
            colors: (0..10).map(|at| [at as u8; 3]).collect(),
        };
        let thin = thinned(points.clone(), 4);
        assert_eq!(thin.len(), 4);
        assert!(thin.positions.iter().zip(&thin.colors).all(|(position, color)| position[0] == f32::from(color[0])));
        assert_eq!(thinned(points.clone(), 10), points);
    }
}
