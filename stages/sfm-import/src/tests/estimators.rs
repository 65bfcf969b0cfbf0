//! Outputs of feed-forward estimators, laid out as each tool writes them: cameras that look at the wall z = 4.

use std::io::Write as _;
use std::path::Path;

use glam::{DMat3, DVec3};
use image::{GrayImage, Luma, Rgb, RgbImage};
use scene::{Camera, Capture, Intrinsics, RigidTransform, Split, pixels};
use tempfile::TempDir;

use super::support::run;
use crate::inspect::inspect;
use crate::recognise::read;
use crate::{Format, Params};

/// Distance of the wall from the origin.
pub(super) const WALL: f64 = 4.0;

/// All views train, so that they stay in the order of time.
pub(super) fn params() -> Params {
    Params { every_nth: 0, ..Params::default() }
}

/// The `at`-th camera: it moves to the right, and turns a little to the left.
fn camera(at: usize, intrinsics: Intrinsics) -> Camera {
    camera_between(at as f64, intrinsics)
}

/// Like [`camera`], at any time.
pub(super) fn camera_between(at: f64, intrinsics: Intrinsics) -> Camera {
    let rotation = DMat3::from_rotation_y(-0.05 * at) * DMat3::from_rotation_x(0.02);
    let world_from_camera = RigidTransform { rotation, translation: DVec3::new(0.3 * at, 0.1, 0.0) };
    Camera { intrinsics, camera_from_world: world_from_camera.inverse() }
}

/// The depth of the wall in every pixel.
pub(super) fn wall(camera: &Camera) -> Vec<f32> {
    let world_from_camera = camera.camera_from_world.inverse();
    let depth = |center| {
        let direction = world_from_camera.rotation * camera.ray_view(center);
        ((WALL - world_from_camera.translation.z) / direction.z) as f32
    };
    pixels::centers(camera.intrinsics.width, camera.intrinsics.height).map(depth).collect()
}

/// The bytes of an `.npy` file.
pub(super) fn npy(descr: &str, shape: &[usize], data: &[u8]) -> Vec<u8> {
    let shape: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    header += &" ".repeat(63 - (10 + header.len()) % 64);
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(data);
    bytes
}

fn floats(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// An array of an archive: name, type, shape and values.
pub(super) type Member = (&'static str, &'static str, Vec<usize>, Vec<u8>);

/// Writes an archive as `np.savez` does.
fn write_npz(path: &Path, members: &[Member]) {
    let files = members.iter().map(|(name, descr, shape, data)| (*name, npy(descr, shape, data)));
    write_archive(path, &files.collect::<Vec<_>>());
}

/// Writes an archive of `.npy` files.
pub(super) fn write_archive(path: &Path, files: &[(&str, Vec<u8>)]) {
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    for (name, file) in files {
        archive.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(file).unwrap();
    }
    archive.finish().unwrap();
}

/// The rows of a 3×4 matrix.
fn rows(transform: &RigidTransform) -> Vec<f32> {
    let (rotation, translation) = (transform.rotation.transpose(), transform.translation);
    let row = |axis: usize| rotation.col(axis).extend(translation[axis]).as_vec4().to_array();
    [row(0), row(1), row(2)].concat()
}

/// The rows of the matrix of a pinhole.
fn matrix(k: &Intrinsics) -> Vec<f32> {
    [k.focal_x, 0.0, k.center_x, 0.0, k.focal_y, k.center_y, 0.0, 0.0, 1.0].map(|value| value as f32).to_vec()
}

/// `predictions.npz` of VGGT with the arrays of its demo, for cameras that see images of this size.
pub(super) fn vggt_arrays(count: usize, seen: Intrinsics) -> Vec<Member> {
    let (width, height) = (seen.width as usize, seen.height as usize);
    let cameras: Vec<Camera> = (0..count).map(|at| camera(at, seen)).collect();
    let confidence = (0..count * width * height).map(|at| if at % width < width / 4 { 1.0 } else { 5.0 });
    let gray = (0..count).flat_map(|at| vec![0.25 * (at + 1) as f32; 3 * width * height]);
    vec![
        ("depth", "<f4", vec![count, height, width, 1], floats(cameras.iter().flat_map(wall))),
        ("depth_conf", "<f4", vec![count, height, width], floats(confidence)),
        ("images", "<f4", vec![count, 3, height, width], floats(gray)),
        ("extrinsic", "<f4", vec![count, 3, 4], floats(cameras.iter().flat_map(|it| rows(&it.camera_from_world)))),
        ("intrinsic", "<f4", vec![count, 3, 3], floats(cameras.iter().flat_map(|it| matrix(&it.intrinsics)))),
    ]
}

/// Writes images, each of another grey level.
fn write_images(dir: &Path, names: &[&str], (width, height): (u32, u32)) {
    std::fs::create_dir_all(dir).unwrap();
    for (at, name) in names.iter().enumerate() {
        let level = 60 * (at as u8 + 1);
        RgbImage::from_pixel(width, height, Rgb([level, level, 255 - level])).save(dir.join(name)).unwrap();
    }
}

/// Asserts that depth, where it is known, is that of the wall, and returns the share of pixels with depth.
pub(super) fn known_share(capture: &Capture) -> f64 {
    let (mut known, mut all) = (0, 0);
    for view in &capture.views {
        let depth = capture.load_depth(view).unwrap().unwrap();
        for (found, expected) in depth.depth_view.iter().zip(wall(&view.camera)) {
            all += 1;
            known += usize::from(*found > 0.0);
            assert!(*found == 0.0 || (found / expected - 1.0).abs() < 0.02, "{} {found} {expected}", view.name);
        }
    }
    f64::from(known as u32) / f64::from(all)
}

pub(super) fn assert_points_on_the_wall(capture: &Capture) {
    let points = capture.load_points().unwrap().unwrap();
    assert!(points.positions.len() > 100, "{}", points.positions.len());
    for point in &points.positions {
        assert!((f64::from(point[2]) - WALL).abs() < 0.1, "{point:?}");
    }
}

pub(super) fn seen(width: u32, height: u32) -> Intrinsics {
    let (center_x, center_y) = (0.5 * f64::from(width), 0.5 * f64::from(height));
    Intrinsics { width, height, focal_x: 500.0, focal_y: 480.0, center_x, center_y }
}

#[test]
fn vggt_predictions_give_poses_depth_and_points_in_one_gauge() {
    let dir = TempDir::new().unwrap();
    // VGGT sorts names as text.
    write_images(&dir.path().join("images"), &["frame_1.png", "frame_10.png", "frame_2.png"], (74, 37));
    write_npz(&dir.path().join("predictions.npz"), &vggt_arrays(3, seen(518, 252)));
    let (_root, capture) = run(dir.path(), &Params { unsure_share: 0.3, ..params() }).unwrap();
    let names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["frame_1", "frame_2", "frame_10"]);
    for (view, at) in capture.views.iter().zip([0, 2, 1]) {
        let expected = camera(at, seen(518, 252).resized(74, 37));
        let moved = view.camera.camera_from_world.translation - expected.camera_from_world.translation;
        assert!(moved.length() < 1e-6, "{}: {moved}", view.name);
        assert!((view.camera.intrinsics.focal_y - expected.intrinsics.focal_y).abs() < 1e-3);
        let image = capture.load_image(view).unwrap();
        assert_eq!(image.get_pixel(3, 3).0[0], 60 * (at as u8 + 1), "{}", view.name);
    }
    let share = known_share(&capture);
    assert!((share - 0.75).abs() < 0.02, "{share}: the unsure quarter on the left is unknown");
    assert_points_on_the_wall(&capture);
    let all = run(dir.path(), &Params { unsure_share: 0.0, ..params() }).unwrap();
    assert_eq!(known_share(&all.1), 1.0);
    let text = inspect(dir.path()).unwrap().text();
    assert!(text.contains("VGGT (predictions.npz)") && text.contains("depth"), "{text}");
}

#[test]
fn vggt_may_see_tall_images_padded_to_squares() {
    let dir = TempDir::new().unwrap();
    write_images(&dir.path().join("images"), &["a.png", "b.png"], (20, 37));
    let mut arrays = vggt_arrays(2, seen(518, 518));
    let columns = (0..2 * 3 * 518 * 518).map(|at| if (119..399).contains(&(at % 518)) { 0.25 } else { 1.0 });
    arrays[2].3 = floats(columns);
    write_npz(&dir.path().join("predictions.npz"), &arrays);
    let (_root, capture) = run(dir.path(), &Params { unsure_share: 0.0, ..params() }).unwrap();
    let intrinsics = capture.views[0].camera.intrinsics;
    assert!((intrinsics.center_x - 10.0).abs() < 1e-6, "{intrinsics:?}");
    assert!((intrinsics.focal_y - 480.0 * 37.0 / 518.0).abs() < 1e-3, "{intrinsics:?}");
    assert_eq!(known_share(&capture), 1.0);
    arrays.remove(2);
    write_npz(&dir.path().join("predictions.npz"), &arrays);
    let warnings = read(dir.path(), &params()).unwrap().warnings;
    assert!(warnings.iter().any(|it| it.contains("save the array images, too")), "{warnings:?}");
}

#[test]
fn vggt_depth_of_tall_images_covers_their_middle() {
    let dir = TempDir::new().unwrap();
    write_images(&dir.path().join("images"), &["a.png", "b.png"], (20, 40));
    write_npz(&dir.path().join("predictions.npz"), &vggt_arrays(2, seen(518, 518)));
    let (_root, capture) = run(dir.path(), &Params { unsure_share: 0.0, ..params() }).unwrap();
    let intrinsics = capture.views[0].camera.intrinsics;
    assert!((intrinsics.center_y - 20.0).abs() < 1e-6 && (intrinsics.focal_x - 500.0 * 20.0 / 518.0).abs() < 1e-3);
    assert_eq!(known_share(&capture), 0.5);
    let depth = capture.load_depth(&capture.views[1]).unwrap().unwrap();
    let row_is_known = |row: usize| depth.depth_view[row * 20..][..20].iter().all(|value| *value > 0.0);
    assert!(!row_is_known(9) && row_is_known(10) && row_is_known(29) && !row_is_known(30));
}

#[test]
fn vggt_predictions_without_images_bring_their_own() {
    let dir = TempDir::new().unwrap();
    write_npz(&dir.path().join("predictions.npz"), &vggt_arrays(2, seen(56, 28)));
    let (_root, capture) = run(dir.path(), &params()).unwrap();
    let levels: Vec<u8> =
        capture.views.iter().map(|view| capture.load_image(view).unwrap().get_pixel(0, 0).0[0]).collect();
    assert_eq!(levels, [64, 128]);
}

#[test]
fn faulty_predictions_are_refused() {
    let refusal = |members: &[Member], images: &[&str]| {
        let dir = TempDir::new().unwrap();
        if !images.is_empty() {
            write_images(&dir.path().join("images"), images, (40, 20));
        }
        write_npz(&dir.path().join("predictions.npz"), members);
        format!("{:#}", run(dir.path(), &params()).unwrap_err())
    };
    let arrays = || vggt_arrays(2, seen(56, 28));
    let message = refusal(&arrays(), &["a.png"]);
    assert!(message.contains("predictions of 2 frames, but 1 images"), "{message}");
    let message = refusal(&vggt_arrays(2, seen(56, 42)), &["a.png", "b.png"]);
    assert!(message.contains("depth of 56×42 pixels does not fit images of 40×20"), "{message}");
    let message = refusal(&arrays()[..4], &[]);
    assert!(message.contains("no array intrinsic"), "{message}");
    let without_images: Vec<Member> = arrays().into_iter().filter(|(name, ..)| *name != "images").collect();
    let message = refusal(&without_images, &[]);
    assert!(message.contains("no array images; put the images that VGGT read into images/"), "{message}");
    let mut turned = arrays();
    turned[3].2 = vec![2, 4, 3];
    assert!(refusal(&turned, &[]).contains("extrinsic has the shape [2, 4, 3] instead of that of 2 frames"));
    let mut broken = arrays();
    broken[3].3[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(refusal(&broken, &[]).contains("extrinsic contains NaN"));
}

#[test]
fn truncated_and_huge_archives_are_refused_with_their_name() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("predictions.npz");
    let mut arrays = vggt_arrays(2, seen(14, 14));
    arrays[0].2 = vec![2, 1 << 40, 1 << 40, 1];
    write_npz(&path, &arrays);
    assert!(format!("{:#}", run(dir.path(), &params()).unwrap_err()).contains("predictions.npz"));
    write_npz(&path, &vggt_arrays(2, seen(14, 14)));
    let bytes = std::fs::read(&path).unwrap();
    for end in (0..bytes.len()).step_by(61) {
        std::fs::write(&path, &bytes[..end]).unwrap();
        let message = format!("{:#}", run(dir.path(), &params()).unwrap_err());
        assert!(message.contains("predictions.npz"), "{end} bytes: {message}");
    }
}

/// The archive of MegaSaM for three frames of a wall with sky above it.
pub(super) fn megasam_arrays() -> [Member; 4] {
    let intrinsics = Intrinsics { focal_x: 40.0, focal_y: 40.0, ..seen(32, 24) };
    let poses: Vec<f32> = (0..3)
        .flat_map(|at| [1.0, 0.0, 0.0, 0.2 * at as f32, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        .collect();
    // Half floats: 4, and 100 in the first row, where MegaSaM clips the sky.
    let depths = (0..3 * 24 * 32).flat_map(|at| if at % (24 * 32) < 32 { 0x5640_u16 } else { 0x4400 }.to_le_bytes());
    let colors = (0..3_u8).flat_map(|at| vec![50 * (at + 1); 24 * 32 * 3]);
    [
        ("images", "|u1", vec![3, 24, 32, 3], colors.collect()),
        ("depths", "<f2", vec![3, 24, 32], depths.collect()),
        ("intrinsic", "<f4", vec![3, 3], floats(matrix(&intrinsics))),
        ("cam_c2w", "<f4", vec![3, 4, 4], floats(poses)),
    ]
}

#[test]
fn megasam_archives_bring_their_images() {
    let dir = TempDir::new().unwrap();
    let members = megasam_arrays();
    write_npz(&dir.path().join("sora_sgd_cvd_hr.npz"), &members);
    std::fs::copy(dir.path().join("sora_sgd_cvd_hr.npz"), dir.path().join("sora_droid.npz")).unwrap();
    let (_root, capture) = run(dir.path(), &Params { fps: 10.0, ..params() }).unwrap();
    assert_eq!((capture.views.len(), capture.pose_source.as_str()), (3, "megasam"));
    assert!((capture.views[2].time_secs - 0.2).abs() < 1e-9);
    let position = capture.views[2].camera.camera_from_world.inverse().translation;
    assert!((position - DVec3::new(0.4, 0.0, 0.0)).length() < 1e-6, "{position}");
    assert_eq!(capture.load_image(&capture.views[1]).unwrap().get_pixel(5, 5).0, [100; 3]);
    assert!((known_share(&capture) - 23.0 / 24.0).abs() < 1e-9, "the sky has no depth");
    assert_points_on_the_wall(&capture);
}

/// Writes the files of MonST3R for two frames, the left half of which moves.
pub(super) fn write_monst3r(dir: &Path, intrinsics: Intrinsics) {
    let size = (intrinsics.width, intrinsics.height);
    write_images(dir, &["frame_0000.png", "frame_0001.png"], size);
    let (mut poses, mut matrices) = (String::new(), String::new());
    for at in 0..2 {
        let camera = camera(at, intrinsics);
        let world_from_camera = camera.camera_from_world.inverse();
        let quaternion = glam::DQuat::from_mat3(&world_from_camera.rotation);
        let [x, y, z] = world_from_camera.translation.to_array();
        let [qx, qy, qz, qw] = quaternion.to_array();
        poses += &format!("{at}.0 {x} {y} {z} {qw} {qx} {qy} {qz}\n");
        matrices += &matrix(&intrinsics).iter().map(|value| format!("{value:.6} ")).collect::<String>();
        matrices.push('\n');
        let shape = [size.1 as usize, size.0 as usize];
        std::fs::write(dir.join(format!("frame_{at:04}.npy")), npy("<f4", &shape, &floats(wall(&camera)))).unwrap();
        let sure = floats(vec![2.0; shape[0] * shape[1]]);
        std::fs::write(dir.join(format!("conf_{at}.npy")), npy("<f4", &shape, &sure)).unwrap();
        let moving = |x, _| Luma([if x < size.0 / 2 { 255 } else { 0 }]);
        GrayImage::from_fn(size.0, size.1, moving).save(dir.join(format!("dynamic_mask_{at}.png"))).unwrap();
    }
    std::fs::write(dir.join("pred_traj.txt"), poses).unwrap();
    std::fs::write(dir.join("pred_intrinsics.txt"), matrices).unwrap();
}

#[test]
fn monst3r_folders_have_poses_depth_and_masks() {
    let dir = TempDir::new().unwrap();
    let intrinsics = Intrinsics { focal_x: 60.0, focal_y: 60.0, ..seen(48, 32) };
    write_monst3r(dir.path(), intrinsics);
    let (_root, capture) = run(dir.path(), &params()).unwrap();
    assert_eq!((capture.views.len(), capture.views[1].split), (2, Split::Train));
    let expected = camera(1, intrinsics).camera_from_world;
    let found = capture.views[1].camera.camera_from_world;
    assert!((found.translation - expected.translation).length() < 1e-6, "{found:?}");
    assert_eq!(known_share(&capture), 1.0, "equal confidence drops nothing");
    let mask = capture.load_mask(&capture.views[1]).unwrap().unwrap();
    assert_eq!((mask.labels[0], mask.labels[47]), (1, 0));
    assert_points_on_the_wall(&capture);
    let points = capture.load_points().unwrap().unwrap();
    let on_the_right =
        |point: &[f32; 3], camera: &Camera| camera.project(point.map(f64::from).into()).unwrap().0.x > 23.9;
    let is_still = |point: &[f32; 3]| capture.views.iter().any(|view| on_the_right(point, &view.camera));
    assert!(points.positions.iter().all(is_still), "what moves gives no points");
    assert_eq!(read(dir.path(), &params()).unwrap().format, Format::Monst3r);
    let text = inspect(dir.path()).unwrap().text();
    assert!(text.contains("MonST3R") && !text.contains("ignored"), "{text}");
    std::fs::remove_file(dir.path().join("frame_0001.npy")).unwrap();
    let message = format!("{:#}", run(dir.path(), &params()).unwrap_err());
    assert!(message.contains("2 poses, but this file is missing") && message.contains("frame_0001.npy"), "{message}");
}

/// DUSt3R and MASt3R: sizes in multiples of 16, their own images, and no padding.
#[test]
fn aligned_scenes_of_dust3r_are_read_as_predictions() {
    let dir = TempDir::new().unwrap();
    let intrinsics = Intrinsics { focal_x: 60.0, focal_y: 60.0, ..seen(64, 48) };
    write_npz(&dir.path().join("predictions.npz"), &vggt_arrays(3, intrinsics));
    let (_root, capture) = run(dir.path(), &Params { unsure_share: 0.0, ..params() }).unwrap();
    assert_eq!((capture.views.len(), known_share(&capture)), (3, 1.0));
    for (at, view) in capture.views.iter().enumerate() {
        let moved = view.camera.camera_from_world.translation - camera(at, intrinsics).camera_from_world.translation;
        assert!(moved.length() < 1e-6 && view.camera.intrinsics == intrinsics, "{}", view.name);
    }
    assert_points_on_the_wall(&capture);
}
