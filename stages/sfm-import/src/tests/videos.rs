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
    movie(matrix, &[], &[])
}

/// Like [`header`], with boxes of the track and of its table.
fn movie(matrix: [u32; 2], of_track: &[u8], of_table: &[u8]) -> Vec<u8> {
    let [cos, sin] = matrix;
    let shown = [&[0; 10][..], &[cos, sin, 0, sin.wrapping_neg(), cos, 0, 0, 0, 1 << 30, 24 << 16, 16 << 16]].concat();
    let entry = [&[0; 6][..], &[24 << 16 | 16], &[0; 13]].concat();
    let described = [numbers(&[0, 1]), boxed("mp4v", &numbers(&entry))].concat();
    let sizes = boxed("stsz", &numbers(&[&[0, 0, 300][..], &[1; 300]].concat()));
    let table = [&boxed("stsd", &described), &sizes, of_table].concat();
    let kind = [numbers(&[0, 0]), b"vide".to_vec(), numbers(&[0, 0, 0, 0])].concat();
    let media = [
        boxed("mdhd", &numbers(&[0, 0, 0, 600, 6000, 0])),
        boxed("hdlr", &kind),
        boxed("minf", &boxed("stbl", &table)),
    ];
    let sound = boxed("trak", &boxed("mdia", &boxed("hdlr", &[numbers(&[0, 0]), b"soun".to_vec()].concat())));
    let track = [&boxed("tkhd", &numbers(&shown)), of_track, &boxed("mdia", &media.concat())].concat();
    let times = boxed("mvhd", &numbers(&[0, 0, 0, 1000, 10_000]));
    let movie = boxed("moov", &[times, sound, boxed("trak", &track)].concat());
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

#[test]
fn inspect_reads_videos_at_their_rate() {
    let fast = header([1 << 16, 0]);
    let halved = (0..fast.len() - 8).find(|at| fast[*at..*at + 8] == *numbers(&[600, 6000])).unwrap();
    // 300 frames in 5 s.
    let fast = [&fast[..halved], &numbers(&[600, 3000]), &fast[halved + 8..]].concat();
    assert!(read(with_videos(&fast).path(), &Params { fps: 60.0, ..Params::default() }).unwrap().warnings.is_empty());
    let summary = crate::inspect::inspect(with_videos(&fast).path()).unwrap().captures.remove(0);
    assert!(summary.warnings.iter().all(|it| !it.contains("frames per second")), "{:?}", summary.warnings);
}

/// An edit list: the duration, in milliseconds, and the start, in ticks of 1/600 s, of each part.
fn edit_list(parts: &[[u32; 2]]) -> Vec<u8> {
    let entries = parts.iter().flat_map(|[duration, start]| [*duration, *start, 1 << 16]);
    let list: Vec<u32> = [0, parts.len() as u32].into_iter().chain(entries).collect();
    boxed("edts", &boxed("elst", &numbers(&list)))
}

#[test]
fn frames_outside_of_an_edit_list_are_not_counted() {
    let count = |parts: &[[u32; 2]], of_table: &[u8]| {
        let dir = with_videos(&movie([1 << 16, 0], &edit_list(parts), of_table));
        read(dir.path(), &Params { fps: 30.0, ..Params::default() }).map(|capture| {
            assert!(capture.warnings.is_empty(), "the rate is that of the stored video: {:?}", capture.warnings);
            capture.count(Split::Test)
        })
    };
    // 300 frames of 20 ticks; with reordering, frames are shown 40, 80, 0 and 20 ticks after they are decoded.
    let even = boxed("stts", &numbers(&[0, 1, 300, 20]));
    let offsets: Vec<u32> = [0, 300].into_iter().chain([1, 40, 1, 80, 1, 0, 1, 20].repeat(75)).collect();
    let reordered = [even.clone(), boxed("ctts", &numbers(&offsets))].concat();
    assert_eq!(count(&[[10_000, 0]], &even).unwrap(), 300);
    assert_eq!(count(&[[10_000, 40]], &reordered).unwrap(), 300, "the list only removes the delay of the first frame");
    assert_eq!(count(&[[1000, 200]], &even).unwrap(), 30, "a cut from 1/3 s on, of one second");
    assert_eq!(count(&[[500, u32::MAX], [0, 200]], &even).unwrap(), 290, "a delay, then the rest");
    let refused = |parts: &[[u32; 2]], of_table: &[u8]| count(parts, of_table).unwrap_err().to_string();
    assert!(refused(&[[1000, 0], [1000, 3000]], &even).contains("composed of several parts"));
    assert!(refused(&[[1000, 200]], &boxed("stts", &numbers(&[0, 1, 299, 20]))).contains("header is damaged"));
    let cut_off = movie([1 << 16, 0], &boxed("edts", &boxed("elst", &numbers(&[0, 2, 1, 0, 1 << 16]))), &even);
    assert_refused(with_videos(&cut_off).path(), &Params::default(), &["edit list is damaged", "cam00.mp4"]);
}

/// A cut without re-encoding, from between two key frames on: header and decoder agree on the number of frames.
#[test]
fn cut_videos_have_the_frames_that_are_decoded() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    Fake { size: (96, 64), ..Fake::small(3, 30) }.neural_3d_videos(dir.path());
    for camera in ["cam00", "cam01", "cam02"] {
        let (whole, cut) = (dir.path().join("whole.mp4"), dir.path().join(format!("{camera}.mp4")));
        std::fs::rename(&cut, &whole).unwrap();
        let mut ffmpeg = std::process::Command::new("ffmpeg");
        ffmpeg.args(["-v", "error", "-ss", "0.3", "-i"]).arg(&whole).args(["-t", "0.3", "-c", "copy"]).arg(&cut);
        assert!(ffmpeg.status().unwrap().success());
        std::fs::remove_file(&whole).unwrap();
    }
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let frames = capture.views_of(Split::Test).count();
    let mut decoded = 0;
    captures::video::decode(&dir.path().join("cam00.mp4"), None, |_, _| {
        decoded += 1;
        Ok(())
    })
    .unwrap();
    assert!(frames == decoded && (9..=11).contains(&frames), "{frames} of {decoded} decoded frames");
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

/// With several threads, the decoder conceals the errors in such frames and reports success.
#[test]
fn patched_up_frames_are_refused_with_the_video() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    fake().neural_3d_videos(dir.path());
    let path = dir.path().join("cam02.mp4");
    let sound = std::fs::read(&path).unwrap();
    let start = sound.windows(4).position(|found| found == b"mdat").unwrap();
    let end = sound.windows(4).position(|found| found == b"moov").unwrap();
    for tenth in [3, 5, 7] {
        let mut bytes = sound.clone();
        let at = start + (end - start) * tenth / 10;
        bytes[at..at + 16].fill(0);
        std::fs::write(&path, bytes).unwrap();
        assert_refused(dir.path(), &Params::default(), &["damaged", "cam02.mp4"]);
    }
}

/// The stage reports the decoder that it used, and how well the points fit.
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
