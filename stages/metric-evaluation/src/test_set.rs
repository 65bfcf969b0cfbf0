//! The rendered views of one split, each with its view of the capture.

use std::collections::BTreeMap;
use std::path::Path;

use engine::{Failure, FailureKind};
use rendering::{RenderedView, Renders};
use scene::{Capture, View};

use crate::artifact::empty_set;
use crate::image_file::Image;
use crate::pairs::Pair;
use crate::params::MetricEvaluationParams;

/// The views of a split with their renders, in the order of the capture.
pub(crate) struct TestSet<'a> {
    /// The renders.
    pub(crate) renders: &'a Renders,
    /// The capture with the ground truth.
    pub(crate) capture: &'a Capture,
    /// The rendered views and their views of the capture.
    pub(crate) views: Vec<(&'a RenderedView, &'a View)>,
}

impl<'a> TestSet<'a> {
    /// Pairs every view of the rendered split with its render. No view may be missing, because means are over the split.
    pub(crate) fn new(renders: &'a Renders, capture: &'a Capture) -> Result<Self, Failure> {
        if renders.protocol != capture.protocol {
            let message = format!("the renders belong to another capture: {}", renders.protocol.line());
            let hint = format!("the capture is {}", capture.protocol.line());
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint));
        }
        let mut rendered: BTreeMap<_, _> = renders.views.iter().map(|view| (view.name.as_str(), view)).collect();
        let mut views = Vec::new();
        for (_, view) in capture.views_of(renders.split) {
            let Some(render) = rendered.remove(view.name.as_str()) else {
                let message = format!("view {} of the capture has no render", view.name);
                return Err(Failure::new(FailureKind::BadInput, message).at(&renders.dir));
            };
            views.push((render, view));
        }
        if views.is_empty() {
            return Err(empty_set("split").at(&capture.dir));
        }
        match rendered.keys().next() {
            None => Ok(Self { renders, capture, views }),
            Some(name) => {
                let message = format!("the rendered view {name} is not in this split of the capture");
                Err(Failure::new(FailureKind::BadInput, message).at(&renders.dir))
            }
        }
    }

    /// The image files to compare, in the order of the views.
    pub(crate) fn pairs(&self) -> Vec<Pair> {
        let pair = |(rendered, view): &(&RenderedView, &View)| Pair {
            name: view.name.clone(),
            time_secs: Some(view.time_secs),
            camera_index: Some(view.camera_index),
            render: self.renders.image_path(rendered),
            truth: self.capture.dir.join(&view.image),
        };
        self.views.iter().map(pair).collect()
    }

    /// The quantised render and ground truth of the view at `index`.
    pub(crate) fn images(&self, index: usize, params: &MetricEvaluationParams) -> Result<[Image; 2], Failure> {
        let (rendered, view) = self.views[index];
        let read = |path: &Path| Image::read(path, params.quantise, None);
        Ok([read(&self.renders.image_path(rendered))?, read(&self.capture.dir.join(&view.image))?])
    }

    /// Whether each pixel of a view is transparent in the capture (alpha below ½), i.e. shows no surface; `None` if the
    /// capture has no alpha.
    pub(crate) fn empty_pixels(&self, view: &View) -> scene::Result<Option<Vec<bool>>> {
        let alpha = self.capture.load_alpha(view)?;
        Ok(alpha.map(|alpha| alpha.as_raw().iter().map(|alpha| *alpha < 128).collect()))
    }

    /// Refuses rendered maps whose size differs from that of the view.
    pub(crate) fn check_size(&self, view: &View, found: (u32, u32)) -> Result<(), Failure> {
        let size = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        if found == size {
            return Ok(());
        }
        let message =
            format!("the maps of {} are {}×{} px instead of {}×{}", view.name, found.0, found.1, size.0, size.1);
        Err(Failure::new(FailureKind::BadInput, message).at(&self.renders.dir))
    }
}
