//! Filling from the frames of an inpainter.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::maps::DepthKind;
use scene::{FloatImage, ResizeFilter};

use super::*;
use crate::imported::Frames;
use crate::static_view::StaticView;

/// Writes the original images like an inpainter: at another size, so that no pixel is exact.
fn write_frames(painted: &Painted, dir: &Path) {
    for (_, view) in painted.original.views_of(Split::Train) {
        let image = FloatImage::from_rgb(&painted.original.load_image(view).unwrap());
        let image = image.resized(104, 104, ResizeFilter::Lanczos3).to_rgb8().unwrap();
        image_file::write_rgb(&dir.join(format!("{}.png", view.name)), &image).unwrap();
    }
}

#[test]
fn inpainted_frames_replace_moving_pixels_only() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, false, crossing);
    let frames = tempfile::tempdir().unwrap();
    let refused = painted.run(None, [frames.path(), Path::new("")], &files()).err().unwrap();
    assert!(format!("{refused:#}").contains("9 views have no file in this folder"), "{refused:#}");
    write_frames(&painted, frames.path());
    let (_root, background) = painted.run(None, [frames.path(), Path::new("")], &files()).unwrap();
    let (error, _, unfilled) = painted.errors(&background);
    assert!(error <= 8.0 && unfilled == 0.0, "{error} {unfilled}");
    for (view, filled, mask) in painted.filled(&background) {
        let truth = painted.original.load_image(view).unwrap();
        let margin = mask.dilated(files().margin_px);
        let outside = filled.image.pixels().zip(truth.pixels()).zip(&margin.inside).filter(|(_, inside)| !**inside);
        assert!(outside.into_iter().all(|((found, truth), _)| found == truth), "{}", view.name);
    }
}

#[test]
fn frames_without_depth_continue_that_of_their_surroundings() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, true, crossing);
    let frames = tempfile::tempdir().unwrap();
    write_frames(&painted, frames.path());
    let (_root, background) = painted.run(None, [frames.path(), Path::new("")], &files()).unwrap();
    for (view, filled, mask) in painted.filled(&background) {
        // The square is nearer than everything else.
        let own = painted.original.load_depth(view).unwrap().unwrap().depth_view;
        let nearest = own.iter().copied().fold(f32::INFINITY, f32::min);
        assert!(nearest > 1.1, "{nearest}");
        let margin = mask.dilated(files().margin_px);
        for (at, found) in filled.depth.unwrap().depth_view.into_iter().enumerate() {
            match margin.inside[at] {
                true => assert!(found >= 0.999 * nearest, "{}: {found} at {at}", view.name),
                false => assert_eq!(found, own[at]),
            }
        }
    }
}

#[test]
fn inpainted_depth_is_aligned_to_the_view() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, true, crossing);
    let (frames, depths) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    write_frames(&painted, frames.path());
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut write = |value: &dyn Fn(f32) -> f32, wrong_share: f32| {
        for (_, view) in painted.original.views_of(Split::Train) {
            let depth = painted.original.load_depth(view).unwrap().unwrap();
            let layers = Layers::open(&painted.layers).unwrap();
            let index = painted.capture.views.iter().position(|other| other.name == view.name).unwrap();
            let mask = Mask::from(&layers.load_moving(index).unwrap().unwrap()).dilated(2);
            // Outliers lie on the ring only: inside the mask, no reference exists.
            let mut pixel = |(at, z): (usize, &f32)| {
                let is_wrong = !mask.inside[at] && random.random::<f32>() < wrong_share;
                if is_wrong { 5.0 * random.random::<f32>() } else { value(*z) }
            };
            let values = depth.depth_view.iter().enumerate().map(&mut pixel).collect();
            let path = depths.path().join(format!("{}.exr", view.name));
            scene::exr_file::write(&path, SIZE, SIZE, &[("Z", values)]).unwrap();
        }
    };
    write(&|z| 3.0 / z + 0.2, 0.3);
    let params = Params { depth_folder: Some("depth".into()), depth_kind: DepthKind::InverseDepth, ..files() };
    let (_root, background) = painted.run(None, [frames.path(), depths.path()], &params).unwrap();
    let (_, depth_error, _) = painted.errors(&background);
    assert!(depth_error <= 0.01, "{depth_error}");
    // Planted fault: depth that was declared inverse depth.
    write(&|z| z, 0.0);
    let refused = painted.run(None, [frames.path(), depths.path()], &params).err().unwrap();
    assert!(format!("{refused:#}").contains("does not continue the depth of the view"), "{refused:#}");
}

#[test]
fn results_of_propainter_are_read_from_their_folder() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, false, crossing);
    let results = tempfile::tempdir().unwrap();
    std::fs::create_dir(results.path().join("frames")).unwrap();
    write_frames(&painted, results.path());
    // ProPainter numbers frames from 0 with four digits.
    for (_, view) in painted.original.views_of(Split::Train) {
        let saved = results.path().join(format!("frames/{:04}.png", view.frame_index));
        std::fs::rename(results.path().join(format!("{}.png", view.name)), saved).unwrap();
    }
    std::fs::write(results.path().join("inpaint_out.mp4"), b"not read next to frames").unwrap();
    let one_video = of_one_video(&painted);
    let params = files();
    let frames = Frames::find(results.path(), None, &one_video, &params).unwrap();
    let layers = Layers::open(&painted.layers).unwrap();
    let shift = |shift: usize| {
        let load = |view: usize| StaticView::load(&one_video, &layers, None, view, 2);
        let misfit = |view: usize, file: usize| frames.misfit(&load(view)?, (file + shift) % one_video.views.len());
        captures::better_shift(&one_video, misfit).unwrap()
    };
    assert_eq!((shift(0), shift(1)), (None, Some(-1)));
}

/// The training views, whose layers come first.
fn of_one_video(painted: &Painted) -> Capture {
    let mut capture = painted.capture.clone();
    capture.views.retain(|view| view.split == Split::Train);
    capture
}

#[test]
fn videos_are_decoded_if_ffmpeg_is_installed() {
    if std::process::Command::new("ffmpeg").arg("-version").output().is_err() {
        return support::skip("ffmpeg is not installed");
    }
    let painted = Painted::new(CameraPath::Arc, Behind::None, false, crossing);
    let (results, sources) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    write_frames(&painted, sources.path());
    for (_, view) in painted.original.views_of(Split::Train) {
        let (name, number) = (format!("{}.png", view.name), format!("{:04}.png", view.frame_index));
        std::fs::rename(sources.path().join(name), sources.path().join(number)).unwrap();
    }
    let video = results.path().join("inpaint_out.mp4");
    let mut encode = std::process::Command::new("ffmpeg");
    encode.args(["-v", "error", "-framerate", "24", "-i"]).arg(sources.path().join("%04d.png"));
    assert!(encode.args(["-q:v", "1"]).arg(&video).status().unwrap().success());
    std::fs::copy(&video, results.path().join("masked_in.mp4")).unwrap();
    let (capture, params) = (of_one_video(&painted), files());
    let frames = Frames::find(results.path(), None, &capture, &params).unwrap();
    let layers = Layers::open(&painted.layers).unwrap();
    for at in 0..capture.views.len() {
        let view = StaticView::load(&capture, &layers, None, at, 2).unwrap();
        let misfit = frames.misfit(&view, at).unwrap().unwrap();
        assert!(misfit < 6.0, "{at}: {misfit} grey levels");
    }
    let mut longer = capture.clone();
    longer.views.pop();
    let refused = Frames::find(results.path(), None, &longer, &params).err().unwrap();
    assert!(format!("{refused:#}").contains("frames in this video for a capture of"), "{refused:#}");
}
