//! Static facts about a capture before its import, from its files without decoding an image.

use std::collections::BTreeSet;
use std::path::Path;

use engine::Facts;
use scene::{Split, facts};

use crate::params::{Format, Params};
use crate::recognise::{read_views, recognise};

/// Static facts about the capture in `dir`. COLMAP models are not read, because their points can take seconds.
pub(crate) fn of_capture(dir: &Path, params: &Params) -> Facts {
    let absent = [facts::FLOW, facts::NORMALS, facts::VELOCITY];
    let known = absent.iter().fold(Facts::default(), |known, map| known.with(map, false));
    let known = if params.static_scene { with_times(known, 1) } else { known };
    let format = recognise(dir, params.format).ok();
    let may_have_depth = matches!(format, Some(Format::Blender | Format::Nerfstudio));
    let known = if may_have_depth { known } else { known.with(facts::DEPTH, false) };
    if !may_have_depth && !matches!(format, Some(Format::Nerfies | Format::N3v)) {
        return known;
    }
    // Problems with the files are reported by the import.
    let Ok(capture) = read_views(dir, params) else { return known };
    let training = || capture.frames.iter().filter(|frame| frame.split == Split::Train);
    let times: BTreeSet<u64> = training().map(|frame| frame.time_secs.to_bits()).collect();
    with_times(known, times.len())
        .with(facts::POINTS, capture.cloud.is_some() || !capture.points.is_empty())
        .with(facts::DEPTH, training().any(|frame| frame.depth.is_some()))
        .with(facts::MASKS, training().any(|frame| frame.mask.is_some()))
}

/// Adds the number of times. A single instant shows no motion.
fn with_times(known: Facts, times: usize) -> Facts {
    let known = known.with(facts::TIMES, times);
    if times > 1 { known } else { known.with(facts::MOVING, false) }
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn missing_and_slow_files_leave_facts_unknown() {
        let nowhere = of_capture(Path::new("nowhere"), &Params::default());
        assert_eq!((nowhere.count(facts::TIMES), nowhere.flag(facts::DEPTH)), (None, Some(false)));
        let dir = Workspace::video(4).write();
        assert_eq!(of_capture(dir.path(), &colmap_params()).count(facts::TIMES), None);
        let static_scene = Params { static_scene: true, ..colmap_params() };
        assert_eq!(of_capture(dir.path(), &static_scene).flag(facts::MOVING), Some(false));
    }
}
