#![doc = include_str!("../README.md")]

mod colmap;
mod digest;
mod error;
mod estimators;
mod event;
mod frames;
mod manifest;
mod masks;
mod masks_folder;
mod process;
mod request;
mod steps;
mod tools;

#[cfg(test)]
mod tests;

pub use event::Event;
pub use request::{CameraModel, Matcher, Request};

use std::path::{Path, PathBuf};

use engine::Failure;

use crate::error::bad;
use crate::estimators::{Estimator, Kind};
use crate::request::COLMAP_STEPS;
use crate::steps::Steps;

/// A prepared capture.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The folder of the capture, as an absolute path.
    pub dir: PathBuf,
    /// Names of the steps that ran, in their order; empty if every result was kept.
    pub executed: Vec<String>,
    /// Number of images with a pose, if poses were estimated.
    pub registered: Option<usize>,
}

/// Measures the factor between the sizes of the parts of the COLMAP model in a folder, if the model lost its scale. A parameter,
/// because another crate reads models.
pub type LostScale<'a> = &'a dyn Fn(&Path) -> Option<f64>;

/// Turns a video or a folder of images into a capture that `sfm-import` reads: frames, masks, poses, and the maps of
/// estimators. Steps whose inputs, commands and tools have not changed keep their results. Reports every step to `report`.
///
/// # Errors
///
/// Missing tools, with what to install; inputs that are neither a video nor images or masks; a tool that fails, with the end of
/// its log; and too few images with a pose.
pub fn prepare(
    request: &Request,
    lost_scale: LostScale<'_>,
    report: &mut dyn FnMut(&Event),
) -> Result<Prepared, Failure> {
    request.check_paths()?;
    let estimators = request.estimators.as_deref().map(estimators::read).transpose()?.unwrap_or_default();
    let names = step_names(&estimators);
    request.check(&names)?;
    if request.masks.is_some() {
        estimators::refuse_masks(&estimators)?;
    }
    let mut steps = Steps::open(request, report)?;
    let last = request.until.clone().unwrap_or_else(|| names[names.len() - 1].clone());
    let mut registered = None;
    let mut fps = None;
    for name in &names {
        match name.as_str() {
            "frames" => fps = frames::frames(&mut steps, request)?,
            "masks" => masks_folder::masks(&mut steps, request)?,
            "features" => colmap::features(&mut steps, request, &estimators)?,
            "matches" => colmap::matches(&mut steps, request)?,
            "mapping" => registered = Some(colmap::mapping(&mut steps, lost_scale)?),
            _ => estimators::run(&mut steps, named(&estimators, name))?,
        }
        if *name == last {
            break;
        }
    }
    steps.finish(fps, estimators::imports(&estimators))?;
    Ok(Prepared { dir: steps.dir.clone(), executed: steps.executed, registered })
}

/// The steps in their order: estimators of masks run before the poses, which need the masks.
fn step_names(estimators: &[Estimator]) -> Vec<String> {
    let of_kind = |is_mask: bool| {
        let chosen = estimators.iter().filter(move |estimator| (estimator.kind == Kind::Masks) == is_mask);
        chosen.map(|estimator| estimator.name.clone())
    };
    let frames = ["frames".to_owned()].into_iter();
    let before = frames.chain(of_kind(true)).chain(["masks".into()]);
    before.chain(COLMAP_STEPS.map(String::from)).chain(of_kind(false)).collect()
}

fn named<'a>(estimators: &'a [Estimator], name: &str) -> &'a Estimator {
    estimators.iter().find(|estimator| estimator.name == name).expect("every other step is an estimator")
}

/// Checks that the names of steps exist.
fn check_steps<'a>(wanted: impl Iterator<Item = &'a String>, known: &[String]) -> Result<(), Failure> {
    match wanted.into_iter().find(|name| !known.contains(name)) {
        Some(name) => {
            Err(bad(format!("there is no step {name:?}")).hint(format!("the steps are {}", known.join(", "))))
        }
        None => Ok(()),
    }
}
