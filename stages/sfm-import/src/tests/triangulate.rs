//! Points of a rig without a cloud, compared with the surfaces that the rig sees.

use std::sync::LazyLock;

use glam::{DMat3, DVec3};
use scene::{Camera, Split};
use support::fakes::Fake;

use super::support::*;
use crate::recognise::read;
use crate::triangulate::{Triangulation, triangulate};
use crate::{Params, cloud_file::Points};

/// A rig whose images have enough pixels for patches.
fn fake() -> Fake {
    Fake { size: (192, 128), ..Fake::small(6, 2) }
}

/// A folder with the images of a rig.
fn folder(fake: &Fake) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    fake.neural_3d_video(dir.path());
    dir
}

/// The points of [`fake`] with its true poses.
static TRUE_POSES: LazyLock<(Points, Triangulation)> = LazyLock::new(|| found(folder(&fake()).path(), 0.0));

/// The points of the rig in `dir` after turning its cameras by an angle about their own axes, one more than the other.
fn found(dir: &std::path::Path, turn_radians: f64) -> (Points, Triangulation) {
    let mut frames = read(dir, &Params::default()).unwrap().frames;
    for frame in &mut frames {
        let turn = DMat3::from_rotation_x(turn_radians * f64::from(frame.camera_index % 3));
        frame.camera_from_world.rotation = turn * frame.camera_from_world.rotation;
        frame.camera_from_world.translation = turn * frame.camera_from_world.translation;
    }
    triangulate(&frames, Some([2.0, 8.0]), &|_, _| Ok(())).unwrap().unwrap()
}

#[test]
fn triangulated_points_lie_on_the_surfaces() {
    let fake = fake();
    let (points, found_in) = &*TRUE_POSES;
    let mut errors: Vec<f64> = points.iter().map(|(at, _)| fake.distance(DVec3::from(*at), 0)).collect();
    errors.sort_by(f64::total_cmp);
    let quantile = |share: f64| errors[(share * (errors.len() - 1) as f64) as usize];
    eprintln!("{found_in:?}, distances {:.3}, {:.3}, {:.3}", quantile(0.5), quantile(0.9), quantile(1.0));
    assert!(points.len() > 1000 && found_in.points == points.len() && found_in.views == 5);
    // A pixel of disparity between neighbours, 0.5 apart and 3.4 to 5.5 away, is 0.1 to 0.25.
    assert!(quantile(0.5) <= 0.03 && quantile(0.95) <= 0.1, "{} and {}", quantile(0.5), quantile(0.95));
    let on_ball = points.iter().filter(|(at, _)| at[2] < 0.0).count();
    assert!(on_ball > 50 && points.len() - on_ball > 500, "{on_ball} of {} points on the ball", points.len());
    // The colours are those that a camera sees there.
    let camera = fake.camera(2);
    let image = fake.image(2, 0);
    let differs = |(at, color): &([f64; 3], [u8; 3])| {
        let pixel = camera.project(DVec3::from(*at));
        let seen = image.get_pixel_checked(pixel.x as u32, pixel.y as u32)?;
        Some(seen.0.iter().zip(color).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / 3.0)
    };
    let differences: Vec<f64> = points.iter().filter_map(differs).collect();
    assert!(differences.iter().sum::<f64>() / (differences.len() as f64) < 12.0);
}

#[test]
fn a_search_reports_its_views_and_can_be_stopped() {
    let dir = folder(&Fake { size: (96, 64), ..Fake::small(6, 2) });
    let frames = read(dir.path(), &Params::default()).unwrap().frames;
    let calls = std::cell::RefCell::new(Vec::new());
    let stop_at = |last: usize| {
        calls.borrow_mut().clear();
        triangulate(&frames, None, &|done, all| {
            calls.borrow_mut().push((done, all));
            if done == last { anyhow::bail!("stopped") } else { Ok(()) }
        })
    };
    assert_eq!(stop_at(1).unwrap_err().to_string(), "stopped");
    assert_eq!(*calls.borrow(), [(0, 5), (1, 5)]);
    assert!(stop_at(5).is_ok());
    assert_eq!(calls.borrow().len(), 5);
}

/// Poses that are wrong by a degree lose most of the points, and the remaining points fit less well.
#[test]
fn wrong_poses_give_few_points() {
    let (good, bad) = (&TRUE_POSES.1, found(folder(&fake()).path(), 0.0175).1);
    assert!(bad.points * 4 < good.points && good.reprojection_px < 0.6, "{good:?} {bad:?}");
}

#[test]
fn rigs_without_a_cloud_are_triangulated_by_the_import() {
    let fake = fake();
    let (_root, capture) = run(folder(&fake).path(), &Params::default()).unwrap();
    let cloud = capture.load_points().unwrap().unwrap();
    let near = cloud.positions.iter().filter(|at| fake.distance(DVec3::from(at.map(f64::from)), 0) < 0.1).count();
    assert!(near * 10 > 9 * cloud.len(), "{near} of {}", cloud.len());
    let bounds = capture.bounds_world.unwrap();
    assert!((bounds[1][2] - 1.5).abs() < 0.3 && bounds[0][2] > -1.2, "{bounds:?}");
}

/// A rig of two training cameras cannot confirm a point, and an even surface has none.
#[test]
fn views_without_common_texture_give_no_points() {
    let dir = folder(&Fake { size: (96, 64), ..Fake::small(3, 1) });
    let frames = read(dir.path(), &Params::default()).unwrap().frames;
    assert!(triangulate(&frames, None, &|_, _| Ok(())).unwrap().is_none());
    let even = super::n3v::rig(&["cam00", "cam01", "cam02", "cam03"], 1);
    let (_root, capture) = run(even.path(), &Params::default()).unwrap();
    assert!(capture.load_points().unwrap().is_none());
}

/// Points of real images, checked in a view that was not used for them: their colours fit better than those of points
/// that are moved by a tenth of their depth.
#[test]
fn points_of_real_images_fit_the_held_out_view() {
    let Some(real) = support::data("n3dv_one_frame_5views/data") else { return };
    let dir = tempfile::tempdir().unwrap();
    std::fs::copy(real.join("poses_bounds.npy"), dir.path().join("poses_bounds.npy")).unwrap();
    for (name, index) in ["cam00", "cam03", "cam05", "cam08", "cam14"].iter().zip(1..) {
        std::fs::create_dir(dir.path().join(name)).unwrap();
        std::fs::copy(real.join(format!("images_4/{index}.png")), dir.path().join(format!("{name}/0000.png"))).unwrap();
    }
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let cloud = capture.load_points().unwrap().unwrap();
    let (_, view) = capture.views_of(Split::Test).next().unwrap();
    let image = capture.load_image(view).unwrap();
    let differs = |camera: &Camera, depth_scale: f64| {
        let each = cloud.positions.iter().zip(&cloud.colors).filter_map(|(at, color)| {
            let at = DVec3::from(at.map(f64::from));
            let from = capture.views_of(Split::Train).next()?.1.camera.position_world();
            let (pixel, _) = camera.project(from + depth_scale * (at - from))?;
            let seen = image.get_pixel_checked(pixel.x as u32, pixel.y as u32)?;
            Some(seen.0.iter().zip(color).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / 3.0)
        });
        let each: Vec<f64> = each.collect();
        each.iter().sum::<f64>() / each.len() as f64
    };
    let [right, nearer, farther] = [1.0, 0.9, 1.1].map(|scale| differs(&view.camera, scale));
    eprintln!("{} points; mean difference {right:.1}, moved {nearer:.1} and {farther:.1} grey levels", cloud.len());
    assert!(cloud.len() > 1000 && right < 0.7 * nearer && right < 0.7 * farther);
}
