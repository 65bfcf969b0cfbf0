//! Lens distortion and its pinhole.

use glam::{DVec2, DVec3};
use scene::Intrinsics;
use scene::float_image::FloatImage;

use super::support::intrinsics;
use crate::colmap::camera_model::lens;
use crate::lens::{Distortion, Lens, plane_point};
use crate::pixels::undistorted;

/// COLMAP's camera models with coefficients of real lenses, for images of 320×240 pixels.
const REAL: [(&str, &[f64]); 11] = [
    ("SIMPLE_RADIAL", &[280.0, 161.0, 118.0, -0.06]),
    ("RADIAL", &[280.0, 161.0, 118.0, 0.12, -0.08]),
    ("OPENCV", &[280.0, 283.0, 161.0, 118.0, -0.31, 0.11, 0.001, -0.002]),
    ("FULL_OPENCV", &[280.0, 283.0, 161.0, 118.0, 0.5, -0.12, 1e-4, -5e-5, -0.006, 0.85, -0.05, -0.03]),
    ("SIMPLE_RADIAL_FISHEYE", &[120.0, 161.0, 118.0, -0.02]),
    ("RADIAL_FISHEYE", &[120.0, 161.0, 118.0, 0.03, -0.01]),
    ("OPENCV_FISHEYE", &[120.0, 121.0, 161.0, 118.0, -0.028, 0.007, -0.006, 0.001]),
    ("FOV", &[150.0, 150.0, 161.0, 118.0, 0.95]),
    ("THIN_PRISM_FISHEYE", &[180.5, 181.5, 161.0, 118.0, 0.21, 0.21, -5e-6, 5e-4, -0.16, 0.4, -8e-5, 8.6e-4]),
    ("SIMPLE_FISHEYE", &[110.0, 161.0, 118.0]),
    ("FISHEYE", &[110.0, 112.0, 161.0, 118.0]),
];

fn real_lenses() -> impl Iterator<Item = (&'static str, Lens)> {
    REAL.iter().map(|(model, params)| (*model, lens(model, 320, 240, params).unwrap()))
}

/// COLMAP's formulas, written out per model and apart from the product code: the offset of (u, v) on the sensor.
fn colmaps_formula(model: &str, params: &[f64], u: f64, v: f64) -> (f64, f64) {
    let radius = u.hypot(v);
    let theta = radius.atan();
    let (fu, fv) = (theta * u / radius, theta * v / radius);
    let fisheye = |k: [f64; 4]| {
        let t2 = theta * theta;
        let scale = theta * (1.0 + k[0] * t2 + k[1] * t2.powi(2) + k[2] * t2.powi(3) + k[3] * t2.powi(4)) / radius;
        (u * scale, v * scale)
    };
    let r2 = u * u + v * v;
    let tangential = |u: f64, v: f64, p1: f64, p2: f64| {
        let r2 = u * u + v * v;
        (2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u), 2.0 * p2 * u * v + p1 * (r2 + 2.0 * v * v))
    };
    match (model, params) {
        ("SIMPLE_RADIAL", [.., k]) => (u * (1.0 + k * r2), v * (1.0 + k * r2)),
        ("RADIAL", [.., k1, k2]) => {
            let scale = 1.0 + k1 * r2 + k2 * r2 * r2;
            (u * scale, v * scale)
        }
        ("OPENCV", [.., k1, k2, p1, p2]) => {
            let (scale, (du, dv)) = (1.0 + k1 * r2 + k2 * r2 * r2, tangential(u, v, *p1, *p2));
            (u * scale + du, v * scale + dv)
        }
        ("FULL_OPENCV", [_, _, _, _, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            let scale = (1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3))
                / (1.0 + k4 * r2 + k5 * r2.powi(2) + k6 * r2.powi(3));
            let (du, dv) = tangential(u, v, *p1, *p2);
            (u * scale + du, v * scale + dv)
        }
        ("SIMPLE_RADIAL_FISHEYE", [.., k]) => fisheye([*k, 0.0, 0.0, 0.0]),
        ("RADIAL_FISHEYE", [.., k1, k2]) => fisheye([*k1, *k2, 0.0, 0.0]),
        ("OPENCV_FISHEYE", [.., k1, k2, k3, k4]) => fisheye([*k1, *k2, *k3, *k4]),
        ("FOV", [.., omega]) => {
            let factor = (radius * 2.0 * (omega / 2.0).tan()).atan() / (radius * omega);
            (u * factor, v * factor)
        }
        ("THIN_PRISM_FISHEYE", [_, _, _, _, k1, k2, p1, p2, k3, k4, sx1, sy1]) => {
            let t2 = fu * fu + fv * fv;
            let scale = 1.0 + k1 * t2 + k2 * t2.powi(2) + k3 * t2.powi(3) + k4 * t2.powi(4);
            let (du, dv) = tangential(fu, fv, *p1, *p2);
            (fu * scale + du + sx1 * t2, fv * scale + dv + sy1 * t2)
        }
        ("SIMPLE_FISHEYE" | "FISHEYE", _) => (fu, fv),
        _ => panic!("{model}"),
    }
}

#[test]
fn distortion_equals_colmaps_formulas() {
    for ((model, lens), (_, params)) in real_lenses().zip(REAL) {
        for (u, v) in [(0.1, -0.2), (-0.7, 0.4), (1e-3, 2e-3), (0.9, 0.9)] {
            let expected = DVec2::from(colmaps_formula(model, params, u, v));
            let found = lens.distortion.apply(DVec2::new(u, v));
            assert!(found.distance(expected) <= 1e-14, "{model} at ({u}, {v}): {found} instead of {expected}");
        }
        let near_axis = lens.distortion.apply(DVec2::new(1e-9, 0.0)).x / 1e-9;
        let further = lens.distortion.apply(DVec2::new(1e-5, 0.0)).x / 1e-5;
        assert!((near_axis - further).abs() <= 1e-6, "{model}: {near_axis} jumps to {further} near the axis");
    }
}

/// Inverts a lens by Newton's method with a numeric derivative, apart from the product code.
fn ray(lens: &Lens, pixel: DVec2, start: DVec2) -> DVec2 {
    let mut point = start;
    for _ in 0..60 {
        let residual = lens.pixel(point) - pixel;
        let step = 1e-6;
        let dx = (lens.pixel(point + DVec2::X * step) - lens.pixel(point - DVec2::X * step)) / (2.0 * step);
        let dy = (lens.pixel(point + DVec2::Y * step) - lens.pixel(point - DVec2::Y * step)) / (2.0 * step);
        let change = glam::DMat2::from_cols(dx, dy).inverse() * residual;
        point -= change * (0.3 / change.length()).min(1.0);
        if change.length() <= 1e-13 {
            break;
        }
    }
    point
}

#[test]
fn every_pixel_of_the_pinhole_has_one_ray() {
    for (model, lens) in real_lenses() {
        let target = lens.undistorted().unwrap();
        let mut worst = 0.0_f64;
        for row in 0..target.height {
            for column in 0..target.width {
                let point = plane_point(&target, column, row);
                let pixel = lens.pixel(point);
                let inside = (0.5..=319.5).contains(&pixel.x) && (0.5..=239.5).contains(&pixel.y);
                assert!(inside, "{model}: ({column}, {row}) shows {pixel}");
                worst = worst.max(ray(&lens, pixel, DVec2::ZERO).distance(point));
            }
        }
        assert!(worst <= 1e-9, "{model}: another ray is {worst} away");
    }
}

/// Points that the distorted lens sees as blurred dots must be at their pinhole projections after undistortion.
#[test]
fn undistorted_dots_are_at_their_pinhole_projections() {
    for (model, lens) in real_lenses() {
        let target = lens.undistorted().unwrap();
        let points: Vec<DVec2> = (0..9 * 7)
            .map(|index| DVec2::new(f64::from(index % 9) - 4.0, f64::from(index / 9) - 3.0))
            .map(|at| DVec3::new(0.16 * at.x, 0.16 * at.y, 1.0) * (2.0 + at.x.abs()))
            .map(|point| point.truncate() / point.z)
            .collect();
        let dots: Vec<DVec2> = points.iter().map(|point| lens.pixel(*point)).collect();
        let image = drawn(&lens.intrinsics, &dots);
        let image = undistorted(image, &lens, &target);
        let pinhole = Lens::pinhole(target);
        let seen: Vec<DVec2> = points.iter().map(|point| pinhole.pixel(*point)).collect();
        let whole = |at: &&DVec2| at.x > 9.0 && at.y > 9.0 && at.x < 311.0 && at.y < 231.0;
        let errors: Vec<f64> = seen.iter().filter(whole).map(|at| centroid(&image, *at).distance(*at)).collect();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        assert!(errors.len() >= 20 && worst <= 0.1, "{model}: {worst} px over {} dots", errors.len());
        // The same image without undistortion must fail, or the test could not fail.
        let raw = drawn(&lens.intrinsics, &dots);
        let bent = seen.iter().filter(whole).map(|at| centroid(&raw, *at).distance(*at)).fold(0.0, f64::max);
        assert!(bent > 0.5, "{model}: the lens moves dots by only {bent} px");
    }
}

/// Dots with a standard deviation of 1.5 pixels.
fn drawn(size: &Intrinsics, dots: &[DVec2]) -> FloatImage {
    let mut values = Vec::new();
    for row in 0..size.height {
        for column in 0..size.width {
            let at = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            values.push(dots.iter().map(|dot| (-at.distance_squared(*dot) / 4.5).exp()).sum::<f64>() as f32);
        }
    }
    FloatImage { width: size.width, height: size.height, channels: 1, values }
}

/// The centre of mass within 7 pixels.
fn centroid(image: &FloatImage, near: DVec2) -> DVec2 {
    let (mut sum, mut mass) = (DVec2::ZERO, 0.0);
    for row in near.y as u32 - 8..near.y as u32 + 8 {
        for column in near.x as u32 - 8..near.x as u32 + 8 {
            let at = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            if at.distance(near) <= 7.0 {
                let value = f64::from(image.values[(row * image.width + column) as usize]);
                sum += value * at;
                mass += value;
            }
        }
    }
    sum / mass
}

fn bent(radial: [f64; 4], tangential: [f64; 2]) -> Lens {
    Lens { intrinsics: intrinsics(), distortion: Distortion::brown(radial, tangential) }
}

#[test]
fn the_zoom_of_the_pinhole_is_the_smallest() {
    for lens in [
        bent([-0.2, 0.0, 0.0, 0.0], [0.0; 2]),
        bent([0.2, 0.1, 0.0, 0.0], [0.0; 2]),
        bent([0.1, -0.05, 0.02, 0.0], [0.01, -0.02]),
    ] {
        let target = lens.undistorted().unwrap();
        assert_eq!((target.width, target.height), (lens.intrinsics.width, lens.intrinsics.height));
        let zoom = target.focal_x / lens.intrinsics.focal_x;
        assert!((1.0..1.5).contains(&zoom), "{zoom}");
        let leaves_image = |zoom: f64| {
            let k = Intrinsics { focal_x: 30.0 * zoom, focal_y: 30.0 * zoom, ..lens.intrinsics };
            let corners = [(0, 0), (23, 0), (0, 15), (23, 15), (0, 8), (23, 8), (12, 0), (12, 15)];
            corners
                .iter()
                .map(|&(c, r)| lens.pixel(plane_point(&k, c, r)))
                .any(|p| p.x < 0.5 || p.x > 23.5 || p.y < 0.5 || p.y > 15.5)
        };
        assert!(zoom == 1.0 || leaves_image(zoom * 0.98), "zoom {zoom} is larger than needed");
    }
}

#[test]
fn folding_distortion_is_refused() {
    let folds = |lens: Lens| lens.undistorted().unwrap_err().to_string().contains("folds the image over");
    assert!(folds(bent([-40.0, 0.0, 0.0, 0.0], [0.0; 2])));
    assert!(folds(bent([f64::NAN, 0.0, 0.0, 0.0], [0.0; 2])));
    // Rays are in order at the axis and at the border, but not between them.
    assert!(folds(bent([-25.0, 120.0, 0.0, 0.0], [0.0; 2])));
    let pole = Distortion::rational([0.0; 3], [-30.0, 0.0, 0.0], [0.0; 2]);
    assert!(folds(Lens { intrinsics: intrinsics(), distortion: pole }));
    let fisheye = Distortion::fisheye([-9.0, 20.0, 0.0, 0.0]);
    assert!(folds(Lens { intrinsics: intrinsics(), distortion: fisheye }));
}

#[test]
fn a_resized_lens_sees_the_same_rays() {
    for (model, lens) in real_lenses() {
        let half = lens.resized(160, 60);
        let point = DVec2::new(0.3, -0.2);
        let expected = lens.pixel(point) * DVec2::new(0.5, 0.25);
        assert!(half.pixel(point).distance(expected) <= 1e-12, "{model}");
    }
}

/// ETH3D's courtyard, whose calibration its homepage states, and the lenses of real captures.
#[test]
fn real_calibrations_are_invertible() {
    let courtyard = [
        3411.42,
        3410.02,
        3041.29,
        2014.07,
        0.21047,
        0.21102,
        -5.36231e-06,
        0.00051541,
        -0.158023,
        0.406856,
        -8.46499e-05,
        0.000861313,
    ];
    let lens_of_eth3d = lens("THIN_PRISM_FISHEYE", 6048, 4032, &courtyard).unwrap();
    let target = lens_of_eth3d.undistorted().unwrap();
    assert!((1.0..1.1).contains(&(target.focal_x / 3411.42)), "{}", target.focal_x);
    let Some(root) = support::data("formats/captures") else { return };
    for (name, count) in [
        ("colmap-opencv-fisheye", 1),
        ("colmap-opencv-8cams", 8),
        ("colmap-full-opencv-realitycapture", 92),
        ("colmap-rigs-frames-text", 1),
    ] {
        let cameras = crate::colmap::text_cameras(&root.join(name).join("cameras.txt")).unwrap();
        assert_eq!(cameras.len(), count, "{name}");
        for (id, lens) in cameras {
            let target = lens.undistorted().unwrap_or_else(|failure| panic!("{name}, camera {id}: {failure}"));
            eprintln!("{name}, camera {id}: zoom {:.3}", target.focal_x / lens.intrinsics.focal_x);
        }
    }
}
