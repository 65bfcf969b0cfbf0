//! Sequences in the layout of TUM's RGB-D benchmark (Sturm et al. 2012), which Bonn's RGB-D Dynamic Dataset (Palazzolo et
//! al. 2019) and the SLAM benchmark of ETH3D (Schöps et al. 2019) share: `rgb.txt` and `depth.txt` list images and depth
//! maps with their times, `groundtruth.txt` has poses at other times (camera to world, OpenCV's axes).
//!
//! Depth maps are registered to the images. Their lenses are in `sensor.rs`, because the sequences do not state them.

mod sensor;
mod series;
mod trajectory;

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use self::sensor::Sensor;
use self::series::{Series, TOLERANCE_SECS, Timed};
use self::trajectory::{POSES, Trajectory};
use crate::depth::DepthFile;
use crate::depth_video::{self, frame, skipped_notice};
use crate::error::{Result, bad};
use crate::files::{self, inside};
use crate::number_lines::Line;
use crate::params::{Format, Params};
use crate::source::{Frame, SourceCapture};

/// The list of images.
const IMAGES: &str = "rgb.txt";
/// The list of depth maps.
const DEPTHS: &str = "depth.txt";

/// The files that are read besides those that they list.
pub(crate) const METADATA: [&str; 4] = [IMAGES, DEPTHS, POSES, sensor::CALIBRATION];

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(IMAGES).is_file() && [DEPTHS, POSES].iter().any(|name| dir.join(name).is_file())
}

/// Reads the lists and the poses; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let images = listed(dir, IMAGES)?;
    let trajectory = Trajectory::read(dir)?;
    let sensor = Sensor::of(dir, &images.items()[0].value)?;
    let mut warnings = Vec::new();
    let depths = depths(dir, &mut warnings)?;
    let depth_unit = params.depth_unit.unwrap_or(sensor.metres_per_value());
    let (mut frames, mut skipped) = (Vec::new(), Vec::new());
    let (first, stated_in) = (images.items()[0].time_secs, dir.join(POSES));
    for (index, Timed { time_secs, value: image }) in (0..).zip(images.items()) {
        let Some(stated) = trajectory.world_from_camera(*time_secs) else {
            skipped.push(files::name(image));
            continue;
        };
        let pose = sensor.world_from_camera(stated);
        let depth = depths.as_ref().and_then(|depths| depths.nearest(*time_secs));
        let depth = depth.map(|path| DepthFile::new(path.clone(), Some(depth_unit)));
        let instant = (index, time_secs - first);
        frames.push(Frame { depth, ..frame(image.clone(), sensor.lens, &pose, instant, &stated_in) });
    }
    if frames.is_empty() {
        let message = format!(
            "none of the {} images of {IMAGES} ({}) has a pose: those of {POSES} are from {}",
            images.items().len(),
            images.span(),
            trajectory.span()
        );
        return Err(bad(message).hint("both files must state seconds of the same clock").at(stated_in));
    }
    warnings.extend(skipped_notice(&skipped, images.items().len(), &format!("{POSES} has no pose at their time")));
    warnings.extend(depth_notice(&frames, depths.as_ref()));
    Ok(depth_video::capture(dir, (Format::Tum, sensor.dataset), frames, warnings, params))
}

/// The files that a list names, in the order of time.
fn listed(dir: &Path, name: &str) -> Result<Series<PathBuf>> {
    let value = |line: &Line<'_>| {
        let expected = || bad(format!("line {}: a time in seconds and the name of a file are expected", line.number));
        let [time, file] = *line.words.as_slice() else { return Err(expected()) };
        let time_secs = time.parse().ok().filter(|time: &f64| time.is_finite()).ok_or_else(expected)?;
        let file =
            inside(file, "the sequence").map_err(|error| bad(format!("line {}: {}", line.number, error.message)))?;
        Ok(Timed { time_secs, value: dir.join(file) })
    };
    Series::read(&dir.join(name), value)
}

/// The depth maps; `None` for a sequence without them.
fn depths(dir: &Path, warnings: &mut Vec<String>) -> Result<Option<Series<PathBuf>>> {
    if !dir.join(DEPTHS).is_file() {
        warnings.push(format!("{DEPTHS} is missing: there is no depth, and initial points will be random"));
        return Ok(None);
    }
    let depths = listed(dir, DEPTHS)?;
    match depths.items().iter().find(|item| !item.value.is_file()) {
        None => Ok(Some(depths)),
        Some(missing) => {
            let failure = Failure::new(FailureKind::MissingData, format!("{DEPTHS} names this file, which is missing"));
            Err(failure
                .hint(format!("download the sequence again, or remove {DEPTHS} to import it without depth"))
                .at(&missing.value))
        }
    }
}

/// The notice of images without a depth map of their time.
fn depth_notice(frames: &[Frame], depths: Option<&Series<PathBuf>>) -> Option<String> {
    let without = frames.iter().filter(|frame| frame.depth.is_none()).count();
    let is_partial = depths.is_some() && without > 0;
    is_partial.then(|| {
        format!("{without} of {} images have no depth: {DEPTHS} has no map within {TOLERANCE_SECS} s", frames.len())
    })
}
