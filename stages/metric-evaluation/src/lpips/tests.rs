//! Golden values from `tests/expected.py`, which computes weights and images by the same formulas. The values of AlexNet and
//! VGG agree with a second independent implementation to 1e-15.

pub(super) mod torch_bytes;

use super::weights::Weights;
use super::*;
use crate::image_file::Quantise;
use crate::tests::images::{image, noise, perturbed};

/// Relative tolerance between the f32 network and the f64 one.
const TOLERANCE: f64 = 1e-5;

/// `count` numbers in [0, 1) with 24 bits each, from a hash of the index and the seed.
fn uniform(count: usize, seed: u32) -> impl Iterator<Item = f64> {
    (0..count as u32).map(move |at| {
        let mut bits = at.wrapping_add(seed.wrapping_mul(0x9E37_79B9));
        for (shift, factor) in [(16, 0x7FEB_352D), (15, 0x846C_A68B), (16, 1)] {
            bits = (bits ^ (bits >> shift)).wrapping_mul(factor);
        }
        f64::from(bits >> 8) / f64::from(1 << 24)
    })
}

/// The tensors of a classifier and its heads, with weights from the formula.
fn generated(backbone: Backbone) -> [BTreeMap<String, Tensor>; 2] {
    let mut body = BTreeMap::new();
    for ((name, shape), layer) in backbone.convolutions().into_iter().zip(1..) {
        let [outputs, inputs, size, _] = shape;
        let bound = (6.0 / (inputs * size * size) as f64).sqrt();
        let weights = uniform(outputs * inputs * size * size, layer).map(|u| ((2.0 * u - 1.0) * bound) as f32);
        let bias = uniform(outputs, layer + 100).map(|u| ((2.0 * u - 1.0) * 0.1) as f32);
        body.insert(format!("{name}.weight"), Tensor { shape: shape.to_vec(), values: weights.collect() });
        body.insert(format!("{name}.bias"), Tensor { shape: vec![outputs], values: bias.collect() });
    }
    let head = |(tap, channels): (usize, usize)| {
        let values = uniform(channels, 200 + tap as u32).map(|u| 0.5 * u as f32).collect();
        (format!("lin{tap}.model.1.weight"), Tensor { shape: vec![1, channels, 1, 1], values })
    };
    [body, backbone.tap_channels().into_iter().enumerate().map(head).collect()]
}

fn lpips(backbone: Backbone) -> Lpips {
    let [body, heads] = generated(backbone);
    Lpips::new(backbone, &body, &heads).expect("all tensors")
}

fn assert_near(found: f64, expected: f64) {
    assert!((found - expected).abs() <= TOLERANCE * expected, "{found} instead of {expected}");
}

#[test]
fn distances_equal_an_independent_implementation() {
    let expected = [
        (Backbone::Alex, 64, 0.028786031718582333, 0.011228197459813032),
        (Backbone::Vgg, 32, 0.042000111792848016, 0.007439590714498929),
        (Backbone::Squeeze, 66, 0.0512550786904486, 0.010433298887335638),
    ];
    for (backbone, side, signed, unsigned) in expected {
        let (a, b) = (image(side, side, noise), image(side, side, perturbed));
        let lpips = lpips(backbone);
        let distance = |range| lpips.distance([&a, &b], range).expect("large enough");
        assert_near(distance(InputRange::Signed), signed);
        assert_near(distance(InputRange::Unsigned), unsigned);
        assert_eq!(lpips.distance([&a, &a], InputRange::Signed), Some(0.0), "equal images");
    }
}

#[test]
fn distances_by_pixel_equal_an_independent_implementation() {
    let (mut a, mut b) = (image(64, 64, noise), image(64, 64, perturbed));
    let is_inside = |at: usize| (at as i64 % 64 - 30).pow(2) + 2 * (at as i64 / 64 - 22).pow(2) <= 324;
    for plane in a.planes.iter_mut().chain(&mut b.planes) {
        plane.iter_mut().enumerate().filter(|(at, _)| !is_inside(*at)).for_each(|(_, value)| *value = 0.0);
    }
    let map = lpips(Backbone::Alex).distance_by_pixel([&a, &b], InputRange::Signed).expect("large enough");
    let inside: Vec<f64> = map.iter().enumerate().filter(|(at, _)| is_inside(*at)).map(|(_, value)| *value).collect();
    assert_near(inside.iter().sum::<f64>() / inside.len() as f64, 0.038716351113276266);
}

#[test]
fn small_images_have_no_distance() {
    for (backbone, least) in [(Backbone::Alex, 31), (Backbone::Vgg, 16), (Backbone::Squeeze, 25)] {
        assert!(backbone.fits(least, 64) && backbone.fits(64, least), "{backbone:?}");
        assert!(!backbone.fits(least - 1, 64) && !backbone.fits(64, least - 1), "{backbone:?}");
    }
    let small = image(30, 64, noise);
    assert_eq!(lpips(Backbone::Alex).distance([&small, &small], InputRange::Signed), None);
}

#[test]
fn wrong_tensors_are_named() {
    let [body, heads] = generated(Backbone::Alex);
    type Tensors = BTreeMap<String, Tensor>;
    let refused = |change: &dyn Fn(&mut Tensors, &mut Tensors), expected: &str| {
        let (mut body, mut heads) = (body.clone(), heads.clone());
        change(&mut body, &mut heads);
        let error = Lpips::new(Backbone::Alex, &body, &heads).err().expect("must be refused");
        assert!(error.contains(expected), "{error}");
    };
    refused(&|body, _| drop(body.remove("features.6.bias")), "tensor features.6.bias is missing");
    refused(&|body, _| body.get_mut("features.3.weight").unwrap().shape.reverse(), "features.3.weight has shape");
    refused(&|body, _| body.get_mut("features.0.bias").unwrap().values[5] = f32::NAN, "features.0.bias[5] is NaN");
    refused(&|_, heads| drop(heads.remove("lin4.model.1.weight")), "tensor lin4.model.1.weight is missing");
}

#[test]
fn missing_files_are_named_and_altered_ones_refused() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let open = |backbone| Weights::open(dir.path(), backbone);
    assert!(matches!(open(Backbone::Alex), Ok(Weights::Missing(file)) if file.contains("alexnet-owt-7be5be79.pth")));
    let [body, heads] = generated(Backbone::Alex);
    std::fs::write(dir.path().join("alexnet-owt-4df8aa71.pth"), torch_bytes::archive(&body)).expect("written");
    assert!(matches!(open(Backbone::Alex), Ok(Weights::Missing(file)) if file.contains("alex.pth")));
    std::fs::write(dir.path().join("alex.pth"), torch_bytes::sequence(&heads)).expect("written");
    let error = open(Backbone::Alex).err().expect("must be refused").to_string();
    assert!(error.contains("that of the published file begins with 4df8aa71") && error.ends_with(".pth"), "{error}");
}

/// Reads the published heads, if they are available.
#[test]
fn published_heads_are_read() {
    let Some(folder) = support::data("lpips/lpips/weights/v0.1") else { return };
    for backbone in [Backbone::Alex, Backbone::Vgg, Backbone::Squeeze] {
        let heads = weights::read_head(&folder, backbone).expect("the published file");
        let lpips = Lpips::new(backbone, &generated(backbone)[0], &heads).expect("all heads");
        assert!(lpips.heads.iter().flatten().all(|weight| *weight >= 0.0), "heads are not negative");
        let (a, b) = (image(64, 64, noise), image(64, 64, perturbed));
        assert!(lpips.distance([&a, &b], InputRange::Signed).is_some_and(|distance| distance > 0.0));
    }
}

/// The README of LPIPS gives these distances of its example images (AlexNet, version 0.1).
#[test]
fn examples_of_the_authors_have_the_published_distances() {
    let (Some(images), Some(weights)) = (support::data("lpips/imgs"), support::data("lpips/alexnet-owt-7be5be79.pth"))
    else {
        return;
    };
    let folder = weights.parent().expect("a file in a folder");
    let Weights::Ready(lpips) = Weights::open(folder, Backbone::Alex).expect("published files") else {
        panic!("{} has no alex.pth", folder.display());
    };
    let read = |name: &str| Image::read(&images.join(name), Quantise::None, None).expect("an image");
    let reference = read("ex_ref.png");
    for (name, published) in [("ex_p0.png", 0.722), ("ex_p1.png", 0.138)] {
        let found = lpips.distance([&reference, &read(name)], InputRange::Signed).expect("large enough");
        assert!((found - published).abs() <= 5e-4, "{name}: {found}");
    }
}
