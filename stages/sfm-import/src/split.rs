//! Selection of training and validation views beyond the split of the format.

use scene::Split;

use crate::params::Params;
use crate::source::Frame;

/// Spreads `count` indices evenly over `0..length`, including both ends if `count` is at least two. Returns all indices if
/// `count` is not smaller than `length`.
fn spread_with_ends(count: usize, length: usize) -> Vec<usize> {
    match count {
        _ if count >= length => (0..length).collect(),
        0 => Vec::new(),
        1 => vec![length / 2],
        _ => (0..count).map(|i| (i * (length - 1) + (count - 1) / 2) / (count - 1)).collect(),
    }
}

/// Spreads `count` indices evenly over the interior of `0..length`, so that the ends stay training views.
fn spread_inside(count: usize, length: usize) -> Vec<usize> {
    (0..count.min(length)).map(|i| (2 * i + 1) * length / (2 * count)).collect()
}

/// Marks test views where no files split them, and returns the rule: every `every_nth`-th camera of a dynamic rig, otherwise
/// every `every_nth`-th image in their order (the rule of LLFF). If numbers of cameras are such that none is held out, the
/// first camera is.
pub(crate) fn hold_out(frames: &mut [Frame], is_static: bool, params: &Params) -> String {
    let every = params.every_nth as usize;
    if every == 0 {
        return "no test".into();
    }
    let is_rig = !is_static && frames.iter().any(|frame| frame.camera_index > 0);
    let cameras = || frames.iter().map(|frame| frame.camera_index as usize);
    let first = match cameras().any(|camera| camera % every == 0) {
        true => 0,
        false => cameras().min().unwrap_or_default(),
    };
    for (index, frame) in frames.iter_mut().enumerate() {
        let rank = if is_rig { frame.camera_index as usize - first } else { index };
        if rank % every == 0 {
            frame.split = Split::Test;
        }
    }
    format!("1 of {every} {}", if is_rig { "cameras" } else { "images" })
}

/// Applies `val_count`, `frame_step` and `train_limit` to frames that are already split by the rule of their format.
/// Returns the applied rules, for the protocol.
pub(crate) fn refine(frames: &mut Vec<Frame>, params: &Params) -> Vec<String> {
    let mut rules = Vec::new();
    if let Some(count) = params.val_count {
        rules.extend(choose_validation(frames, count as usize));
    }
    let train = indices(frames, Split::Train);
    let stepped: Vec<usize> = train.iter().copied().step_by(params.frame_step.max(1) as usize).collect();
    if stepped.len() < train.len() {
        rules.push(format!("1 of {} training views", params.frame_step));
    }
    let limit = params.train_limit.map_or(stepped.len(), |limit| limit as usize);
    let kept: Vec<usize> = spread_with_ends(limit, stepped.len()).into_iter().map(|at| stepped[at]).collect();
    if kept.len() < stepped.len() {
        rules.push(format!("at most {limit} training views"));
    }
    keep(frames, Split::Train, &kept);
    rules
}

/// Reduces the official validation views to `count`, or holds out `count` training views if there are none.
fn choose_validation(frames: &mut Vec<Frame>, count: usize) -> Option<String> {
    let official = indices(frames, Split::Val);
    if official.is_empty() {
        let train = indices(frames, Split::Train);
        let held_out = spread_inside(count.min(train.len()), train.len());
        held_out.iter().for_each(|&at| frames[train[at]].split = Split::Val);
        return (!held_out.is_empty()).then(|| format!("{} training views held out for validation", held_out.len()));
    }
    let kept: Vec<usize> = spread_with_ends(count, official.len()).into_iter().map(|at| official[at]).collect();
    keep(frames, Split::Val, &kept);
    None // training and test views stay those of the official split
}

/// The indices of the frames of one split.
fn indices(frames: &[Frame], split: Split) -> Vec<usize> {
    (0..frames.len()).filter(|&at| frames[at].split == split).collect()
}

/// Drops the frames of `split` whose indices are not in `kept`, which must be sorted.
fn keep(frames: &mut Vec<Frame>, split: Split, kept: &[usize]) {
    let mut at = 0;
    frames.retain(|frame| {
        let keep = frame.split != split || kept.binary_search(&at).is_ok();
        at += 1;
        keep
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_are_even_and_distinct() {
        assert_eq!(spread_with_ends(3, 9), [0, 4, 8]);
        assert_eq!(spread_with_ends(9, 3), [0, 1, 2]);
        assert_eq!(spread_with_ends(0, 3), [] as [usize; 0]);
        assert_eq!(spread_inside(2, 8), [2, 6]);
        for length in 1..40 {
            for count in 1..=length {
                for chosen in [spread_with_ends(count, length), spread_inside(count, length)] {
                    assert_eq!(chosen.len(), count, "{count} of {length}");
                    assert!(chosen.windows(2).all(|pair| pair[0] < pair[1]), "{count} of {length}: {chosen:?}");
                    assert!(chosen.iter().all(|&at| at < length));
                }
            }
        }
    }
}
