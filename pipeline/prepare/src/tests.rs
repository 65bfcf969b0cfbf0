//! Logs, rates, masks and estimators, without external programs.

use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::ExitStatus;

use engine::FailureKind;
use image::{GrayImage, Luma, Rgb, RgbImage};

use crate::colmap::{Reconstruction, best_of, check, fraction, last_registered, no_model, problem};
use crate::error::{bad, world};
use crate::estimators;
use crate::event::Event;
use crate::frames::{Video, image_names, link_all, sizes};
use crate::manifest::Manifest;
use crate::masks;
use crate::masks_folder::{check_sizes, invert_all, paired};
use crate::process::kind_of_end;
use crate::request::{CameraModel, Matcher, Request};
use crate::steps::{Step, Steps};

#[test]
fn progress_is_read_from_logs() {
    assert_eq!(fraction("Processed file [3/70]\n  Name: 3.jpg\n"), Some((3, 70)));
    assert_eq!(fraction("Matching block [1/2, 2/2] in 3.1s\nMatching block [2/2, 1/2]"), Some((3, 4)));
    assert_eq!(fraction("Matching image [5/20] in 0.2s"), Some((5, 20)));
    assert_eq!(fraction("Elapsed time: 0.180 [minutes]"), None);
    assert_eq!(last_registered("Registering image #3 (12)\n  => Image sees 80 / 90 points\n"), Some(12));
    assert_eq!(last_registered("Registering image #3 (num_reg_frames=13)"), Some(13));
    assert_eq!(last_registered("Elapsed time"), None);
}

#[test]
fn a_reconstruction_that_lost_its_scale_is_tried_again_and_not_chosen() {
    let found =
        |count: usize, lost_scale: Option<f64>| Reconstruction { count, lost_scale, models: 1, path: "0".into() };
    assert_eq!(problem(Some(&found(70, None)), 70), None);
    assert!(problem(Some(&found(15, None)), 70).unwrap().contains("only 15 of 70"));
    assert!(problem(None, 70).unwrap().contains("only 0 of 70"));
    assert!(problem(Some(&found(70, Some(6e10))), 70).unwrap().contains("factor of 6e10"));
    let best = |all: Vec<Reconstruction>| best_of(all.into_iter(), 70).unwrap().count;
    assert_eq!(best(vec![found(70, Some(6e10)), found(60, None), found(50, None)]), 60);
    assert_eq!(best(vec![found(70, Some(6e10)), found(20, None)]), 70, "neither is usable");
}

#[test]
fn long_videos_are_thinned_by_whole_numbers() {
    let video = Video { rate: (30000, 1001), secs: 20.0 };
    assert_eq!(video.rate_for(None, 10.0, 300).0, "30000/1001");
    let (text, fps) = video.rate_for(None, 20.0, 300);
    assert_eq!(text, "30000/2002");
    assert!((fps - 14.985).abs() < 1e-3);
    assert_eq!(video.rate_for(Some(5.0), 20.0, 300), ("5".into(), 5.0));
    let refused = |fps| {
        let request = Request { fps: Some(fps), ..request("clip.mp4".as_ref(), "out".as_ref()) };
        video.check_rate(&request).map_err(|error| error.to_string())
    };
    assert!(refused(30.0).is_ok() && refused(5.0).is_ok());
    assert!(refused(60.0).unwrap_err().contains("--fps 60 is above the 29.97 frames per second"));
}

fn write_mask(path: &Path, value: impl Fn(u32, u32) -> u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    GrayImage::from_fn(200, 100, |x, y| Luma([value(x, y)])).save(path).unwrap();
}

#[test]
fn masks_are_inverted_and_widened() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.png");
    write_mask(&path, |x, y| u8::from((50..60).contains(&x) && (30..40).contains(&y)));
    let read = || masks::read(&path, masks::least_level(std::iter::once(path.as_path())).unwrap()).unwrap();
    let mask = read();
    assert_eq!(masks::share(&mask), 100.0 / 20_000.0);
    masks::write_for_colmap(&mask, &path).unwrap();
    let written = image::open(&path).unwrap().to_luma8();
    // The margin is 1 % of 200 pixels.
    let hidden = |x: u32, y: u32| (48..62).contains(&x) && (28..42).contains(&y);
    assert!(written.enumerate_pixels().all(|(x, y, pixel)| (pixel.0[0] == 0) == hidden(x, y)));
    // A soft matte is set from half of its maximum, 199, on, in any colour.
    write_mask(&path, |x, _| x as u8);
    assert_eq!(masks::share(&read()), 100.0 / 200.0);
    RgbImage::from_fn(200, 100, |x, _| Rgb([0, (x / 2) as u8, 0])).save(&path).unwrap();
    assert_eq!(masks::share(&read()), 100.0 / 200.0);
}

#[test]
fn masks_that_mark_what_is_static_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    write_mask(&dir.path().join("a.png"), |x, _| u8::from(x > 60));
    let pairs = [("a.jpg".to_owned(), vec![dir.path().join("a.png")])];
    let refused = invert_all(dir.path(), &pairs, &dir.path().join("out")).unwrap_err();
    assert!(refused.to_string().contains("invert them"), "{refused}");
}

#[test]
fn masks_of_another_size_than_the_images_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (images, mask) = (dir.path().join("images"), dir.path().join("masks/a.png"));
    write_mask(&images.join("a.png"), |_, _| 9);
    write_mask(&mask, |_, _| 0);
    let pairs = [("a.png".to_owned(), vec![mask.clone()])];
    check_sizes(&images, &pairs).unwrap();
    GrayImage::new(400, 200).save(&mask).unwrap();
    let refused = check_sizes(&images, &pairs).unwrap_err().to_string();
    assert!(refused.contains("the mask is 400×200, but its image a.png is 200×100"), "{refused}");
}

#[test]
fn empty_images_are_refused_and_sizes_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["a.png", "b.png", "c.png"].map(str::to_owned);
    names.iter().for_each(|name| write_mask(&dir.path().join(name), |_, _| 9));
    GrayImage::new(7, 5).save(dir.path().join("b.png")).unwrap();
    assert!(sizes(dir.path(), &names).unwrap().into_keys().eq([(7, 5), (200, 100)]));
    std::fs::write(dir.path().join("c.png"), "").unwrap();
    let refused = sizes(dir.path(), &names).unwrap_err().to_string();
    assert!(refused.contains("empty (0 bytes)") && refused.contains("c.png"), "{refused}");
}

#[test]
fn masks_belong_to_images_by_name_alone() {
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let images = names(&["00001.jpg", "00002.jpg"]);
    let dir = Path::new("masks");
    let counts = |masks: &[&str]| {
        paired(dir, &names(masks), &images).map(|pairs| pairs.iter().map(|(_, files)| files.len()).collect::<Vec<_>>())
    };
    assert_eq!(counts(&["00001.png", "00002.png"]).unwrap(), [1, 1]);
    assert_eq!(counts(&["00002.jpg.png"]).unwrap(), [1]);
    assert_eq!(counts(&["1/00001.png", "1/00002.png", "2/00002.png"]).unwrap(), [1, 2], "objects are united");
    let shifted = counts(&["00000.png", "00001.png"]).unwrap_err().to_string();
    assert!(shifted.contains("1 of 2 masks belong to no image, e.g. 00000.png"), "{shifted}");
    let cameras = names(&["a/1.jpg", "b/1.jpg"]);
    let pairs = paired(dir, &names(&["a/1.png", "b/1.png"]), &cameras).unwrap();
    assert!(pairs.iter().all(|(_, files)| files.len() == 1), "a mask of one camera is not one of another: {pairs:?}");
}

#[test]
fn estimators_are_checked_before_anything_runs() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("e.toml");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        estimators::read(&path).map(|found| found.len()).map_err(|failure| failure.to_string())
    };
    let table = |name: &str, kind: &str, command: &str| {
        format!("[[estimator]]\nname = \"{name}\"\nkind = \"{kind}\"\ncommand = \"{command}\"\n")
    };
    let good = table("a", "depth", "x {frames} {out}");
    assert_eq!(read(&(good.clone() + &table("b", "flow-backward", "x {frames} {out}"))), Ok(2));
    for (text, reason) in [
        (table("a", "depth", "x {frames}"), "lacks {out}"),
        (table("mapping", "depth", "x {frames} {out}"), "another step has this name"),
        (good.clone() + &good, "another step has this name"),
        (good.clone() + &table("b", "depth", "x {frames} {out}"), "another one writes maps/depth"),
        (table("a b", "depth", "x {frames} {out}"), "a name has letters"),
        (good.replace("kind", "king"), "unknown field"),
    ] {
        let refused = read(&text).unwrap_err();
        assert!(refused.contains(reason), "{refused}");
    }
}

#[test]
fn hidden_files_are_not_images() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["1.jpg", "._1.jpg", ".cache/1.jpg"] {
        std::fs::create_dir_all(dir.path().join(name).parent().unwrap()).unwrap();
        std::fs::write(dir.path().join(name), "").unwrap();
    }
    assert_eq!(image_names(dir.path()), ["1.jpg"]);
}

#[test]
fn linked_images_keep_their_folders() {
    let dir = tempfile::tempdir().unwrap();
    let (from, to) = (dir.path().join("from"), dir.path().join("to"));
    std::fs::create_dir_all(from.join("left")).unwrap();
    std::fs::write(from.join("left/1.jpg"), "an image").unwrap();
    link_all(&from, &["left/1.jpg".into()], &to).unwrap();
    assert_eq!(std::fs::read_to_string(to.join("left/1.jpg")).unwrap(), "an image");
}

/// A preparation without options.
fn request(input: &Path, out: &Path) -> Request {
    Request {
        input: input.into(),
        out: out.into(),
        fps: None,
        max_frames: None,
        max_side: None,
        start_secs: None,
        end_secs: None,
        masks: None,
        estimators: None,
        camera_model: CameraModel::Auto,
        matcher: Matcher::Auto,
        force: Vec::new(),
        until: None,
    }
}

#[test]
fn photos_that_colmap_does_not_read_are_noted() {
    let dir = tempfile::tempdir().unwrap();
    let images = dir.path().join("photos");
    write_mask(&images.join("1.png"), |_, _| 9);
    ["2.HEIC", "3.webp", "4.txt", "masks/1.webp"].iter().for_each(|name| {
        std::fs::create_dir_all(images.join(name).parent().unwrap()).unwrap();
        std::fs::write(images.join(name), "a photo").unwrap();
    });
    let (mut notes, out) = (Vec::new(), dir.path().join("out"));
    let request = Request { until: Some("frames".into()), ..request(&images, &out) };
    let mut report =
        |event: &Event| notes.extend(if let Event::Note(text) = event { Some(text.clone()) } else { None });
    crate::prepare(&request, &|_| None, &mut report).unwrap();
    assert!(notes.iter().any(|note| note.starts_with("2 photos are left out, e.g. 2.HEIC")), "{notes:?}");
}

#[test]
fn missing_inputs_are_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let (images, out) = (dir.path().join("images"), dir.path().join("out"));
    write_mask(&images.join("1.png"), |_, _| 9);
    let refused = |change: &dyn Fn(&mut Request)| {
        let mut request = request(&images, &out);
        change(&mut request);
        let error = crate::prepare(&request, &|_| None, &mut |_| ()).unwrap_err().to_string();
        assert!(!out.exists(), "{error}");
        error
    };
    let nothing = dir.path().join("nothing");
    assert!(refused(&|request| request.masks = Some(nothing.clone())).contains("no such folder (--masks)"));
    assert!(refused(&|request| request.masks = Some(images.join("1.png"))).contains("no such folder (--masks)"));
    assert!(refused(&|request| request.estimators = Some(nothing.clone())).contains("no such file (--estimators)"));
    assert!(refused(&|request| request.input.clone_from(&nothing)).contains("no such file or folder"));
}

#[test]
fn options_without_effect_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let [images, video, file] = ["images", "clip.mp4", "e.toml"].map(|name| dir.path().join(name));
    write_mask(&images.join("1.png"), |_, _| 9);
    std::fs::write(&video, "a video").unwrap();
    std::fs::write(&file, "[[estimator]]\nname = \"sam2\"\nkind = \"masks\"\ncommand = \"x {frames} {out}\"\n")
        .unwrap();
    let out = dir.path().join("out");
    let refused = |input: &Path, change: &dyn Fn(&mut Request)| {
        let mut request = request(input, &out);
        change(&mut request);
        let error = crate::prepare(&request, &|_| None, &mut |_| ()).unwrap_err().to_string();
        assert!(!out.exists(), "{error}");
        error
    };
    let of_images = |change: &dyn Fn(&mut Request)| refused(&images, change);
    assert!(of_images(&|request| request.start_secs = Some(1.0)).contains("--start is an option for videos"));
    assert!(of_images(&|request| request.max_frames = Some(9)).contains("--max-frames is an option for videos"));
    assert!(of_images(&|request| request.max_side = Some(800)).contains("--max-side is an option for videos"));
    let both = refused(&video, &|request| (request.fps, request.max_frames) = (Some(5.0), Some(9)));
    assert!(both.contains("--max-frames has no effect with --fps"), "{both}");
    let masks = refused(&video, &|request| {
        (request.masks, request.estimators) = (Some(images.clone()), Some(file.clone()));
    });
    assert!(masks.contains("--masks would replace the masks of estimator \"sam2\""), "{masks}");
}

#[test]
fn a_killed_program_or_a_full_disk_is_a_failure_of_the_machine() {
    let kind = |wait_status: i32, text: &str| kind_of_end(ExitStatus::from_raw(wait_status), text);
    assert_eq!(kind(9, ""), FailureKind::World, "killed by a signal");
    assert_eq!(kind(137 << 8, ""), FailureKind::World, "killed below a shell");
    assert_eq!(kind(1 << 8, "write: No space left on device"), FailureKind::World);
    assert_eq!(kind(1 << 8, "unknown option"), FailureKind::BadInput);
}

#[test]
fn the_failure_of_a_mapper_is_not_hidden() {
    let option = bad("colmap failed (exit status: 1):\n  unrecognised option --x");
    let failure = no_model(Some(option), 40);
    assert!(failure.message.contains("only 0 of 40") && failure.message.contains("unrecognised option"), "{failure}");
    assert!(failure.hint.as_ref().is_some_and(|hint| hint.contains("--masks")), "{failure}");
    assert_eq!(no_model(Some(world("colmap cannot be started")), 40).kind, FailureKind::World);
    assert!(no_model(None, 40).message.ends_with("only 0 of 40 images have a pose"));
}

#[test]
fn unusable_poses_are_an_error() {
    assert!(check(40, 40, None).is_ok());
    let refused = check(40, 40, Some(1e5)).unwrap_err();
    assert!(refused.kind == FailureKind::BadInput && refused.message.contains("poses are unusable"), "{refused}");
    assert!(check(10, 40, None).unwrap_err().message.contains("only 10 of 40"));
}

#[test]
fn an_unreadable_manifest_does_not_count_as_missing() {
    let dir = tempfile::tempdir().unwrap();
    assert!(Manifest::read(dir.path()).unwrap().steps.is_empty());
    std::fs::create_dir(dir.path().join("prepare.json")).unwrap();
    assert!(Manifest::read(dir.path()).is_err());
}

/// Runs a step of two attempts in `out`; the second attempt runs `fallback` if the first is poor. Returns whether it ran.
fn runs_again(out: &Path, fallback: &str, is_first_poor: bool) -> bool {
    let request = request(out, out);
    let mut report = |_: &crate::Event| ();
    let mut steps = Steps::open(&request, &mut report).unwrap();
    let step = Step {
        name: "mapping",
        commands: vec!["mapper".into(), fallback.into()],
        tool: Ok("1".into()),
        inputs: Vec::new(),
        outputs: vec!["model"],
    };
    let make = |steps: &mut Steps<'_>| {
        std::fs::write(steps.dir.join("model"), "poses").unwrap();
        Ok((if is_first_poor { vec![fallback.to_owned()] } else { Vec::new() }, String::new()))
    };
    steps.run(step, make).unwrap();
    !steps.executed.is_empty()
}

#[test]
fn other_settings_of_a_second_attempt_run_it_again() {
    let dir = tempfile::tempdir().unwrap();
    assert!(runs_again(dir.path(), "mapper --angle 4", true));
    assert!(!runs_again(dir.path(), "mapper --angle 4", true));
    assert!(runs_again(dir.path(), "mapper --angle 2", true));
    // A good first attempt does not depend on the settings of the second.
    let dir = tempfile::tempdir().unwrap();
    assert!(runs_again(dir.path(), "mapper --angle 4", false));
    assert!(!runs_again(dir.path(), "mapper --angle 2", false));
}
