use super::*;

fn grey(width: u32, height: u32, values: &[f32]) -> FloatImage {
    FloatImage { width, height, channels: 1, values: values.to_vec() }
}

#[test]
fn area_filter_averages_the_covered_pixels() {
    let image = grey(3, 1, &[0.0, 0.6, 0.9]);
    let half = image.resized(2, 1, ResizeFilter::Area);
    // Each new pixel covers one and a half old ones.
    let expected = [(0.0 + 0.5 * 0.6) / 1.5, (0.5 * 0.6 + 0.9) / 1.5];
    assert!(half.values.iter().zip(expected).all(|(value, expected)| (value - expected).abs() <= 1e-7), "{half:?}");
    let columns = grey(2, 2, &[0.1, 0.3, 0.5, 0.9]).resized(1, 1, ResizeFilter::Area);
    assert!((columns.values[0] - 0.45).abs() <= 1e-7);
}

#[test]
fn area_filter_keeps_the_mean_of_an_image() {
    let image = grey(7, 5, &(0..35).map(|index| (index * 37 % 100) as f32 / 100.0).collect::<Vec<_>>());
    let small = image.resized(3, 2, ResizeFilter::Area);
    let mean = |image: &FloatImage| image.values.iter().sum::<f32>() / image.values.len() as f32;
    assert!((mean(&image) - mean(&small)).abs() <= 1e-6);
}

#[test]
fn lanczos_keeps_constants_and_smooth_waves() {
    let constant = grey(9, 4, &[0.3; 36]).resized(5, 7, ResizeFilter::Lanczos3);
    assert!(constant.values.iter().all(|value| (value - 0.3).abs() <= 1e-6));
    let wave = |count: u32| {
        (0..count).map(move |at| 0.5 + 0.4 * ((f64::from(at) + 0.5) / f64::from(count) * 6.0).sin() as f32)
    };
    let small = grey(120, 1, &wave(120).collect::<Vec<_>>()).resized(30, 1, ResizeFilter::Lanczos3);
    // The filter is truncated at the borders; the interior follows the wave.
    let inside = small.values.iter().zip(wave(30)).skip(4).take(22);
    let worst = inside.fold(0.0_f32, |worst, (value, expected)| worst.max((value - expected).abs()));
    assert!(worst <= 2e-3, "{worst}");
}

#[test]
fn resizing_commutes_with_transposition() {
    let image = grey(6, 6, &(0..36).map(|index| (index * index % 17) as f32 / 17.0).collect::<Vec<_>>());
    for filter in [ResizeFilter::Area, ResizeFilter::Lanczos3] {
        let a = image.transposed().resized(4, 3, filter);
        let b = image.resized(3, 4, filter).transposed();
        assert!(a.values.iter().zip(&b.values).all(|(a, b)| (a - b).abs() <= 1e-6));
    }
}

#[test]
fn compositing_rounds_once_half_up() {
    let image = RgbaImage::from_raw(2, 1, vec![255, 0, 100, 128, 10, 20, 30, 0]).unwrap();
    let composited = FloatImage::composited(&image, [1.0, 1.0, 1.0]).to_rgb8().unwrap();
    // 0 · 128/255 + 255 · 127/255 = 127; 100 · 128/255 + 127 = 177.196
    assert_eq!(composited.as_raw(), &[255, 127, 177, 255, 255, 255]);
    assert_eq!(FloatImage::alpha_of(&image).to_grey8().unwrap().as_raw(), &[128, 0]);
    assert_eq!([0.5 / 255.0, 0.499 / 255.0, 1.5, -0.2, f32::NAN].map(to_byte), [1, 0, 255, 0, 0]);
}

#[test]
fn eight_bit_values_survive_the_round_trip() {
    let bytes: Vec<u8> = (0..=255).flat_map(|value| [value; 3]).collect();
    let image = RgbImage::from_raw(256, 1, bytes).unwrap();
    assert_eq!(FloatImage::from_rgb(&image).to_rgb8().unwrap(), image);
    assert!(FloatImage::from_rgb(&image).to_grey8().is_err());
}
