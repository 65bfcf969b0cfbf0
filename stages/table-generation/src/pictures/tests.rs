//! Tests of error maps and of the choice of views.

use image::{Rgb, RgbImage};

use super::*;
use crate::collect::FrameScore;

fn run(name: &str, scores: &[(&str, f64)]) -> Run {
    let frame = |(name, psnr): &(&str, f64)| FrameScore { name: (*name).into(), time_secs: None, psnr: *psnr };
    Run { row: name.into(), frames: scores.iter().map(frame).collect(), ..Run::default() }
}

#[test]
fn worst_and_median_of_common_views_are_shown() {
    let a = run("a", &[("v0", 30.0), ("v1", 20.0), ("v2", 25.0), ("v3", 40.0), ("only_a", 1.0)]);
    let b = run("b", &[("v0", 30.0), ("v1", 24.0), ("v2", 21.0), ("v3", 40.0)]);
    let chosen = chosen_views(&[&a, &b], 1);
    let names: Vec<&str> = chosen.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["v1", "v0"]);
    assert_eq!(chosen[0].1, "worst of 4 views, 22.0 dB on average");
    assert!(chosen[1].1.starts_with("median"));
    assert!(chosen_views(&[&a, &b], 0).is_empty() && chosen_views(&[], 2).is_empty());
    assert_eq!(chosen_views(&[&run("a", &[("v0", 30.0)])], 3).len(), 1);
}

#[test]
fn error_colours_grow_lighter_with_the_error() {
    let truth = RgbImage::from_pixel(64, 8, Rgb([100; 3]));
    let render = RgbImage::from_fn(64, 8, |x, _| Rgb([100 + x as u8; 3]));
    let colours = errors::colours(&render, &truth, 64).expect("equal sizes");
    let lightness = |x: u32| colours.get_pixel(x, 4).0.iter().map(|c| u32::from(*c)).sum::<u32>();
    assert!(lightness(0) < 10, "{}", lightness(0));
    let steps: Vec<u32> = (0..64).step_by(8).map(lightness).collect();
    assert!(steps.windows(2).all(|pair| pair[1] > pair[0]), "{steps:?}");
    assert_eq!(errors::colours(&render, &truth, 16).expect("equal sizes").dimensions(), (16, 2));
    assert!(errors::colours(&render, &RgbImage::new(8, 8), 64).is_err());
}

#[test]
fn pictures_are_small_jpeg_data_uris() {
    let image = RgbImage::from_pixel(400, 100, Rgb([200, 30, 30]));
    let picture = Picture::new(&small(image, 200)).expect("encoded");
    assert_eq!((picture.width, picture.height), (200, 50));
    let uri = picture.data_uri();
    assert!(uri.starts_with("data:image/jpeg;base64,/9j/"), "{uri}");
    let decoded = image::load_from_memory(&picture.bytes).expect("a JPEG file").into_rgb8();
    assert!(decoded.get_pixel(100, 25).0.iter().zip([200, 30, 30]).all(|(a, b)| a.abs_diff(b) <= 4));
}
