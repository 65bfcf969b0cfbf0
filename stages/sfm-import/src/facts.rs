//! Static facts about a capture before its import, from its files without decoding an image.

use std::collections::BTreeSet;
use std::path::Path;

use captures::with_sizes;
use engine::{Facts, Work};
use scene::{Split, facts};

use crate::error::{Result, bad};
use crate::params::{Format, Params};
use crate::recognise::{read_views, recognise};
use crate::source::{Frame, SourceCapture};

/// Static facts about the capture in `dir`. COLMAP models are not read, because their points can take seconds.
pub(crate) fn of_capture(dir: &Path, params: &Params) -> Facts {
    let absent = [facts::FLOW, facts::NORMALS, facts::VELOCITY];
    let known = absent.iter().fold(Facts::default(), |known, map| known.with(map, false));
    let known = if params.is_static() { with_times(known, 1) } else { known };
    let may_have_depth = matches!(
        recognise(dir, params.format),
        Ok(Format::Blender
            | Format::Nerfstudio
            | Format::Tum
            | Format::ScanNet
            | Format::Vggt
            | Format::MegaSam
            | Format::Monst3r)
    );
    let known = if may_have_depth { known } else { known.with(facts::DEPTH, false) };
    let Some(capture) = listed(dir, params) else { return known };
    let training = || capture.frames.iter().filter(|frame| frame.split == Split::Train);
    let times: BTreeSet<u64> = training().map(|frame| frame.time_secs.to_bits()).collect();
    let known = with_view_sizes(known, &capture, params);
    let known = capture.has_cloud().map_or(known.clone(), |points| known.with(facts::POINTS, points));
    with_times(known, times.len())
        .with(facts::DEPTH, training().any(|frame| frame.depth.is_some()))
        .with(facts::MASKS, training().any(|frame| frame.mask.is_some()))
}

/// The stored size of the images, if the files that list them state it. The import checks it for all images.
pub(crate) fn native_size(dir: &Path, params: &Params) -> Option<(u32, u32)> {
    let first = listed(dir, params)?.frames.into_iter().next()?;
    Some((first.lens.intrinsics.width, first.lens.intrinsics.height))
}

/// The capture, if its files can be read quickly; problems with them are reported by the import.
fn listed(dir: &Path, params: &Params) -> Option<SourceCapture> {
    let format = recognise(dir, params.format).ok()?;
    let is_quick = !matches!(format, Format::Auto | Format::Colmap);
    if is_quick { read_views(dir, params).ok() } else { None }
}

/// Adds the size of the imported images and the numbers of views.
fn with_view_sizes(known: Facts, capture: &SourceCapture, params: &Params) -> Facts {
    let Some(first) = capture.frames.first() else { return known };
    let native = (first.lens.intrinsics.width, first.lens.intrinsics.height);
    let views = [Split::Train, Split::Val, Split::Test]
        .map(|split| capture.frames.iter().filter(|frame| frame.split == split).count());
    // A width that is refused is reported elsewhere.
    target_size(native, params.width).map_or(known.clone(), |size| with_sizes(known, size, views))
}

/// The output size for `width`; images are never enlarged.
pub(crate) fn target_size(native: (u32, u32), width: Option<u32>) -> Result<(u32, u32)> {
    let Some(width) = width else { return Ok(native) };
    if width > native.0 {
        let message = format!("width = {width} would enlarge images of {}×{} pixels", native.0, native.1);
        return Err(bad(message).hint(format!("use at most {}, or omit width", native.0)));
    }
    let height = (f64::from(native.1) * f64::from(width) / f64::from(native.0)).round().max(1.0);
    Ok((width, height as u32))
}

/// The pixels that the import decodes.
pub(crate) fn work(dir: &Path, params: &Params) -> Option<Work> {
    let capture = listed(dir, params)?;
    let pixels = |frame: &Frame| f64::from(frame.lens.intrinsics.width) * f64::from(frame.lens.intrinsics.height);
    Work::of(capture.format.name(), capture.frames.iter().map(pixels).sum())
}

/// Adds the number of times. A single instant has no motion.
fn with_times(known: Facts, times: usize) -> Facts {
    let known = known.with(facts::TIMES, times);
    if times > 1 { known } else { known.with(facts::MOVING, false) }
}

#[cfg(test)]
mod tests {
    use engine::{PlanContext, Stage as _};

    use super::*;
    use crate::SfmImport;
    use crate::tests::support::{Workspace, blender_scene, colmap_params};

    #[test]
    fn blender_files_state_times_and_points() {
        let dir = blender_scene();
        let known = of_capture(dir.path(), &Params::default());
        assert_eq!(known.count(facts::TIMES), Some(5));
        assert_eq!((known.flag(facts::POINTS), known.flag(facts::MASKS)), (Some(false), Some(false)));
        assert_eq!((known.flag(facts::MOVING), known.flag(facts::VIEW_DEPENDENT)), (None, None));
        let limited = of_capture(dir.path(), &Params { train_limit: Some(1), ..Params::default() });
        assert_eq!((limited.count(facts::TIMES), limited.flag(facts::MOVING)), (Some(1), Some(false)));
    }

    #[test]
    fn a_width_that_enlarges_images_is_refused_while_planning() {
        let dir = blender_scene();
        let context = PlanContext { data_root: dir.path(), inputs: Default::default() };
        let of_width = |width| Params { source: ".".into(), width, ..Params::default() };
        let problems = SfmImport::resolve(of_width(Some(25)), &context).unwrap_err();
        assert_eq!(problems[0].key, "width");
        assert_eq!(problems[0].message, "width = 25 would enlarge images of 24×16 pixels");
        assert!([Some(24), None].into_iter().all(|width| SfmImport::resolve(of_width(width), &context).is_ok()));
        let params = Params { source: "scene".into(), ..of_width(Some(1_000_000)) };
        assert_eq!(params.problems()[0].message, "must be at most 16384 pixels");
    }

    #[test]
    fn missing_and_slow_files_leave_facts_unknown() {
        let nowhere = of_capture(Path::new("nowhere"), &Params::default());
        assert_eq!((nowhere.count(facts::TIMES), nowhere.flag(facts::DEPTH)), (None, Some(false)));
        let dir = Workspace::video(4).write();
        assert_eq!(of_capture(dir.path(), &colmap_params()).count(facts::TIMES), None);
        let static_scene = Params { static_scene: Some(true), ..colmap_params() };
        assert_eq!(of_capture(dir.path(), &static_scene).flag(facts::MOVING), Some(false));
    }
}
