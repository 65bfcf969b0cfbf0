use crate::lens::{Distortion, Lens, plane_point};
use crate::params::Resize;
use crate::pixels::{Labels, Raster};

fn ramp(width: usize, height: usize) -> Raster {
    let values = (0..height).flat_map(|row| (0..width).map(move |column| (2 * column + 3 * row) as f32));
    Raster { width, height, channels: 1, values: values.collect() }
}

#[test]
fn area_is_the_mean_over_the_pixel() {
    let half = ramp(8, 6).resized(4, 3, Resize::Area);
    // The mean of 2 x + 3 y over a 2×2 block is its value in the block's centre.
    let expected: Vec<f32> = (0..3).flat_map(|row| (0..4).map(move |column| (4 * column + 6 * row) as f32 + 2.5)).collect();
    assert_eq!(half.values, expected);
    // 3 pixels to 2: each output covers one and a half.
    let row = Raster { width: 3, height: 1, channels: 1, values: vec![0.0, 30.0, 90.0] };
    let [left, right] = row.resized(2, 1, Resize::Area).values[..] else { panic!("two pixels") };
    assert!((left - 10.0).abs() <= 1e-4 && (right - 70.0).abs() <= 1e-4, "{left} {right}");
}

#[test]
fn filters_keep_constants_and_ramps() {
    for filter in [Resize::Area, Resize::Lanczos3] {
        let flat = Raster { width: 17, height: 13, channels: 3, values: vec![200.0; 17 * 13 * 3] };
        let small = flat.resized(5, 4, filter);
        assert_eq!((small.width, small.height, small.values.len()), (5, 4, 60));
        assert!(small.values.iter().all(|value| (value - 200.0).abs() <= 1e-3));
        // Away from the border a ramp stays the ramp, sampled at the new pixel centres.
        let reduced = ramp(64, 64).resized(16, 16, filter);
        for row in 4..12 {
            for column in 4..12 {
                let expected = 2.0 * (4.0 * column as f32 + 1.5) + 3.0 * (4.0 * row as f32 + 1.5);
                let value = reduced.values[row * 16 + column];
                assert!((value - expected).abs() <= 2e-2, "{filter:?} {value} {expected}");
            }
        }
    }
}

#[test]
fn lanczos_keeps_detail_that_area_blurs() {
    let stripes = (0..64).map(|column| if (column / 8) % 2 == 0 { 0.0 } else { 200.0 }).collect();
    let image = Raster { width: 64, height: 1, channels: 1, values: stripes };
    let spread = |filter| {
        let values = image.clone().resized(24, 1, filter).values;
        values.iter().fold(0.0_f32, |most, value| most.max((value - 100.0).abs()))
    };
    assert!(spread(Resize::Lanczos3) > spread(Resize::Area));
}

#[test]
fn rounding_is_half_up_and_clamped() {
    let image = Raster { width: 5, height: 1, channels: 1, values: vec![-3.0, 0.5, 1.49, 254.5, 300.0] };
    assert_eq!(image.into_grey().into_raw(), [0, 1, 1, 255, 255]);
}

#[test]
fn undistortion_looks_up_the_ramp_bilinearly() {
    let intrinsics = scene::Intrinsics { width: 64, height: 48, focal_x: 60.0, focal_y: 60.0, center_x: 32.0, center_y: 24.0 };
    let lens = Lens { intrinsics, distortion: Distortion { k1: 0.08, k2: -0.01, p1: 0.002, p2: 0.001 } };
    let target = lens.undistorted().unwrap();
    let image = ramp(64, 48).undistorted(&lens, &target);
    for row in 0..48 {
        for column in 0..64 {
            // A ramp is linear, so bilinear look-up is exact: 2 (x − ½) + 3 (y − ½) at the distorted position.
            let pixel = lens.pixel(plane_point(&target, column, row));
            let expected = 2.0 * (pixel.x - 0.5) + 3.0 * (pixel.y - 0.5);
            let value = f64::from(image.values[(row * 64 + column) as usize]);
            assert!((value - expected).abs() <= 1e-3, "({column}, {row}) {value} {expected}");
        }
    }
    let pinhole = Lens::pinhole(intrinsics);
    assert_eq!(ramp(64, 48).undistorted(&pinhole, &intrinsics), ramp(64, 48));
}

#[test]
fn mask_values_become_instances_or_one_object() {
    let values = |present: &[usize]| {
        let mut values = [false; 256];
        present.iter().for_each(|&value| values[value] = true);
        values
    };
    assert_eq!(Labels::of_values(&values(&[0])).class_names, [] as [&str; 0]);
    assert_eq!(Labels::of_values(&values(&[0, 255])).class_names, ["object"]);
    assert_eq!(Labels::of_values(&values(&[0, 38, 75])).class_names, ["object 1", "object 2"]);
    let blurred: Vec<usize> = (0..256).step_by(5).collect();
    assert_eq!(Labels::of_values(&values(&blurred)).class_names, ["object"]);
}
