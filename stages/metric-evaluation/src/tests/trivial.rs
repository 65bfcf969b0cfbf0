//! Trivial images: best constant image, mean images, and the renders that are not better.

use engine::Artifact;
use glam::DVec3;
use scene::{Camera, Capture, Split};

use super::stage::{SIZE, picture, run_with, write_capture, write_capture_along, write_renders};
use crate::artifact::Metrics;
use crate::folders::evaluate_folders;
use crate::metrics::trivial::{Degenerate, MeanOver};
use crate::params::MetricEvaluationParams;

fn flat(level: u8) -> image::RgbImage {
    image::RgbImage::from_pixel(SIZE[0], SIZE[1], image::Rgb([level; 3]))
}

/// Evaluates folders of these images: renders and ground truth, in pairs.
fn of_folders(pairs: &[(image::RgbImage, image::RgbImage)]) -> Metrics {
    let root = tempfile::tempdir().expect("temporary folder");
    let [renders, truth] = ["renders", "truth"].map(|name| root.path().join(name));
    for folder in [&renders, &truth] {
        std::fs::create_dir(folder).expect("folder made");
    }
    for (at, (render, true_image)) in pairs.iter().enumerate() {
        render.save(renders.join(format!("{at:02}.png"))).expect("written");
        true_image.save(truth.join(format!("{at:02}.png"))).expect("written");
    }
    let metrics = evaluate_folders(&renders, &truth).expect("evaluated");
    metrics.check().expect("valid");
    metrics
}

fn db(mse: f64) -> f64 {
    -10.0 * mse.log10()
}

/// An image whose left half has `left` and whose right half has `right`.
fn halves(left: u8, right: u8) -> image::RgbImage {
    image::RgbImage::from_fn(SIZE[0], SIZE[1], |x, _| image::Rgb([if x < SIZE[0] / 2 { left } else { right }; 3]))
}

#[test]
fn constant_and_mean_image_have_the_psnr_of_their_definition() {
    // Levels 0 and 100, and 0 and 200: the best constant is 75.
    let metrics = of_folders(&[(flat(1), halves(0, 100)), (flat(1), halves(0, 200))]);
    let squares = |values: [f64; 2]| values.iter().map(|v| (v / 255.0).powi(2)).sum::<f64>() / 2.0;
    let constant = (db(squares([75.0, 25.0])) + db(squares([75.0, 125.0]))) / 2.0;
    let trivial = &metrics.trivial;
    assert!((trivial.constant_psnr - constant).abs() <= 1e-9, "{trivial:?}, expected {constant}");
    trivial.colour.iter().for_each(|value| assert!((value - 75.0 / 255.0).abs() <= 1e-12, "{trivial:?}"));
    // The mean of the other images is the other image.
    let mean = trivial.mean_image.expect("two images");
    assert!((mean.psnr - db(squares([0.0, 100.0]))).abs() <= 1e-6, "{mean:?}");
    assert_eq!((mean.over, trivial.background_share, trivial.least_render_variance), (MeanOver::AllImages, None, 0.0));
}

#[test]
fn no_constant_image_is_better_than_the_best_one() {
    let truths = [picture(7), picture(90), picture(31)];
    let best = of_folders(&truths.clone().map(|truth| (truth.clone(), truth))).trivial;
    let pooled = |colour: [u8; 3]| {
        let render = image::RgbImage::from_pixel(SIZE[0], SIZE[1], image::Rgb(colour));
        let metrics = of_folders(&truths.clone().map(|truth| (render.clone(), truth)));
        metrics.images.iter().map(|image| image.mse).sum::<f64>()
    };
    let colour = best.colour.map(|value| (value * 255.0).round() as u8);
    let least = pooled(colour);
    for (channel, step) in [(0, 2_i16), (0, -2), (1, 2), (1, -2), (2, 2), (2, -2)] {
        let mut other = colour;
        other[channel] = (i16::from(other[channel]) + step) as u8;
        assert!(pooled(other) > least, "{other:?} is better than {colour:?}");
    }
}

#[test]
fn renders_of_one_colour_and_worse_ones_are_degenerate() {
    let judged = |render: image::RgbImage| {
        let metrics = of_folders(&[(render.clone(), picture(7)), (render, picture(9))]);
        (metrics.degenerate(true), metrics.summary())
    };
    let (blank, text) = judged(flat(255));
    assert_eq!(blank, Some(Degenerate::NoVariance));
    assert!(text.contains("DEGENERATE: every render has a single colour"), "{text}");
    let mut inverted = picture(7);
    inverted.pixels_mut().for_each(|pixel| pixel.0 = pixel.0.map(|value| 255 - value));
    assert_eq!(judged(inverted).0, Some(Degenerate::NotAboveConstant));
    let (good, text) = judged(picture(10));
    assert_eq!(good, None);
    assert!(text.contains("dB above it") && !text.contains("DEGENERATE"), "{text}");
}

#[test]
fn ground_truth_of_one_colour_is_not_judged() {
    for render in [flat(0), picture(3)] {
        let metrics = of_folders(&[(render.clone(), flat(0)), (render, flat(0))]);
        assert!(metrics.trivial.truth_is_constant());
        assert_eq!(metrics.degenerate(true), None);
        assert!(metrics.summary().contains("the whole ground truth has one colour"), "{}", metrics.summary());
    }
    // Images of one colour each, but of different ones, can be missed.
    let metrics = of_folders(&[(flat(255), flat(10)), (flat(0), flat(200))]);
    assert_eq!(metrics.degenerate(true), Some(Degenerate::NotAboveConstant));
}

#[test]
fn a_single_image_has_no_mean_image() {
    let metrics = of_folders(&[(picture(9), picture(7))]);
    assert_eq!(metrics.trivial.mean_image, None);
    assert_eq!(metrics.degenerate(true), None);
}

/// Evaluates renders that show `render` of a capture from cameras at `position`, after `change`.
fn of_stage(position: fn(f64) -> DVec3, change: fn(&mut Capture), render: &image::RgbImage) -> Metrics {
    let root = tempfile::tempdir().expect("temporary folder");
    let dir = root.path().join("capture");
    let mut capture = write_capture_along(&dir, position);
    change(&mut capture);
    std::fs::write(dir.join("capture.json"), serde_json::to_string(&capture).expect("text")).expect("written");
    let renders = write_renders(&root.path().join("renders"), &capture);
    for view in &renders.views {
        render.save(renders.image_path(view)).expect("written");
    }
    run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated")
}

/// Replaces the image of the last test view by a slightly lighter one.
fn something_moves(capture: &mut Capture) {
    let view = capture.views.iter().find(|view| view.name == "test_1").expect("a view");
    picture(20).save(capture.dir.join(&view.image)).expect("written");
}

#[test]
fn the_temporal_mean_image_decides_where_its_camera_was_trained_on() {
    let fixed = |_| DVec3::new(0.0, 0.0, -3.0);
    let poor = picture(30);
    let moving = of_stage(fixed, something_moves, &poor);
    let mean = moving.trivial.mean_image.expect("two images");
    assert_eq!(mean.over, MeanOver::TrainingPose);
    assert!(moving.trivial.constant_psnr < moving.full_psnr() && moving.full_psnr() < mean.psnr, "{moving:?}");
    assert_eq!(moving.degenerate(true), Some(Degenerate::NotAboveMeanImage));
    assert_eq!(moving.degenerate(false), None, "a static model cannot beat the temporal mean");
    assert_eq!(of_stage(fixed, |_| (), &picture(20)).degenerate(true), None, "nothing moves");

    let held_out = of_stage(
        fixed,
        |capture| {
            something_moves(capture);
            let train = capture.views.iter_mut().find(|view| view.split == Split::Train).expect("a view");
            train.camera = Camera::look_at(train.camera.intrinsics, DVec3::X, DVec3::ZERO, DVec3::Y);
        },
        &poor,
    );
    assert_eq!(held_out.trivial.mean_image.expect("two images").over, MeanOver::HeldOutPose);
    assert_eq!(held_out.degenerate(true), None);
    let moving_camera = of_stage(|time_secs| DVec3::new(0.0, time_secs, -3.0), something_moves, &poor);
    assert_eq!(moving_camera.trivial.mean_image.expect("two images").over, MeanOver::AllImages);
    assert_eq!(moving_camera.degenerate(true), None);
}

#[test]
fn background_pixels_of_the_truth_are_counted() {
    let root = tempfile::tempdir().expect("temporary folder");
    let capture = write_capture(&root.path().join("capture"));
    for view in capture.views.iter().filter(|view| view.name.starts_with("test")) {
        halves(0, 200).save(capture.dir.join(&view.image)).expect("written");
    }
    write_renders(&root.path().join("renders"), &capture);
    let metrics = run_with(root.path(), &MetricEvaluationParams::default(), &[]).expect("evaluated");
    assert_eq!(metrics.trivial.background_share, Some(0.5));
    assert!(metrics.trivial.least_render_variance > 0.0);
    let mut forged = metrics.clone();
    forged.trivial.constant_psnr += 1.0;
    assert!(forged.check().is_err(), "a forged PSNR was accepted");
    forged = metrics;
    forged.images[0].mean_image_mse = Some(0.5);
    assert!(forged.check().is_err(), "a forged error was accepted");
}
