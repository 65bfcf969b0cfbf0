//! Scenes as ScanNet's reader exports them: cameras that look at the wall z = 4.

use std::path::Path;

use image::{ImageBuffer, Luma};
use scene::{Camera, Intrinsics, Split};
use tempfile::TempDir;

use super::estimators::{assert_points_on_the_wall, camera_between, known_share, params};
use super::support::*;
use super::tum::{write_depth, write_grey};
use crate::inspect::inspect;
use crate::recognise::read;
use crate::{Format, Params};

/// Frames of the recording between two exported ones.
const STEP: usize = 10;

/// The pinhole of the images, whose aspect ratio is not that of the depth maps, as in ScanNet.
fn intrinsics() -> Intrinsics {
    Intrinsics { width: 52, height: 39, focal_x: 60.0, focal_y: 60.5, center_x: 25.5, center_y: 20.5 }
}

/// The pinhole of the depth maps.
fn depth_intrinsics() -> Intrinsics {
    Intrinsics { width: 24, height: 16, focal_x: 24.0, focal_y: 25.0, center_x: 12.5, center_y: 7.5 }
}

/// A 4×4 matrix of a lens, whose pixels are counted from the centre of the first one.
fn lens_text(k: &Intrinsics) -> String {
    let (x, y) = (k.center_x - 0.5, k.center_y - 0.5);
    format!("{} 0.000000 {x} 0.000000\n0.000000 {} {y} 0.000000\n0 0 1 0\n0 0 0 1\n", k.focal_x, k.focal_y)
}

fn pose_text(camera: &Camera) -> String {
    let pose = camera.camera_from_world.inverse();
    let rows = pose.rotation.transpose().to_cols_array_2d();
    let row = |axis: usize| {
        let [x, y, z] = rows[axis];
        format!("{x:.6} {y:.6} {z:.6} {:.6}\n", pose.translation[axis])
    };
    format!("{}{}{}0.000000 0.000000 0.000000 1.000000\n", row(0), row(1), row(2))
}

/// A scene of this many images.
fn scene(count: usize) -> TempDir {
    let dir = TempDir::new().unwrap();
    let write = |name: String, text: String| support::fakes::write(&dir.path().join(name), text);
    for at in 0..count {
        let (number, camera) = (at * STEP, camera_between(at as f64, intrinsics()));
        write_grey(&dir.path().join(format!("color/{number}.jpg")), (52, 39), 40 * (at as u8 + 1));
        let depth_camera = Camera { intrinsics: depth_intrinsics(), ..camera };
        write_depth(&dir.path().join(format!("depth/{number}.png")), &depth_camera, 1000.0);
        write(format!("pose/{number}.txt"), pose_text(&camera));
    }
    write("intrinsic/intrinsic_color.txt".into(), lens_text(&intrinsics()));
    write("intrinsic/intrinsic_depth.txt".into(), lens_text(&depth_intrinsics()));
    for name in ["extrinsic_color", "extrinsic_depth"] {
        write(format!("intrinsic/{name}.txt"), "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n".into());
    }
    dir
}

#[test]
fn scenes_have_poses_depth_and_points() {
    let dir = scene(3);
    let (_root, capture) = run(dir.path(), &params()).unwrap();
    assert_eq!((capture.views.len(), capture.pose_source.as_str()), (3, "scannet"));
    for (at, view) in capture.views.iter().enumerate() {
        let expected = camera_between(at as f64, intrinsics());
        let moved = (view.camera.camera_from_world.translation - expected.camera_from_world.translation).length();
        assert!(moved < 1e-5 && view.camera.intrinsics == expected.intrinsics, "{at}: {moved}");
        let secs = (at * STEP) as f64 / 30.0;
        assert!((view.time_secs - secs).abs() < 1e-9 && view.frame_index as usize == at * STEP);
    }
    assert!((capture.time_map.frame_secs - 1.0 / 3.0).abs() < 1e-9, "{:?}", capture.time_map);
    // The depth maps see a wider angle than the images to the left and the right, but not above and below.
    let share = known_share(&capture);
    assert!((0.9..1.0).contains(&share), "{share}");
    assert_points_on_the_wall(&capture);
    let text = inspect(dir.path()).unwrap().text();
    for part in ["ScanNet", "3 at one instant", "static = true", "3 maps", "ready to import"] {
        assert!(text.contains(part), "{part:?} is not in\n{text}");
    }
    assert!(!text.contains("ignored"), "{text}");
}

/// A depth map whose values state their column: the lens of the maps, not that of the images, decides where each is seen.
#[test]
fn depth_is_sampled_with_its_own_lens() {
    let dir = scene(1);
    let columns = |column: u32, _| Luma([1000 * (column as u16 + 1)]);
    ImageBuffer::<Luma<u16>, Vec<u16>>::from_fn(24, 16, columns).save(dir.path().join("depth/0.png")).unwrap();
    let (_root, capture) = run(dir.path(), &params()).unwrap();
    let depth = capture.load_depth(&capture.views[0]).unwrap().unwrap();
    for column in [0_usize, 10, 25, 40, 51] {
        let ray = (column as f64 + 0.5 - 25.5) / 60.0;
        let expected = (24.0 * ray + 12.5).floor() + 1.0;
        assert_eq!(f64::from(depth.depth_view[20 * 52 + column]), expected, "{column}");
    }
}

#[test]
fn images_without_tracking_are_skipped() {
    let dir = scene(5);
    let lost = "-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n";
    std::fs::write(dir.path().join("pose/20.txt"), lost).unwrap();
    std::fs::remove_file(dir.path().join("depth/30.png")).unwrap();
    let capture = read(dir.path(), &Params { every_nth: 2, ..Params::default() }).unwrap();
    assert_eq!(capture.frames.iter().map(|frame| frame.frame_index).collect::<Vec<_>>(), [0, 10, 30, 40]);
    assert_eq!((capture.count(Split::Train), capture.count(Split::Test)), (2, 2));
    assert_eq!(capture.frames.iter().map(|frame| frame.depth.is_some()).collect::<Vec<_>>(), [true, true, false, true]);
    let expected = "1 of 5 images are skipped: tracking was lost, and their pose is not finite (e.g. 20.jpg)";
    assert_eq!(capture.warnings, [expected]);
    let fixed = read(dir.path(), &Params { static_scene: Some(true), ..Params::default() }).unwrap();
    assert!(fixed.is_one_instant() && fixed.format == Format::ScanNet);
}

#[test]
fn scenes_without_a_depth_lens_have_registered_depth() {
    let dir = scene(2);
    std::fs::remove_file(dir.path().join("intrinsic/intrinsic_depth.txt")).unwrap();
    for at in 0..2 {
        let path = dir.path().join(format!("depth/{}.png", at * STEP));
        write_depth(&path, &camera_between(at as f64, intrinsics()), 1000.0);
    }
    let (_root, capture) = run(dir.path(), &params()).unwrap();
    assert_eq!(known_share(&capture), 1.0);
    std::fs::remove_dir_all(dir.path().join("depth")).unwrap();
    let capture = read(dir.path(), &params()).unwrap();
    assert!(capture.points.is_empty() && capture.cloud.is_none());
}

#[test]
fn faulty_scenes_are_refused_with_file_and_line() {
    let mut refusals = Refusals::default();
    let mut add = |damage: &dyn Fn(&Path)| {
        let dir = scene(2);
        damage(dir.path());
        refusals.add(dir.path(), &params());
    };
    let lost = "-inf -inf -inf -inf\n".repeat(4);
    let texts: [(&str, &str); 8] = [
        ("pose/10.txt", ""),
        ("pose/10.txt", "1 0 0 0\n0 1 0\n0 0 1 0\n0 0 0 1\n"),
        ("pose/10.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n0.1 0 0 1\n"),
        ("pose/10.txt", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
        ("intrinsic/intrinsic_color.txt", &lost),
        ("intrinsic/intrinsic_color.txt", "1170 0 647 0\n0 1170 483 0\n0 0 1 0\n0 0 0 1\n"),
        ("intrinsic/intrinsic_depth.txt", "577 0 319 0\n0 577 239 0\n0 0 1 0\n0 0 0 1\n"),
        ("intrinsic/intrinsic_depth.txt", "24 1 12 0\n0 25 7 0\n0 0 1 0\n0 0 0 1\n"),
    ];
    for (name, text) in texts {
        add(&|dir| std::fs::write(dir.join(name), text).unwrap());
    }
    add(&|dir| {
        ["0", "10"].iter().for_each(|name| std::fs::write(dir.join(format!("pose/{name}.txt")), &lost).unwrap())
    });
    add(&|dir| std::fs::remove_file(dir.join("pose/10.txt")).unwrap());
    add(&|dir| std::fs::remove_dir_all(dir.join("intrinsic")).unwrap());
    add(&|dir| write_grey(&dir.join("color/10.jpg"), (24, 16), 0));
    add(&|dir| write_depth(&dir.join("depth/10.png"), &camera_between(1.0, intrinsics()), 1000.0));
    add(&|dir| {
        std::fs::remove_dir_all(dir.join("color")).unwrap();
        std::fs::create_dir(dir.join("color")).unwrap();
    });
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn mangled_scenes_never_panic() {
    let dir = scene(2);
    for file in ["pose/10.txt", "intrinsic/intrinsic_color.txt", "intrinsic/intrinsic_depth.txt"] {
        let refused = support::mangle::refused(&dir.path().join(file), 200, |_| {
            let capture = read(dir.path(), &params())?;
            capture.problems().into_iter().next().map_or(Ok(()), Err)
        });
        assert!(refused > 60, "only {refused} of 200 damaged versions of {file} were refused: is it read at all?");
    }
}
