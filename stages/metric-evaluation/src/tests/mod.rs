//! Evaluation of folders, checks of the artifact, and helpers for other tests.

pub(crate) mod images;
pub(crate) mod stage;
mod trivial;

use std::path::Path;

use engine::{Artifact, Failure};

use crate::artifact::Metrics;
use crate::folders::evaluate_folders;
use crate::image_file::{Background, Image, Quantise};
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;

/// Writes an RGB image with colours that depend on the position and on `shift`.
fn write_image(path: &Path, size: [u32; 2], shift: u32) {
    let colour = |x: u32, y: u32| image::Rgb([(3 * x + shift) as u8, (5 * y) as u8, (x * y + 2 * shift) as u8]);
    image::RgbImage::from_fn(size[0], size[1], colour).save(path).expect("image written");
}

/// Two folders with images of these names; the renders are shifted by `shift`.
fn folders(names: &[&str], shift: u32) -> (tempfile::TempDir, [std::path::PathBuf; 2]) {
    let root = tempfile::tempdir().expect("temporary folder");
    let [renders, truth] = ["renders", "truth"].map(|name| root.path().join(name));
    for (folder, shift) in [(&renders, shift), (&truth, 0)] {
        std::fs::create_dir(folder).expect("folder made");
        names.iter().for_each(|name| write_image(&folder.join(name), [24, 16], shift));
    }
    (root, [renders, truth])
}

fn error_of(renders: &Path, truth: &Path) -> String {
    let error = evaluate_folders(renders, truth).expect_err("must be refused");
    assert!(error.downcast_ref::<Failure>().is_some(), "not a typed failure: {error}");
    error.to_string()
}

#[test]
fn metrics_of_folders_read_back_equal() {
    let (root, [renders, truth]) = folders(&["b.png", "a.png"], 9);
    let metrics = evaluate_folders(&renders, &truth).expect("evaluated");
    assert_eq!(metrics.images.iter().map(|image| image.name.as_str()).collect::<Vec<_>>(), ["a", "b"]);
    assert!(metrics.means[&Metric::Psnr].value().is_some_and(|psnr| psnr > 10.0 && psnr < 40.0));
    assert_eq!(metrics.means[&Metric::MsSsim], Score::undefined("image smaller than 161 px"));
    metrics.write(root.path()).expect("written");
    let reopened = Metrics::open(root.path()).expect("opened");
    reopened.check().expect("valid");
    assert_eq!(reopened, metrics);
}

#[test]
fn the_summary_lists_worst_images_reasons_and_caveats() {
    let (_root, [renders, truth]) = folders(&["a.png", "b.png"], 0);
    write_image(&renders.join("b.png"), [24, 16], 40);
    insta::assert_snapshot!(evaluate_folders(&renders, &truth).expect("evaluated").summary());
    let (_root, [renders, truth]) = folders(&["a.png"], 0);
    let single = evaluate_folders(&renders, &truth).expect("evaluated").summary();
    assert!(single.starts_with("1 image · 24×16 px\n"), "{single}");
}

#[test]
fn mismatched_folders_are_refused() {
    let (root, [renders, truth]) = folders(&["a.png", "b.png"], 1);
    let mut errors = String::new();
    let mut add = |renders: &Path, truth: &Path| {
        errors += &error_of(renders, truth).replace(&*root.path().to_string_lossy(), "DIR");
        errors.push('\n');
    };
    std::fs::rename(renders.join("b.png"), renders.join("c.png")).expect("renamed");
    add(&renders, &truth);
    std::fs::remove_file(renders.join("c.png")).expect("removed");
    add(&renders, &truth);
    write_image(&renders.join("b.png"), [12, 16], 1);
    add(&renders, &truth);
    write_image(&truth.join("b.png"), [12, 16], 1);
    add(&renders, &truth);
    write_image(&truth.join("b.jpg"), [12, 16], 1);
    add(&renders, &truth);
    let empty = root.path().join("empty");
    std::fs::create_dir(&empty).expect("folder made");
    add(&empty, &truth);
    add(&root.path().join("absent"), &truth);
    std::fs::write(empty.join("a.png"), "not an image").expect("written");
    add(&empty, &empty);
    insta::assert_snapshot!(errors);
}

#[test]
fn truncated_jpegs_are_refused() {
    let (_root, [renders, truth]) = folders(&["a.jpg"], 1);
    assert!(evaluate_folders(&renders, &truth).is_ok());
    let path = renders.join("a.jpg");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
    assert!(error_of(&renders, &truth).contains("the file ends before the end of the image"));
}

#[test]
fn gifs_are_refused_as_images() {
    let (_root, [renders, truth]) = folders(&["a.png"], 1);
    image::RgbImage::new(24, 16).save_with_format(renders.join("a.png"), image::ImageFormat::Gif).unwrap();
    assert!(error_of(&renders, &truth).contains("cannot read the image"));
}

#[test]
fn transparent_images_need_a_background() {
    let (_root, [renders, truth]) = folders(&["a.png"], 0);
    let path = truth.join("a.png");
    image::RgbaImage::from_pixel(24, 16, image::Rgba([200, 100, 50, 128])).save(&path).expect("image written");
    assert!(error_of(&renders, &truth).contains("the image is transparent"));
    let read = |quantise, background| {
        let image = Image::read(&path, quantise, Some(background)).expect("read");
        image.planes.map(|plane| (plane[0] * 255.0).round() as u8)
    };
    assert_eq!(read(Quantise::Round8, Background::White), [227, 177, 152]);
    assert_eq!(read(Quantise::Round8, Background::Black), [100, 50, 25]);
    image::RgbaImage::from_pixel(24, 16, image::Rgba([7, 250, 133, 3])).save(&path).expect("image written");
    assert_eq!(read(Quantise::Round8, Background::White), [252, 255, 254]);
    assert_eq!(read(Quantise::Trunc8, Background::White), [252, 254, 253]);
    image::RgbaImage::from_pixel(24, 16, image::Rgba([7, 250, 133, 255])).save(&path).expect("image written");
    assert!(evaluate_folders(&renders, &truth).is_ok(), "opaque RGBA needs no background");
}

#[test]
fn quantisation_keeps_whole_levels() {
    for level in 0..=255_u8 {
        let colour = f64::from(level) / 255.0;
        for quantise in [Quantise::Round8, Quantise::Trunc8, Quantise::None] {
            assert_eq!(quantise.apply(colour), colour);
        }
    }
    assert_eq!(Quantise::Round8.apply(0.00196), 0.0);
    assert_eq!(Quantise::Trunc8.apply(0.999), 254.0 / 255.0);
}

#[test]
fn invalid_metrics_are_refused() {
    let (_root, [renders, truth]) = folders(&["a.png", "b.png"], 5);
    let good = evaluate_folders(&renders, &truth).expect("evaluated");
    good.check().expect("valid");
    let refused = |plant: fn(&mut Metrics)| {
        let mut bad = good.clone();
        plant(&mut bad);
        assert!(bad.check().is_err());
    };
    refused(|bad| bad.images[0].mse = f64::NAN);
    refused(|bad| drop(bad.images[0].values.insert(Metric::Psnr, Score::Value(f64::NAN))));
    refused(|bad| drop(bad.means.insert(Metric::Ssim, Score::Value(f64::INFINITY))));
    refused(|bad| drop(bad.means.insert(Metric::Ssim, Score::Value(0.5))));
    refused(|bad| bad.images.clear());
    refused(|bad| bad.n_images = 7);
    refused(|bad| bad.images[1].name = bad.images[0].name.clone());
}

/// Renders of 4DGaussians from another source, with values of an independent implementation.
#[test]
fn real_renders_match_independent_values() {
    let Some(folder) = support::data("dnerf_bouncingballs_4dgs_renders") else { return };
    let golden = std::fs::read_to_string(folder.join("golden_metrics.json")).expect("golden values");
    let golden: serde_json::Value = serde_json::from_str(&golden).expect("JSON");
    let started = std::time::Instant::now();
    let metrics = evaluate_folders(&folder.join("renders"), &folder.join("gt")).expect("evaluated");
    println!("{:.2} s for {} pairs\n{}", started.elapsed().as_secs_f64(), metrics.n_images, metrics.summary());
    let names = [(Metric::Psnr, "psnr"), (Metric::Ssim, "ssim_3dgs_zeropad"), (Metric::SsimValid, "ssim_gauss_valid")];
    for (metric, name) in names {
        let near = |score: &Score, expected: &serde_json::Value| {
            let (value, expected) = (score.value().expect("defined"), expected.as_f64().expect("a number"));
            assert!((value - expected).abs() <= 1e-5, "{name}: {value}, expected {expected}");
        };
        near(&metrics.means[&metric], &golden["mean"][name]);
        for image in &metrics.images {
            near(&image.values[&metric], &golden["per_view"][format!("{}.png", image.name)][name]);
        }
    }
}
