//! Films as PNG frames in a folder.

use std::path::Path;

use engine::count;
use scene::{Capture, image_file};
use shaders::tape::Device;

use super::shots::{Film, shots};
use super::subject::Subject;
use crate::inputs::create_folder;

/// Writes the frames as `frame_0000.png`, `frame_0001.png`, … into a folder that is new or empty, and returns a summary.
pub fn film_to_folder(
    model_dir: &Path,
    capture_dir: &Path,
    film: &Film,
    device: Device,
    out: &Path,
) -> anyhow::Result<String> {
    let capture = Capture::open(capture_dir)?;
    let shots = shots(film, &capture)?;
    let subject = Subject::open(model_dir, film.selection.as_ref(), device)?;
    create_folder(out)?;
    for (index, shot) in shots.iter().enumerate() {
        image_file::write_rgb(&out.join(format!("frame_{index:04}.png")), &subject.image(shot)?)?;
    }
    let size = shots[0].camera.intrinsics;
    let frames = count(shots.len(), "frame");
    Ok(format!("{}{frames} of {} × {} px: {}", subject.selects, size.width, size.height, out.display()))
}
