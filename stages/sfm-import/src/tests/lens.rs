//! Lens distortion and its pinhole.

use glam::DVec2;

use super::support::intrinsics;
use crate::lens::{Distortion, Lens, plane_point};

/// Inverts the distortion by fixed-point iteration, independently of the product code.
fn undistort(lens: &Lens, pixel: DVec2) -> DVec2 {
    let k = lens.intrinsics;
    let bent = (pixel - DVec2::new(k.center_x, k.center_y)) / DVec2::new(k.focal_x, k.focal_y);
    let mut point = bent;
    for _ in 0..200 {
        point += bent - lens.distortion.apply(point);
    }
    point
}

#[test]
fn distortion_equals_opencvs_formula() {
    // The formula of cv2.projectPoints, written out for one point with r² = 0.05.
    let distortion = Distortion { k1: 0.1, k2: -0.05, k3: 2.0, p1: 0.001, p2: -0.002 };
    let (x, y, r2) = (0.1_f64, -0.2_f64, 0.05_f64);
    let radial = 1.0 + 0.1 * r2 - 0.05 * r2 * r2 + 2.0 * r2 * r2 * r2;
    let expected = DVec2::new(
        x * radial + 2.0 * 0.001 * x * y - 0.002 * (r2 + 2.0 * x * x),
        y * radial + 0.001 * (r2 + 2.0 * y * y) - 2.0 * 0.002 * x * y,
    );
    assert!(distortion.apply(DVec2::new(x, y)).distance(expected) <= 1e-15);
    let lens = Lens { intrinsics: intrinsics(), distortion };
    let round_trip = lens.pixel(undistort(&lens, DVec2::new(20.0, 3.0)));
    assert!(round_trip.distance(DVec2::new(20.0, 3.0)) <= 1e-12);
}

#[test]
fn the_undistorted_pinhole_sees_only_pixels_of_the_lens() {
    for distortion in [
        Distortion { k1: -0.2, ..Distortion::default() },
        Distortion { k1: 0.2, k2: 0.1, ..Distortion::default() },
        Distortion { k1: 0.1, k2: -0.05, k3: 0.02, p1: 0.01, p2: -0.02 },
    ] {
        let lens = Lens { intrinsics: intrinsics(), distortion };
        let target = lens.undistorted().unwrap();
        assert_eq!((target.width, target.height), (lens.intrinsics.width, lens.intrinsics.height));
        let zoom = target.focal_x / lens.intrinsics.focal_x;
        assert!((1.0..1.5).contains(&zoom), "{zoom}");
        for row in 0..target.height {
            for column in 0..target.width {
                let pixel = lens.pixel(plane_point(&target, column, row));
                assert!(pixel.x >= 0.5 && pixel.x <= 23.5 && pixel.y >= 0.5 && pixel.y <= 15.5, "{pixel}");
            }
        }
        // The zoom is the smallest one: a slightly smaller zoom leaves the image, unless no crop was needed.
        let border = |zoom: f64| {
            let k = scene::Intrinsics { focal_x: 30.0 * zoom, focal_y: 30.0 * zoom, ..lens.intrinsics };
            let corners = [(0, 0), (23, 0), (0, 15), (23, 15), (0, 8), (23, 8), (12, 0), (12, 15)];
            corners
                .iter()
                .map(|&(c, r)| lens.pixel(plane_point(&k, c, r)))
                .any(|p| p.x < 0.5 || p.x > 23.5 || p.y < 0.5 || p.y > 15.5)
        };
        assert!(zoom == 1.0 || border(zoom * 0.98), "zoom {zoom} is larger than needed");
    }
}

#[test]
fn folding_distortion_is_refused() {
    let lens = Lens { intrinsics: intrinsics(), distortion: Distortion { k1: -40.0, ..Distortion::default() } };
    let message = lens.undistorted().unwrap_err().to_string();
    assert!(message.contains("folds the image over"), "{message}");
    let nan = Lens { intrinsics: intrinsics(), distortion: Distortion { k1: f64::NAN, ..Distortion::default() } };
    assert!(nan.undistorted().is_err());
}
