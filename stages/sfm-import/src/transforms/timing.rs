//! Times of transforms files: the frames of each camera, and the duration of a frame.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use scene::statistics::median;
use scene::{Split, TimeMap};

use super::listed::ListedFrame;
use crate::error::{Result, bad};
use crate::files::name;
use crate::image_names::natural_order;
use crate::oddities::short;
use crate::params::Params;
use crate::source::{Frame, time_range_secs};

/// Largest distance of a time from the grid of equally spaced times, in frames: files round times to a few digits.
const OFF_GRID: f64 = 0.1;
/// The grid of all times is not that of the frames if its steps are shorter than this share of the steps of the training
/// times, and more than this number for each time. Views between the frames may fit such a grid by chance: times in
/// steps of 1/59 and of 1/48 are multiples of 1/2832.
const CHANCE_GRID: (f64, f64) = (0.5, 2.0);
/// A gap between successive times is long if it exceeds this number of frames and this share of the whole time.
const LONG_GAP: (f64, f64) = (20.0, 0.1);

/// Duration of a frame in seconds above which times are probably in another unit.
const LONG_FRAME_SECS: f64 = 1000.0;
/// Units of time with their durations in seconds.
const UNITS: [(&str, f64); 3] = [("milliseconds", 1e-3), ("microseconds", 1e-6), ("nanoseconds", 1e-9)];
/// The longest plausible duration of a frame in seconds.
const PLAUSIBLE_FRAME_SECS: f64 = 10.0;

/// Whether the capture is static: no frame has a time, or the parameters say so. Files in which only some frames have a
/// time are refused.
pub(crate) fn is_static(listed: &[ListedFrame<'_>], params: &Params, warnings: &mut Vec<String>) -> Result<bool> {
    let timed = listed.iter().filter(|frame| frame.stated.time().is_some()).count();
    if let (1.., Some(untimed)) = (timed, listed.iter().find(|frame| frame.stated.time().is_none())) {
        let hint = "add the missing times, or remove all of them for a static scene";
        return Err(bad("some frames have a time and others do not").hint(hint).at(&untimed.file.path));
    }
    if timed == 0 && !params.is_static() {
        let has_timestamps = listed.iter().any(|frame| frame.stated.has_timestamp());
        let hint = if has_timestamps {
            "rename the key timestamp of the frames to time"
        } else {
            "add time (in seconds) to each frame"
        };
        warnings.push(format!("no frame has a time: imported as a static scene; if it moves, {hint}"));
    }
    Ok(params.is_static() || timed == 0)
}

/// Makes every frame of a static scene a separate camera.
pub(crate) fn number_static(frames: &mut [Frame]) {
    frames.iter_mut().zip(0..).for_each(|(frame, index)| {
        (frame.camera_index, frame.frame_index, frame.time_secs) = (index, 0, 0.0);
    });
}

/// How the splits of a capture were made.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Splits {
    /// Each was recorded by itself, as in D-NeRF.
    Apart,
    /// They divide one recording.
    OfOneRecording,
}

/// Numbers cameras and instants, and sorts frames by split, time and camera. Instants are numbered over all splits of one
/// recording, unless two splits have a frame of the same camera at the same time; otherwise in each split.
///
/// One camera suffices where no split has two frames at one time. Otherwise the cameras are the folders of the images, or
/// else the distinct poses, whichever has one frame per time. Failing both, a few repeated times are separated if there is
/// [one camera](is_one_camera); otherwise frames of one time are numbered as cameras in the order of the file. Before that, the
/// frames of one instant of a rig get [one time](join_instants).
pub(crate) fn number_by_time(frames: &mut [Frame], splits: Splits, warnings: &mut Vec<String>) {
    warnings.extend(join_instants(frames, splits));
    let candidates = [vec![0; frames.len()], by_folder(frames), by_pose(frames)];
    let cameras = match candidates.into_iter().find(|cameras| is_one_per_time(frames, cameras)) {
        Some(cameras) => cameras,
        None if is_one_camera(frames) => {
            warnings.extend(separate_times(frames));
            vec![0; frames.len()]
        }
        None => {
            let note = "several frames have the same time: they are numbered as cameras in the order of the file";
            warnings.push(note.into());
            by_rank(frames)
        }
    };
    frames.iter_mut().zip(cameras).for_each(|(frame, camera)| frame.camera_index = camera);
    let place = |frame: &Frame| (frame.camera_index, time_key(frame.time_secs));
    let is_one = splits == Splits::OfOneRecording && are_distinct(frames.iter().map(place));
    let groups = if is_one { vec![Split::ALL.to_vec()] } else { Split::ALL.map(|split| vec![split]).to_vec() };
    for group in groups {
        let of_group = frames.iter_mut().filter(|frame| group.contains(&frame.split));
        let of_group: Vec<(u64, &mut Frame)> = of_group.map(|frame| (time_key(frame.time_secs), frame)).collect();
        let instants: BTreeSet<u64> = of_group.iter().map(|(time, _)| *time).collect();
        let ranks: BTreeMap<u64, u32> = instants.into_iter().zip(0..).collect();
        of_group.into_iter().for_each(|(time, frame)| frame.frame_index = ranks[&time]);
    }
    frames.sort_by(|a, b| {
        let by_time = a.split.cmp(&b.split).then(a.time_secs.total_cmp(&b.time_secs));
        by_time.then(a.camera_index.cmp(&b.camera_index))
    });
}

/// Gives the frames of each instant of a rig their mean time: time stamps of hardware differ by fractions of a frame. Returns a
/// warning if times change.
fn join_instants(frames: &mut [Frame], splits: Splits) -> Option<String> {
    let groups = match splits {
        Splits::OfOneRecording => vec![Split::ALL.to_vec()],
        Splits::Apart => Split::ALL.map(|split| vec![split]).to_vec(),
    };
    let candidates = [by_folder(frames), by_pose(frames)];
    let mut widest: Option<(f64, String)> = None;
    for group in groups {
        let Some(instants) = candidates.iter().find_map(|cameras| instants_of_rig(frames, cameras, &group)) else {
            continue;
        };
        for instant in instants {
            let (first, last) = (&frames[instant[0]], &frames[*instant.last()?]);
            let (start_secs, width_secs) = (first.time_secs, last.time_secs - first.time_secs);
            if width_secs > widest.as_ref().map_or(0.0, |(width_secs, _)| *width_secs) {
                widest = Some((width_secs, format!("{} and {}", first.name, last.name)));
            }
            // Relative to the first, the mean of equal times is exact.
            let offsets = instant.iter().map(|at| frames[*at].time_secs - start_secs);
            let mean_secs = start_secs + offsets.sum::<f64>() / instant.len() as f64;
            instant.iter().for_each(|at| frames[*at].time_secs = mean_secs);
        }
    }
    widest.map(|(width_secs, example)| {
        format!(
            "the times of a rig differ by up to {} s in an instant, e.g. of {example}: the frames of each instant get their mean \
             time; state equal times if the cameras film at the same time",
            short(width_secs)
        )
    })
}

/// The frames of each instant, by time, if these `cameras` film at the same times: between two instants is a gap of more than half
/// the shortest step of any camera, and most instants have a frame of most cameras. One camera that moves between the places of
/// a rig has no such gaps.
fn instants_of_rig(frames: &[Frame], cameras: &[u32], group: &[Split]) -> Option<Vec<Vec<usize>>> {
    let time_secs = |at: &usize| frames[*at].time_secs;
    let mut of_group: Vec<usize> = (0..frames.len()).filter(|at| group.contains(&frames[*at].split)).collect();
    of_group.sort_by(|a, b| time_secs(a).total_cmp(&time_secs(b)));
    let mut before_secs: BTreeMap<u32, f64> = BTreeMap::new();
    let steps_secs = of_group.iter().filter_map(|at| {
        let before_secs = before_secs.insert(cameras[*at], time_secs(at))?;
        Some(time_secs(at) - before_secs)
    });
    let gap_secs = 0.5 * steps_secs.fold(f64::INFINITY, f64::min);
    let instants: Vec<&[usize]> = of_group.chunk_by(|a, b| time_secs(b) - time_secs(a) <= gap_secs).collect();
    // Folders may also be those of the splits of one camera.
    let cameras_of = |split: &Split| {
        let of_split = of_group.iter().filter(|at| frames[**at].split == *split);
        of_split.map(|at| cameras[*at]).collect::<BTreeSet<_>>().len()
    };
    let is_rig = group.iter().any(|split| cameras_of(split) > 1)
        && gap_secs.is_finite()
        && 2 * of_group.len() > before_secs.len() * instants.len()
        && instants.iter().all(|instant| are_distinct(instant.iter().map(|at| cameras[*at])));
    is_rig.then(|| instants.into_iter().map(<[usize]>::to_vec).collect())
}

/// A key with the order of the times.
fn time_key(time_secs: f64) -> u64 {
    let bits = (time_secs + 0.0).to_bits(); // + 0.0 makes −0 equal to 0
    if bits >> 63 == 0 { bits | 1 << 63 } else { !bits }
}

/// Whether no camera has two frames of one split at one time.
fn is_one_per_time(frames: &[Frame], cameras: &[u32]) -> bool {
    are_distinct(frames.iter().zip(cameras).map(|(frame, camera)| (frame.split, *camera, time_key(frame.time_secs))))
}

fn are_distinct<K: Ord>(mut keys: impl Iterator<Item = K>) -> bool {
    let mut seen = BTreeSet::new();
    keys.all(|key| seen.insert(key))
}

/// The indices of the frames of one split, by time.
fn by_time(frames: &[Frame], split: Split) -> BTreeMap<u64, Vec<usize>> {
    let mut indices: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    for (index, frame) in frames.iter().enumerate().filter(|(_, frame)| frame.split == split) {
        indices.entry(time_key(frame.time_secs)).or_default().push(index);
    }
    indices
}

/// Whether the frames are from one camera, because poses show that it moves, or stands still, and most times are unique in
/// every split with repeated times. In a rig, most cameras share every time.
fn is_one_camera(frames: &[Frame]) -> bool {
    let is_mostly_unique = |split| {
        let indices = by_time(frames, split);
        let repeated = indices.values().filter(|frames| frames.len() > 1).count();
        repeated == 0 || 2 * repeated < indices.len()
    };
    Split::ALL.into_iter().all(is_mostly_unique) && by_pose(frames).iter().all(|camera| *camera == 0)
}

/// Spreads the frames of one split and time evenly, in the order of the file, between the middles of the intervals to the
/// times before and after. Returns a warning.
fn separate_times(frames: &mut [Frame]) -> Option<String> {
    let (mut example, mut count) = (None, 0);
    for split in Split::ALL {
        let indices: Vec<Vec<usize>> = by_time(frames, split).into_values().collect();
        let times: Vec<f64> = indices.iter().map(|indices| frames[indices[0]].time_secs).collect();
        for (rank, indices) in indices.iter().enumerate().filter(|(_, indices)| indices.len() > 1) {
            let time = times[rank];
            let middle = |other: Option<&f64>| other.filter(|it| it.is_finite()).map_or(time, |it| 0.5 * (time + it));
            let start = middle(rank.checked_sub(1).and_then(|before| times.get(before)));
            let width = middle(times.get(rank + 1)) - start;
            for (index, share) in indices.iter().zip(0..).map(|(index, at)| (*index, f64::from(at) + 0.5)) {
                frames[index].time_secs = start + width * share / indices.len() as f64;
            }
            count += indices.len();
            example.get_or_insert_with(|| {
                format!("{} and {} (time {time})", frames[indices[0]].name, frames[indices[1]].name)
            });
        }
    }
    let note =
        "most times are unique, so these are frames of one camera, at times around the stated one; correct the times";
    example.map(|example| format!("{count} frames share their time with another, e.g. {example}: {note}"))
}

/// The rank of every image's folder, in natural order.
fn by_folder(frames: &[Frame]) -> Vec<u32> {
    let folder = |frame: &Frame| frame.image.parent().map(Path::to_string_lossy).unwrap_or_default().into_owned();
    let mut folders: Vec<String> = frames.iter().map(folder).collect::<BTreeSet<_>>().into_iter().collect();
    folders.sort_by(|a, b| natural_order(a, b));
    frames
        .iter()
        .map(|frame| folders.iter().position(|known| *known == folder(frame)).unwrap_or_default() as u32)
        .collect()
}

/// The rank of every distinct pose and lens, by first appearance. If most poses of a split differ, the
/// camera moves, and all frames get the same number.
fn by_pose(frames: &[Frame]) -> Vec<u32> {
    let mut known: BTreeMap<Vec<u64>, u32> = BTreeMap::new();
    let number = |frame: &Frame| {
        let (k, pose) = (frame.lens.intrinsics, frame.camera_from_world);
        let pose = pose.rotation.to_cols_array().into_iter().chain(pose.translation.to_array());
        let key = pose.chain([k.focal_x, k.focal_y]).map(f64::to_bits).collect();
        let next = known.len() as u32;
        *known.entry(key).or_insert(next)
    };
    let numbers: Vec<u32> = frames.iter().map(number).collect();
    let places: BTreeSet<(Split, u32)> = frames.iter().map(|frame| frame.split).zip(numbers.iter().copied()).collect();
    if 2 * places.len() <= frames.len() { numbers } else { vec![0; frames.len()] }
}

/// The rank of every frame among those of its split and time.
fn by_rank(frames: &[Frame]) -> Vec<u32> {
    let mut counts: BTreeMap<(Split, u64), u32> = BTreeMap::new();
    let rank = |frame: &Frame| {
        let count = counts.entry((frame.split, time_key(frame.time_secs))).or_default();
        *count += 1;
        *count - 1
    };
    frames.iter().map(rank).collect()
}

/// The time map over all splits, with the spacing of the file's times.
pub(crate) fn time_map(frames: &[Frame], is_static: bool) -> TimeMap {
    let [start_secs, end_secs] = time_range_secs(frames);
    if is_static || !(end_secs > start_secs) {
        let instant_secs = if start_secs.is_finite() { start_secs } else { 0.0 };
        return TimeMap { start_secs: instant_secs, end_secs: instant_secs, frame_secs: 1.0 };
    }
    let all = times(frames, None);
    let of_training = chance_grid(frames).map(|[of_training, _]| of_training);
    let frame_secs = of_training
        .or_else(|| spacing(&all))
        .or_else(|| spacing(&times(frames, Some(Split::Train))))
        .unwrap_or_else(|| median_gap(&all));
    TimeMap { start_secs, end_secs, frame_secs }
}

/// The distinct times of one split, or of all, in ascending order.
fn times(frames: &[Frame], split: Option<Split>) -> Vec<f64> {
    let chosen = frames.iter().filter(|frame| split.is_none_or(|split| frame.split == split));
    let mut times: Vec<f64> = chosen.map(|frame| frame.time_secs).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    times
}

/// The spacings of the training times and of all times, if the latter is that of a [chance grid](CHANCE_GRID).
fn chance_grid(frames: &[Frame]) -> Option<[f64; 2]> {
    let all = times(frames, None);
    let [of_training, of_all] = [spacing(&times(frames, Some(Split::Train)))?, spacing(&all)?];
    let steps = (all.last()? - all.first()?) / of_all;
    let is_chance = of_all < CHANCE_GRID.0 * of_training && steps > CHANCE_GRID.1 * all.len() as f64;
    is_chance.then_some([of_training, of_all])
}

/// A warning about times of held-out views between the frames of the training views.
pub(crate) fn between_frames(frames: &[Frame]) -> Option<String> {
    let [of_training, of_all] = chance_grid(frames)?;
    Some(format!(
        "the times of held-out views lie between the frames: a frame lasts {} s by the times of the training views, although all \
         times are multiples of {} s; if the held-out views are of the same frames, state the same times",
        short(of_training),
        short(of_all)
    ))
}

/// A warning about the longest gap between successive times, if a wrong time or a break of the recording is likely.
pub(crate) fn long_gap(frames: &[Frame], time_map: &TimeMap) -> Option<String> {
    let mut sorted: Vec<&Frame> = frames.iter().collect();
    sorted.sort_by(|a, b| a.time_secs.total_cmp(&b.time_secs));
    let gaps = sorted.windows(2).map(|pair| (pair[1].time_secs - pair[0].time_secs, pair));
    let (gap_secs, pair) = gaps.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let share = gap_secs / (time_map.end_secs - time_map.start_secs);
    if !(gap_secs > LONG_GAP.0 * time_map.frame_secs && share > LONG_GAP.1) {
        return None;
    }
    let place = |frame: &Frame| format!("{} (time {} in {})", frame.name, frame.time_secs, name(&frame.stated_in));
    Some(format!(
        "no frame lies between {} and {}, {:.0} % of the whole time: correct the times if they are wrong; if they are right, \
         import the frames before and after the gap as two captures, because methods resolve time relative to the whole",
        place(pair[0]),
        place(pair[1]),
        100.0 * share
    ))
}

/// A warning if the times are probably not in seconds, with the factor that makes the frames plausibly long.
pub(crate) fn other_unit(time_map: &TimeMap) -> Option<String> {
    let frame_secs = time_map.frame_secs;
    let is_plausible = |(_, unit_secs): &&(&str, f64)| frame_secs * unit_secs <= PLAUSIBLE_FRAME_SECS;
    let (unit, unit_secs) = UNITS.iter().find(is_plausible).unwrap_or(&UNITS[2]);
    (frame_secs > LONG_FRAME_SECS).then(|| {
        format!(
            "a frame lasts {frame_secs:.0} s, because times are read as seconds: if they are in {unit}, multiply the time of each \
             frame by {unit_secs:e}"
        )
    })
}

/// The spacing of the regular grid that contains the sorted times; `None` if there is no such grid. The smallest gap
/// must be one frame.
fn spacing(times: &[f64]) -> Option<f64> {
    let gaps = || times.windows(2).map(|pair| pair[1] - pair[0]);
    let smallest = gaps().fold(f64::INFINITY, f64::min);
    let range = times.last()? - times.first()?;
    let steps: f64 = gaps().map(|gap| (gap / smallest).round()).sum();
    let spacing = range / steps;
    let is_on_grid = |time: &f64| {
        let frames = (time - times[0]) / spacing;
        (frames - frames.round()).abs() <= OFF_GRID
    };
    (spacing > 0.0 && spacing.is_finite() && times.iter().all(is_on_grid)).then_some(spacing)
}

/// The median difference of successive times.
fn median_gap(times: &[f64]) -> f64 {
    median(times.windows(2).map(|pair| pair[1] - pair[0])).expect("two times")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spacing_is_that_of_the_file() {
        let grid = |ranks: &[u32], count: f64| ranks.iter().map(|rank| f64::from(*rank) / count).collect::<Vec<_>>();
        let close = |a: f64, b: f64| (a / b - 1.0).abs() <= 1e-9;
        assert!(close(spacing(&grid(&[0, 3, 4, 9, 12, 149], 149.0)).unwrap(), 1.0 / 149.0));
        let rounded: Vec<f64> = (0..150).map(|k| (f64::from(k) / 149.0 * 1e4).round() / 1e4).collect();
        assert!(close(spacing(&rounded).unwrap(), 1.0 / 149.0));
        assert_eq!(spacing(&[0.0, 0.31, 0.4, 0.77, 1.0]), None);
        assert_eq!(median_gap(&[0.0, 0.5, 0.6, 1.0]), 0.4);
    }

    #[test]
    fn keys_have_the_order_of_times() {
        let times = [-2.0, -1e-9, -0.0, 0.0, 1e-300, 0.5, 3.0];
        assert!(times.windows(2).all(|pair| time_key(pair[0]) <= time_key(pair[1])));
        assert_eq!(time_key(-0.0), time_key(0.0));
    }
}
