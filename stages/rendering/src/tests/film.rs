//! Tests of films: PNG frames, GIFs and contact sheets.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use image::codecs::gif::GifDecoder;
use image::metadata::LoopCount;
use image::{AnimationDecoder as _, RgbImage};
use scene::image_file;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Device;
use training::Player;

use super::{SIZE, trained};
use crate::film::{Film, Gif, Panels, film_to_folder, film_to_gif, film_to_sheet};
use crate::quantize::to_image;
use crate::{Selection, Show};

/// Mean difference per channel that quantising a frame to 256 colours may cause. Views of one capture differ by more.
const PALETTE_ERROR: f64 = 6.0;

fn names(views: &[&str]) -> Vec<String> {
    views.iter().map(|view| (*view).to_owned()).collect()
}

fn assert_refused(result: anyhow::Result<String>, reason: &str) {
    let error = format!("{:?}", result.unwrap_err());
    assert!(error.contains(reason), "{error}");
}

#[test]
fn frames_equal_the_players_renders_along_the_path() {
    let (dir, model, capture) = trained("deformable4dgs");
    let [capture_dir, model_dir] = ["capture", "model"].map(|name| dir.path().join(name));
    let shoot = |times: &[f64], views: &[&str], name: &str| {
        let film = Film { times, views: &names(views), selection: None };
        film_to_folder(&model_dir, &capture_dir, &film, Device::Cpu, &dir.path().join(name))
    };
    let frame = |name: &str, index: usize| {
        image_file::read_rgb(&dir.path().join(name).join(format!("frame_{index:04}.png"))).unwrap()
    };
    let player = Player::new(&model).unwrap();
    let rendered = |name: &str, time_secs: f64| {
        let view = capture.views.iter().find(|view| view.name == name).unwrap();
        to_image(&player.render(time_secs, &PinholeCamera::from(&view.camera)).unwrap())
    };
    // Without views the camera stands at the first test view; times within the rounding of the end count as the end.
    let summary = shoot(&[0.0, 1.0, 2.0001], &[], "standing").unwrap();
    assert!(summary.starts_with("3 frames of 20 × 20 px"), "{summary}");
    for (index, time_secs) in [0.0, 1.0, 2.0].into_iter().enumerate() {
        assert_eq!(frame("standing", index), rendered("test_0", time_secs));
    }
    assert!(shoot(&[1.0], &[], "single").unwrap().starts_with("1 frame of 20 × 20 px"));
    // Time stands still, and the camera ends at the last view.
    shoot(&[1.0; 3], &["train_0", "train_1"], "moving").unwrap();
    assert_eq!(frame("moving", 2), rendered("train_1", 1.0));
    assert!(frame("moving", 1) != frame("moving", 0) && frame("moving", 1) != frame("moving", 2));
    // Without times the film follows the views in space and time.
    shoot(&[], &["test"], "following").unwrap();
    assert_eq!([0, 1].map(|at| frame("following", at)), [rendered("test_0", 0.0), rendered("test_1", 0.4)]);
    let summary = shoot(&[], &["train_2", "test", "train"], "mixed").unwrap();
    assert!(summary.starts_with("9 frames of "), "{summary}");
    let expected =
        [rendered("train_2", 0.8), rendered("test_0", 0.0), rendered("test_1", 0.4), rendered("train_0", 0.0)];
    assert_eq!([0, 1, 2, 3].map(|at| frame("mixed", at)), expected);

    assert_refused(shoot(&[1.0], &[], "moving"), "the folder is not empty");
    assert_refused(shoot(&[1.0], &["train_9"], "other"), "no view \"train_9\"");
    assert_refused(shoot(&[], &["test", "val"], "other"), "no view \"val\"");
    assert_refused(shoot(&[3.0], &[], "other"), "outside of the capture");
    assert_refused(shoot(&[], &[], "other"), "no times given");
    let with_prompt = Film {
        times: &[1.0],
        views: &[],
        selection: Some(Selection { prompt: "ball", embeddings: None, show: Show::Highlight }),
    };
    let out = dir.path().join("other");
    assert_refused(film_to_folder(&model_dir, &capture_dir, &with_prompt, Device::Cpu, &out), "without prompts");
    assert!(!out.exists(), "nothing is written");
}

/// Reads the frames of a GIF, whether it loops forever, and the delays of its frames in milliseconds.
fn read_gif(path: &Path) -> (Vec<RgbImage>, bool, Vec<(u32, u32)>) {
    let decoder = GifDecoder::new(BufReader::new(File::open(path).unwrap())).unwrap();
    let is_endless = matches!(decoder.loop_count(), LoopCount::Infinite);
    let frames = decoder.into_frames().collect_frames().unwrap();
    let delays = frames.iter().map(|frame| frame.delay().numer_denom_ms()).collect();
    let images = frames.into_iter().map(|frame| image::DynamicImage::from(frame.into_buffer()).into_rgb8()).collect();
    (images, is_endless, delays)
}

/// The image that a panel was enlarged from by a factor of two: every second pixel.
fn panel(picture: &RgbImage, index: u32) -> RgbImage {
    RgbImage::from_fn(SIZE, SIZE, |x, y| *picture.get_pixel(2 * (SIZE * index + x), 2 * y))
}

fn mean_difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(&a, &b)| u64::from(a.abs_diff(b))).sum();
    sum as f64 / a.as_raw().len() as f64
}

#[test]
fn gifs_show_the_truth_and_every_model_side_by_side() {
    let (dir, model, capture) = trained("deformable4dgs");
    let (other_dir, other, _) = trained("static3dgs");
    let models = [dir.path().join("model"), other_dir.path().join("model")];
    let views = names(&["train"]);
    let film = Film { times: &[], views: &views, selection: None };
    let file = dir.path().join("film.gif");
    let gif = Gif { panels: Panels { truth: true, scale: 2 }, fps: 10 };
    let summary = film_to_gif(&models, &dir.path().join("capture"), &film, gif, Device::Cpu, &file).unwrap();
    assert!(summary.starts_with("6 frames of 120 × 40 px, 3 panels"), "{summary}");

    let (pictures, is_endless, delays) = read_gif(&file);
    assert!(is_endless);
    assert_eq!(delays, [(100, 1); 6]);
    let players = [&model, &other].map(|model| Player::new(model).unwrap());
    let truth = |at: usize| capture.load_image(&capture.views[at]).unwrap();
    for (index, (picture, view)) in pictures.iter().zip(&capture.views).enumerate() {
        assert_eq!(picture.dimensions(), (6 * SIZE, 2 * SIZE));
        let camera = PinholeCamera::from(&view.camera);
        let renders = players.iter().map(|player| to_image(&player.render(view.time_secs, &camera).unwrap()));
        for (at, expected) in [truth(index)].into_iter().chain(renders).enumerate() {
            let difference = mean_difference(&panel(picture, at as u32), &expected);
            assert!(difference <= PALETTE_ERROR, "panel {at} of frame {index} differs by {difference}");
        }
    }
    // Enlarging changes no colour.
    let plain = Gif { panels: Panels { truth: true, scale: 1 }, ..gif };
    film_to_gif(&models, &dir.path().join("capture"), &film, plain, Device::Cpu, &file).unwrap();
    let enlarged = |small: &RgbImage| RgbImage::from_fn(6 * SIZE, 2 * SIZE, |x, y| *small.get_pixel(x / 2, y / 2));
    assert!(read_gif(&file).0.iter().map(enlarged).eq(pictures.iter().cloned()));
    // The tolerance distinguishes neighbouring views.
    assert!(mean_difference(&panel(&pictures[0], 0), &truth(1)) > 2.0 * PALETTE_ERROR);
}

#[test]
fn gifs_that_cannot_be_made_are_refused() {
    let (dir, ..) = trained("static3dgs");
    let models = [dir.path().join("model")];
    let shoot = |times: &[f64], views: &[&str], gif: Gif, file: PathBuf| {
        let film = Film { times, views: &names(views), selection: None };
        film_to_gif(&models, &dir.path().join("capture"), &film, gif, Device::Cpu, &file)
    };
    let file = || dir.path().join("film.gif");
    let [plain, truth] = [false, true].map(|truth| Gif { panels: Panels { truth, scale: 1 }, fps: 10 });
    // test_0 was taken at 0 s with frames 0.4 s apart.
    shoot(&[0.0, 0.1], &[], truth, file()).unwrap();
    assert!(shoot(&[0.0], &[], plain, file()).unwrap().starts_with("1 frame of 20 × 20 px, 1 panel, "));
    std::fs::remove_file(file()).unwrap();
    assert_refused(shoot(&[0.0, 1.0], &[], truth, file()), "frame 1: its camera took none at 1 s");
    assert_refused(shoot(&[0.0; 3], &["train_0", "train_1"], truth, file()), "frame 1: ");
    let huge = Gif { panels: Panels { truth: false, scale: 5000 }, fps: 10 };
    assert_refused(shoot(&[0.0], &[], huge, file()), "100000 × 100000 px are too many");
    assert_refused(shoot(&[0.0], &[], plain, dir.path().join("none/film.gif")), "does not exist");
    assert_refused(shoot(&[0.0], &[], plain, dir.path().to_owned()), "would replace a folder");
    // Longer than any file system allows; a file without permission would not stop a test that root runs.
    let long = dir.path().join("x".repeat(300) + ".gif");
    assert_refused(shoot(&[0.0], &[], plain, long), "the picture cannot be written");
    assert!(!file().exists(), "nothing is written");
}

#[test]
fn sheets_have_a_row_per_view_and_a_column_per_model() {
    let (dir, model, capture) = trained("deformable4dgs");
    let (other_dir, other, _) = trained("static3dgs");
    let models = [dir.path().join("model"), other_dir.path().join("model")];
    let views = names(&["train"]);
    let film = Film { times: &[], views: &views, selection: None };
    let shoot = |panels: Panels, file: &Path| {
        film_to_sheet(&models, &dir.path().join("capture"), &film, panels, Device::Cpu, file)
    };
    let file = dir.path().join("sheet.png");
    let summary = shoot(Panels { truth: true, scale: 1 }, &file).unwrap();
    assert!(summary.starts_with("6 rows of 3 panels, 60 × 120 px"), "{summary}");
    let sheet = image_file::read_rgb(&file).unwrap();
    let cell =
        |column: u32, row: u32| image::imageops::crop_imm(&sheet, column * SIZE, row * SIZE, SIZE, SIZE).to_image();
    let players = [&model, &other].map(|model| Player::new(model).unwrap());
    for (row, view) in (0..6).zip(&capture.views) {
        let camera = PinholeCamera::from(&view.camera);
        assert!(cell(0, row) == capture.load_image(view).unwrap(), "truth of {}", view.name);
        for (column, player) in (1..).zip(&players) {
            let expected = to_image(&player.render(view.time_secs, &camera).unwrap());
            assert!(cell(column, row) == expected, "column {column} of {}", view.name);
        }
    }
    shoot(Panels { truth: false, scale: 3 }, &file).unwrap();
    assert_eq!(image_file::read_rgb(&file).unwrap().dimensions(), (6 * SIZE, 18 * SIZE));
    assert_refused(shoot(Panels { truth: false, scale: 5000 }, &file), "are too many for a sheet");
    assert_refused(shoot(Panels { truth: false, scale: 1 }, &dir.path().join("none/sheet.png")), "does not exist");
}
