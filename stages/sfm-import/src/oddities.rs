//! Oddities of views, lenses and points that do not prevent an import, but are often errors.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;
use scene::{Intrinsics, RigidTransform, Split, inner_box};

use crate::cloud_file::Points;
use crate::files::{is_turned_by_viewers, name};
use crate::params::Format;
use crate::source::{Frame, SourceCapture};

/// Ratio of the focal lengths of both axes beyond which one is probably wrong: anamorphic lenses have at most 2.
const UNEQUAL: f64 = 2.0;
/// Where an image, as a share of its size, has its principal point; only images cut out of larger ones may have it elsewhere.
const MIDDLE_HALF: std::ops::RangeInclusive<f64> = 0.25..=0.75;
/// Ratio of the sides of an image beyond which the ball that it shows in full is a small part of its view.
const ELONGATED: f64 = 4.0;
/// Distance of a point from the middle of the box of most points, in half diagonals, beyond which it is far from them.
const FAR: f64 = 3.0;
/// Sizes of numbers that need no exponent.
const ORDINARY: std::ops::Range<f64> = 1e-3..1e5;

/// The warning about a capture without test views.
pub(crate) const UNTESTED: &str = "there are no test views: a job that renders them fails, but only after its training; \
    choose test views (every_nth, smaller than the number of views), or render others (split = \"train\" in the node of stage \
    rendering)";

/// The warnings about a capture.
pub(crate) fn warnings(capture: &SourceCapture) -> Vec<String> {
    let of_lenses = [unequal_focal_lengths(&capture.frames), off_center(&capture.frames)];
    of_lenses
        .into_iter()
        .chain([
            untested(&capture.frames),
            repeated_views(&capture.frames),
            turned_images(capture),
            elongated(capture),
            far_points(&capture.points),
        ])
        .flatten()
        .collect()
}

fn untested(frames: &[Frame]) -> Option<String> {
    let is_tested = frames.iter().any(|frame| frame.split == Split::Test);
    (!is_tested).then(|| UNTESTED.into())
}

/// Views with camera, time and image of a view of another split, so that their results are not those of held-out views.
fn repeated_views(frames: &[Frame]) -> Option<String> {
    let place = |frame: &Frame| {
        let RigidTransform { rotation, translation } = frame.camera_from_world;
        let values = rotation.to_cols_array().into_iter().chain(translation.to_array()).chain([frame.time_secs]);
        values.map(f64::to_bits).collect::<Vec<u64>>()
    };
    let mut first_at: BTreeMap<Vec<u64>, &Frame> = BTreeMap::new();
    let mut repeated = frames.iter().filter_map(|frame| {
        let first = *first_at.entry(place(frame)).or_insert(frame);
        (first.split != frame.split && have_one_image(first, frame)).then_some((first, frame))
    });
    let (first, second) = repeated.next()?;
    Some(format!(
        "{} views have camera, time and image of a view of another split, e.g. {} and {}: their results are not those of \
         held-out views; list every view in one split",
        1 + repeated.count(),
        first.name,
        second.name
    ))
}

/// Whether two views have the same image file, or files with the same bytes.
fn have_one_image(a: &Frame, b: &Frame) -> bool {
    let bytes = |frame: &Frame| std::fs::read(&frame.image).ok();
    let has_file = a.stored_image.is_none() && b.stored_image.is_none();
    has_file && (a.image == b.image || bytes(a).is_some_and(|image| Some(image) == bytes(b)))
}

/// The number of views whose lens `is_odd`, and the first of them.
fn odd_views(frames: &[Frame], is_odd: impl Fn(&Intrinsics) -> bool) -> Option<(usize, &Frame)> {
    let mut odd = frames.iter().filter(|frame| is_odd(&frame.lens.intrinsics));
    let first = odd.next()?;
    Some((1 + odd.count(), first))
}

fn unequal_focal_lengths(frames: &[Frame]) -> Option<String> {
    let ratio = |lens: &Intrinsics| lens.focal_x / lens.focal_y;
    let (count, first) = odd_views(frames, |lens| ratio(lens) > UNEQUAL || ratio(lens) < UNEQUAL.recip())?;
    let Intrinsics { focal_x, focal_y, .. } = first.lens.intrinsics;
    Some(format!(
        "the focal lengths of {count} views differ by more than a factor of {UNEQUAL} between x and y, e.g. {focal_x:.1} and {focal_y:.1} \
         px of {}: almost all cameras have square pixels; check both numbers",
        first.name
    ))
}

fn off_center(frames: &[Frame]) -> Option<String> {
    let is_central = |center: f64, pixels: u32| MIDDLE_HALF.contains(&(center / f64::from(pixels)));
    let is_off = |lens: &Intrinsics| !(is_central(lens.center_x, lens.width) && is_central(lens.center_y, lens.height));
    let (count, first) = odd_views(frames, is_off)?;
    let Intrinsics { width, height, center_x, center_y, .. } = first.lens.intrinsics;
    Some(format!(
        "the principal points of {count} views are far from the middle of the images, e.g. ({center_x}, {center_y}) of {} with {width}×{height} \
         pixels: unless the images are cut out of larger ones, state the points in pixels of these images",
        first.name
    ))
}

/// Images that viewers turn. COLMAP finds poses of the pixels as stored; other programs turn them first.
fn turned_images(capture: &SourceCapture) -> Option<String> {
    if capture.format == Format::Colmap {
        return None;
    }
    let is_turned = |frame: &&Frame| frame.stored_image.is_none() && is_turned_by_viewers(&frame.image);
    let turned: Vec<&Frame> = capture.frames.par_iter().filter(is_turned).collect();
    Some(format!(
        "{} images have an EXIF orientation, which is not applied, e.g. {}: if the poses are of upright images, turn the pixels \
         with `mogrify -auto-orient`",
        turned.len(),
        name(&turned.first()?.image)
    ))
}

/// Without a cloud, initial points are drawn in the ball that the cameras see in full.
fn elongated(capture: &SourceCapture) -> Option<String> {
    let Intrinsics { width, height, .. } = capture.frames.first()?.lens.intrinsics;
    let ratio = f64::from(width.max(height)) / f64::from(width.min(height));
    if !(ratio > ELONGATED) || capture.has_cloud() != Some(false) || capture.stated_bounds.exact_world.is_some() {
        return None;
    }
    Some(format!(
        "images of {width}×{height} pixels without a point cloud: initial points are drawn in a ball that fits into the short side \
         of the view, which is a small part of the scene; add a cloud, or the corners of the scene (aabb in transforms files)"
    ))
}

/// Points far from most others, which have no influence on the bounds.
fn far_points(points: &Points) -> Option<String> {
    let positions = points.iter().map(|(position, _)| *position);
    let [low, high] = (!points.is_empty()).then(|| inner_box(positions.clone()))?.map(DVec3::from);
    let (middle, reach) = (0.5 * (low + high), FAR * 0.5 * low.distance(high));
    let far: Vec<[f64; 3]> = positions.filter(|position| DVec3::from(*position).distance(middle) > reach).collect();
    let first = far.first()?;
    Some(format!(
        "{} of {} points are far from the others, e.g. ({}): more than {FAR} times as far from their \
         middle as the corners of the box of 99 % of them; remove these points from the cloud if they are errors",
        far.len(),
        points.len(),
        first.map(short).join(", ")
    ))
}

/// A number with three digits; those of ordinary size have no exponent.
pub(crate) fn short(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if ORDINARY.contains(&size) => format!("{value:.*}", (2.0 - size.log10().floor()).max(0.0) as usize),
        _ => format!("{value:.2e}"),
    }
}
