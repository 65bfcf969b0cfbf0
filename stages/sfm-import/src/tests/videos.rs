//! Rigs in video files: their headers, their frames, and what is refused.

use std::path::Path;

use scene::{Split, facts};
use support::fakes::{Fake, has_ffmpeg};

use super::support::*;
use crate::recognise::read;
use crate::{Params, SfmImport};

/// A rig whose ball moves by more than a pixel per frame.
fn fake() -> Fake {
    Fake { size: (96, 64), ..Fake::small(4, 5) }
}

fn numbers(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

/// A box of an MP4 file.
fn boxed(name: &str, content: &[u8]) -> Vec<u8> {
    [&numbers(&[content.len() as u32 + 8]), name.as_bytes(), content].concat()
}

/// The header of a video of 300 frames of 24×16 pixels in ten seconds, without any frame.
fn header(matrix: [u32; 2]) -> Vec<u8> {
    let [cos, sin] = matrix;
    let shown = [&[0; 10][..], &[cos, sin, 0, sin.wrapping_neg(), cos, 0, 0, 0, 1 << 30, 24 << 16, 16 << 16]].concat();
    let entry = [&[0; 6][..], &[24 << 16 | 16], &[0; 13]].concat();
    let described = [numbers(&[0, 1]), boxed("mp4v", &numbers(&entry))].concat();
    let table = [boxed("stsd", &described), boxed("stsz", &numbers(&[&[0, 0, 300][..], &[1; 300]].concat()))].concat();
    let kind = [numbers(&[0, 0]), b"vide".to_vec(), numbers(&[0, 0, 0, 0])].concat();
    let media = [
        boxed("mdhd", &numbers(&[0, 0, 0, 600, 6000, 0])),
        boxed("hdlr", &kind),
        boxed("minf", &boxed("stbl", &table)),
    ];
    let sound = boxed("trak", &boxed("mdia", &boxed("hdlr", &[numbers(&[0, 0]), b"soun".to_vec()].concat())));
    let track = [boxed("tkhd", &numbers(&shown)), boxed("mdia", &media.concat())].concat();
    let movie = boxed("moov", &[sound, boxed("trak", &track)].concat());
    // A box of 64 bits, as large videos have, comes before the header.
    let large = [numbers(&[1]), b"mdat".to_vec(), numbers(&[0, 20]), vec![7; 4]].concat();
    [boxed("ftyp", b"isom"), large, movie].concat()
}

/// A rig of three cameras with this file as every video.
fn with_videos(file: &[u8]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    super::n3v::write_poses(dir.path(), &super::n3v::rows(3));
    super::n3v::NAMES.iter().for_each(|name| std::fs::write(dir.path().join(format!("{name}.mp4")), file).unwrap());
    dir
}

#[test]
fn videos_are_planned_by_their_headers() {
    let dir = with_videos(&header([1 << 16, 0]));
    let capture = read(dir.path(), &Params::default()).unwrap();
    assert_eq!([capture.count(Split::Train), capture.count(Split::Test)], [600, 300]);
    assert_eq!((capture.split_rule.as_str(), capture.warnings.len()), ("camera 0 held out", 0));
    let known = crate::facts::of_capture(dir.path(), &Params::default());
    assert_eq!((known.count(facts::TIMES), known.flag(facts::POINTS)), (Some(300), None));
    let window = Params { first_frame: Some(10), frame_count: Some(20), ..Params::default() };
    let frames = frames(dir.path(), &window);
    assert_eq!((frames.len(), frames[0].in_video().unwrap().index, frames[0].time_secs), (60, 10, 0.0));
    let warnings = read(dir.path(), &Params { fps: 60.0, ..Params::default() }).unwrap().warnings;
    assert!(warnings[0].contains("cam00 has 30.00 frames per second, but fps = 60"), "{warnings:?}");
}

/// The other rigs that are published as videos: EasyVolcap, and the Panoptic Studio. Extracted frames take precedence.
#[test]
fn videos_of_other_rigs_are_planned() {
    let header = header([1 << 16, 0]);
    type Layout = (fn(&Fake, &Path), &'static str, fn(usize) -> String);
    let layouts: [Layout; 2] = [
        (Fake::easy_volcap, "images", |camera| format!("videos/{camera:02}.mp4")),
        (Fake::panoptic_studio, "hdImgs", |camera| format!("hdVideos/hd_00_{camera:02}.mp4")),
    ];
    for (write, images, video) in layouts {
        let (fake, dir) = (Fake::small(2, 4), tempfile::tempdir().unwrap());
        write(&fake, dir.path());
        (0..2).for_each(|camera| support::fakes::write(&dir.path().join(video(camera)), &header));
        let params = Params { every_nth: 2, ..Params::default() };
        assert_eq!(frames(dir.path(), &params).len(), 8, "{images}");
        std::fs::remove_dir_all(dir.path().join(images)).unwrap();
        let capture = read(dir.path(), &params).unwrap();
        assert_eq!((capture.frames.len(), capture.warnings.len()), (600, 0), "{images}");
        assert!(super::rigs::misfit_px(&fake, &capture) <= 1e-9, "{images}");
        let warnings = read(dir.path(), &Params { fps: 60.0, ..params.clone() }).unwrap().warnings;
        assert!(warnings[0].contains("frames per second"), "{warnings:?}");
        std::fs::remove_file(dir.path().join(video(1))).unwrap();
        assert!(read(dir.path(), &params).map_or(true, |capture| capture.camera_count() == 1), "{images}");
    }
}

#[test]
fn unreadable_headers_are_refused() {
    let mut refusals = Refusals::default();
    let turned = header([0, 1 << 16]);
    let good = header([1 << 16, 0]);
    let at = good.windows(4).position(|name| name == b"stsz").unwrap() + 12;
    let empty = [&good[..at], &numbers(&[0]), &good[at + 4..]].concat();
    let endless = [&good[..at], &numbers(&[u32::MAX]), &good[at + 4..]].concat();
    for file in [&good[..good.len() - 1], &good[..40], b"", &turned, &empty, &endless] {
        refusals.add(with_videos(file).path(), &Params::default());
    }
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn mangled_headers_never_panic() {
    let dir = with_videos(&header([1 << 16, 0]));
    let refused = support::mangle::refused(&dir.path().join("cam02.mp4"), 400, |_| {
        read(dir.path(), &Params::default()).map(|_| ()) // what the decoder makes of the rest is tested with ffmpeg
    });
    assert!(refused > 100, "only {refused} of 400 damaged headers were refused");
}

/// The mean difference of a view from what the fake's camera sees at a frame, in grey levels.
fn difference(fake: &Fake, capture: &scene::Capture, view: &scene::View, frame: usize) -> f64 {
    let (found, truth) = (capture.load_image(view).unwrap(), fake.image(view.camera_index as usize, frame));
    let sum: f64 = found.iter().zip(truth.iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / truth.len() as f64
}

#[test]
fn frames_of_videos_are_those_that_were_encoded() {
    if !has_ffmpeg() {
        return;
    }
    let (fake, dir) = (fake(), tempfile::tempdir().unwrap());
    fake.neural_3d_videos(dir.path());
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!((capture.views.len(), capture.time_map.end_secs), (20, 4.0 / 30.0));
    assert_eq!(capture.protocol.split, "camera 0 held out, 5 frames");
    for view in &capture.views {
        let at = view.frame_index as usize;
        let own = difference(&fake, &capture, view, at);
        let others = (0..5).filter(|other| *other != at).map(|other| difference(&fake, &capture, view, other));
        let nearest = others.fold(f64::INFINITY, f64::min);
        assert!(own <= 8.0 && own + 0.5 < nearest, "{}: {own:.1} from its frame, {nearest:.1} from another", view.name);
    }
    let window = Params { first_frame: Some(2), frame_count: Some(2), ..Params::default() };
    let (_root, capture) = run(dir.path(), &window).unwrap();
    assert_eq!(capture.views.len(), 8);
    let view = &capture.views[0];
    assert!(difference(&fake, &capture, view, 2) + 0.5 < difference(&fake, &capture, view, 0));
    let inspected = crate::inspect::inspect(dir.path()).unwrap();
    assert!(inspected.captures[0].problems.is_empty() && inspected.recipe().is_some(), "{}", inspected.text());
}

/// Overwrites what follows the last place of a box's name by zeros, up to its end or the header.
fn blank(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let find = |name: &[u8]| bytes.windows(4).position(|found| found == name).unwrap();
    let (data, header) = (find(b"mdat"), find(b"moov"));
    bytes[data + 4 + (header - data) / 2..header - 4].fill(0);
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn damaged_frames_are_refused_with_the_video() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    fake().neural_3d_videos(dir.path());
    blank(&dir.path().join("cam02.mp4"));
    assert_refused(dir.path(), &Params::default(), &["cannot be decoded", "cam02.mp4"]);
}

/// The stage says what it decoded with, and how well the points fit.
#[test]
fn decoder_and_triangulation_are_measured() {
    if !has_ffmpeg() {
        return;
    }
    let (dir, root) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    fake().neural_3d_videos(dir.path());
    let mut context = engine::JobContext::detached(root.path()).unwrap();
    context.sources.insert("source".into(), dir.path().into());
    <SfmImport as engine::Stage>::run(&context, &Params::default()).unwrap();
    let measured = context.measurements.borrow();
    assert!(measured["decoder"].as_str().unwrap().starts_with("ffmpeg version"), "{measured:?}");
    assert_eq!(measured["triangulation"]["views"], 3);
}
