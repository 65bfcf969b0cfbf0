//! Seeds: the masked pixels of every training view at their depth, with a lifetime and velocities.

use std::borrow::Cow;

use glam::{DQuat, DVec3};
use scene::Mask;

use super::depth::{given_depth, standing_on_ground};
use super::lifetimes::Lifetime;
use super::velocities::{Subject, by_flow, towards};
use crate::bases::primitives4d::Moving;
use crate::method::Start;
use crate::shared::Seeds;

/// Standard deviation of the Gaussian of a pixel in pixel spacings: 1/√2 covers the image without holes at the sampling
/// limit (Yu et al. 2025, WonderWorld).
pub(crate) const SPACING_SHARE: f64 = 0.7;

/// A point of a moving subject at the time of a training view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seed {
    /// World position at birth.
    pub position: DVec3,
    /// 8-bit sRGB.
    pub color: [u8; 3],
    /// Standard deviation, scene units.
    pub scale: f64,
    /// When it is shown.
    pub life: Lifetime,
    /// World velocities before and after birth, per unit of normalised time.
    pub velocities: [DVec3; 2],
    /// The viewing direction (world) of the source view.
    pub axis: DVec3,
}

impl Seed {
    /// The mean of the velocities before and after birth, scene units per unit of normalised time.
    pub(crate) fn mean_velocity(&self) -> DVec3 {
        0.5 * (self.velocities[0] + self.velocities[1])
    }

    /// The seed as a Gaussian in space and time, with the mean of its velocities; `facing` is the world direction of its
    /// third axis, or zero for an isotropic one.
    pub(crate) fn in_space_time(&self, units_per_clip: f64, facing: DVec3) -> Moving {
        Moving {
            time: self.life.birth() * units_per_clip,
            deviation_time: self.life.deviation() * units_per_clip,
            velocity: self.mean_velocity() / units_per_clip,
            deviation: self.scale,
            rotation: DQuat::from_rotation_arc(DVec3::Z, facing.try_normalize().unwrap_or(DVec3::Z)),
        }
    }
}

/// The seeds of all training views whose mask is known: one on every `pixel_stride`-th moving pixel of every
/// `pixel_stride`-th row, or on fewer and larger squares if these are more than `max_count`. A seed fades towards the next
/// times of all views; its velocity leads to the next view of the same camera.
pub(crate) fn from_masks(start: &Start<'_>, settings: &Seeds) -> anyhow::Result<Vec<Seed>> {
    let videos = videos(start, settings.relative_depth)?;
    let mut times: Vec<f64> = videos.iter().flatten().map(|subject| subject.loaded.time).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let stride = stride(&videos, settings);
    let mut seeds = Vec::new();
    for video in &videos {
        for (at, subject) in video.iter().enumerate() {
            let neighbor = |other: Option<usize>| other.and_then(|other| video.get(other));
            let neighbors = [neighbor(at.checked_sub(1)), neighbor(Some(at + 1))];
            let life = Lifetime::among(&times, times.partition_point(|&time| time < subject.loaded.time));
            seeds.extend(of_view(start, subject, neighbors, life, stride));
        }
    }
    Ok(seeds)
}

/// The least stride from `pixel_stride` on that leads to at most `max_count` seeds.
fn stride(videos: &[Vec<Subject<'_>>], settings: &Seeds) -> usize {
    let count = |stride: usize| videos.iter().flatten().map(|subject| places(subject, stride).count()).sum::<usize>();
    let mut stride = settings.pixel_stride;
    while count(stride) > settings.max_count {
        stride += 1;
    }
    stride
}

/// The moving pixels [column, row] of known depth in the middle of squares of `stride` pixels.
fn places(subject: &Subject<'_>, stride: usize) -> impl Iterator<Item = [i32; 2]> {
    let (width, height) = (subject.moving.width as usize, subject.moving.height as usize);
    let grid = (stride / 2..height).step_by(stride).flat_map(move |row| {
        (stride / 2..width).step_by(stride).map(move |column| (row * width + column, [column as i32, row as i32]))
    });
    grid.filter(|&(at, place)| subject.moving.inside[at] && subject.point(place).is_some()).map(|(_, place)| place)
}

/// The training views with masks, by camera and in the order of time; one view per time. `relative_depth` is that of [`Seeds`].
fn videos<'a>(start: &Start<'a>, relative_depth: f64) -> anyhow::Result<Vec<Vec<Subject<'a>>>> {
    let keeps_depth = start.supplements.depth_is_static;
    let mut by_camera: std::collections::BTreeMap<u32, Vec<Subject<'a>>> = Default::default();
    for loaded in &start.dataset.train {
        let Some(moving) = start.supplements.moving(loaded.index) else { continue };
        let (view, moving) = (&start.dataset.capture.views[loaded.index], Mask::from(moving));
        let depth = Cow::Borrowed(given_depth(start, loaded)?);
        by_camera.entry(view.camera_index).or_default().push(Subject { loaded, view, moving, depth, keeps_depth });
    }
    for video in by_camera.values_mut() {
        video.sort_by(|a, b| a.loaded.time.total_cmp(&b.loaded.time));
        video.dedup_by(|a, b| a.loaded.time == b.loaded.time);
        if keeps_depth {
            let views: Vec<_> = video.iter().map(|subject| (&*subject.depth, &subject.moving)).collect();
            let depths = standing_on_ground(&views, relative_depth);
            video.iter_mut().zip(depths).for_each(|(subject, depth)| subject.depth = Cow::Owned(depth));
        }
    }
    Ok(by_camera.into_values().collect())
}

fn of_view(
    start: &Start<'_>,
    subject: &Subject<'_>,
    neighbors: [Option<&Subject<'_>>; 2],
    life: Lifetime,
    stride: usize,
) -> Vec<Seed> {
    let places: Vec<[i32; 2]> = places(subject, stride).collect();
    let towards = |other: Option<&Subject<'_>>| towards(subject, other?, &places);
    let [before, after] = neighbors.map(towards);
    let given = by_flow(start, subject, &places);
    let camera = &subject.view.camera;
    let axis = camera.camera_from_world.rotation.transpose() * DVec3::Z;
    let seed = |at: usize| {
        let place = places[at];
        let pixel = place[1] as usize * subject.moving.width as usize + place[0] as usize;
        let [before, matched] = [&before, &after].map(|found| found.as_ref().map(|found| found[at]));
        let after = given.as_ref().and_then(|given| given[at]).or(matched);
        let any = after.or(before).unwrap_or(DVec3::ZERO);
        let depth = f64::from(subject.depth.depth_view[pixel]);
        Seed {
            position: subject.point(place).expect("places have a depth"),
            color: [0, 1, 2].map(|channel| subject.loaded.pixels[3 * pixel + channel]),
            scale: SPACING_SHARE * stride as f64 * depth / camera.intrinsics.focal_x,
            life,
            velocities: [before.unwrap_or(any), after.unwrap_or(any)],
            axis,
        }
    };
    (0..places.len()).map(seed).collect()
}
