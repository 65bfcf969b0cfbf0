//! Images with poses in files of other programs: no estimation is needed, only a conversion.

use super::listing::Listing;

/// How to provide known poses.
const TO_TRANSFORMS: &str = "write the poses to a transforms.json next to the images: fl_x, fl_y, cx, cy, w, h in pixels, and per \
                             frame file_path, transform_matrix (camera to world, x right, y up, looking along −z) and, if \
                             something moves, time in seconds";

/// A layout: how to recognise it, and what its files contain.
type Layout = (fn(&Listing) -> bool, &'static str);

/// Poses that map camera to world with OpenCV's axes need a change of two signs.
const LAYOUTS: [Layout; 26] = [
    (
        |it| it.has_within("pose", ".txt") && it.has_any(&["intrinsics.txt", "intrinsics"]),
        "pose/ has a matrix per image (NSVF: camera to world, OpenCV's axes): negate the second and third column of \
         each rotation",
    ),
    (
        |it| it.has("traj.txt") && it.has("results"),
        "a sequence of Replica: traj.txt has a matrix per image (camera to world, OpenCV's axes); negate the second and third \
         column of each rotation",
    ),
    (
        |it| it.has_any(&["cameras_sphere.npz", "cameras_large.npz", "cameras.npz"]),
        "the layout of IDR and NeuS (DTU): world_mat_* of the npz file are projection matrices; decompose them with \
         cv2.decomposeProjectionMatrix",
    ),
    (
        |it| {
            it.has("calib_cam_to_cam.txt") || it.has("calib.txt") && it.has_any(&["poses.txt", "times.txt", "image_2"])
        },
        "a sequence of KITTI: the calib files have the lenses, oxts/ or poses.txt the path of the car (camera to world, \
         OpenCV's axes)",
    ),
    (
        |it| it.has("cams") && it.has("pair.txt"),
        "the layout of MVSNet: cams/*_cam.txt have world-to-camera matrices and lenses",
    ),
    (
        |it| it.has_any(&["bundle.out", "bundle.rd.out"]),
        "a model of Bundler: bundle.out or bundle.rd.out has lenses and world-to-camera poses, looking along −z",
    ),
    (
        |it| it.marked("json", &["\"camtoworld\""]).is_some(),
        "the layout of SDFStudio: meta_data.json has camtoworld (OpenCV's axes) and intrinsics per frame; negate the second \
         and third column of each rotation",
    ),
    (
        |it| {
            it.has("metadata") && it.has("rgbd")
                || it.has("metadata.json") && it.has("rgb") && it.marked("json", &["\"poses\"", "\"K\""]).is_some()
        },
        "a recording of Record3D: run `ns-process-data record3d --data THIS_FOLDER --output-dir OUT` of nerfstudio \
         and name OUT, or read K and poses (qx qy qz qw tx ty tz, camera to world) of its file metadata",
    ),
    (
        |it| it.marked("json", &["\"cameraPoseARFrame\""]).is_some(),
        "an export of 3D Scanner App: each frame's JSON file has intrinsics and cameraPoseARFrame (ARKit's axes, which are those \
         of transform_matrix)",
    ),
    (
        |it| it.has_within("pose", ".npz"),
        "an output of ViPE: pose/ has a matrix per frame (camera to world, OpenCV's axes) and intrinsics/ fx, fy, cx, cy; extract the \
         frames of the video in rgb/, and negate the second and third column of each rotation",
    ),
    (
        |it| it.has_within("camera", ".npz"),
        "an output of CUT3R: camera/ has pose (camera to world, OpenCV's axes) and intrinsics per image of color/; negate the second \
         and third column of each rotation",
    ),
    (
        |it| it.has_end(".traj"),
        "a scene of ARKitScenes: the lines of the traj file are a time, a rotation vector and a translation (world to camera, \
         OpenCV's axes); the pincam files have the size and the lens of each image",
    ),
    (
        |it| it.has("anno.npz") && it.has("rgbs"),
        "a sequence of PointOdyssey: anno.npz has intrinsics and extrinsics (world to camera, OpenCV's axes) per image of rgbs/",
    ),
    (
        |it| it.has("metadata.json") && it.names.iter().any(|name| name.starts_with("rgba_")),
        "a scene of Kubric: camera in metadata.json has positions and quaternions (w x y z) per image, camera to world with the axes \
         of transform_matrix, and K as shares of the image's size",
    ),
    (
        |it| it.has_end(".pose.txt"),
        "a sequence of 7-Scenes or BundleFusion: *.pose.txt have a matrix per image (camera to world, OpenCV's axes); negate the \
         second and third column of each rotation",
    ),
    (
        |it| it.with_extension(&["txt"]).iter().any(|name| it.head(name).starts_with("https://www.youtube.com/")),
        "a clip of RealEstate10K: after the address, each line has a time in microseconds, fx, fy, cx, cy as shares of the image's \
         size, two zeros, and a matrix of 3 × 4 (world to camera, OpenCV's axes)",
    ),
    (
        |it| it.has_end(".nvm"),
        "a model of VisualSFM: each image of the nvm file has its name, focal length, rotation (quaternion w x y z, world to camera, \
         OpenCV's axes), the position of the camera, and radial distortion",
    ),
    (
        |it| it.has_any(&["pose_left.txt", "pose_lcam_front.txt"]),
        "a trajectory of TartanAir: the pose file has tx ty tz qx qy qz qw per image, camera to world with x forward, y right and z \
         down",
    ),
    (
        |it| it.has_within("camdata_left", ".cam"),
        "a sequence of Sintel: camdata_left/*.cam have a lens and a matrix (world to camera, OpenCV's axes) per image, which \
         sintel_io.py of its SDK reads",
    ),
    (
        |it| it.marked("csv", &["name,w,h,rx,ry,rz,"]).is_some(),
        "a sequence of ActorsHQ: calibration.csv has rotation vectors and translations (camera to world, OpenCV's axes), and fx, fy, \
         px, py as shares of w and h",
    ),
    (
        |it| it.has("ego_pose") && it.has("extrinsics"),
        "a driving log: ego_pose/ (vehicle to world) times extrinsics/ (camera to vehicle) is camera to world, with axes that depend \
         on the converter; intrinsics/ has the lenses",
    ),
    (
        |it| it.has("odometry.csv") && it.has("camera_matrix.csv"),
        "a recording of Stray Scanner: odometry.csv has x, y, z, qx, qy, qz, qw per frame of the video (camera to world, OpenCV's \
         axes), and camera_matrix.csv the lens; extract the frames",
    ),
    (
        |it| it.has("sfm_data.json") || it.marked("json", &["\"sfm_data_version\""]).is_some(),
        "a scene of openMVG: run `openMVG_main_openMVG2Colmap -i sfm_data.json -o sparse/0` and put the images into images/, or read \
         the rotations (world to camera) and centers of its extrinsics",
    ),
    (
        |it| it.has_end(".sfm"),
        "a scene of Meshroom (AliceVision): the sfm file has views, intrinsics, and poses with a rotation and a center",
    ),
    (
        |it| it.has("results.npz") || it.has_within("exports/npz", "results.npz"),
        "an output of Depth Anything 3: results.npz has extrinsics (world to camera, OpenCV's axes) and intrinsics per image, for the \
         size of its depth",
    ),
    (
        |it| it.has("reconstruction.json"),
        "a project of OpenSfM: run `opensfm export_colmap PROJECT` and put cameras.txt, images.txt and points3D.txt into sparse/0 next \
         to images/, or read the shots of reconstruction.json (rotation vectors and translations, world to camera)",
    ),
];

/// Images whose poses are in the files of another program.
pub(super) fn posed_images(listing: &Listing) -> Option<String> {
    let (_, what) = LAYOUTS.iter().find(|(is_layout, _)| is_layout(listing))?;
    Some(format!("{what}; {TO_TRANSFORMS}"))
}

/// Trajectories of SLAM programs in the format of TUM.
pub(super) fn trajectory(listing: &Listing) -> Option<String> {
    let names = ["KeyFrameTrajectory.txt", "CameraTrajectory.txt", "traj_est.txt", "stamped_traj_estimate.txt"];
    let file = names.into_iter().find(|name| listing.has(name))?;
    Some(format!(
        "{file} is a trajectory of a SLAM program. If its lines are `time tx ty tz qx qy qz qw` (camera to world, OpenCV's axes), \
         rename it to groundtruth.txt, list the images in rgb.txt (`time file` per line, with the same times), and write the lens \
         to calibration.txt (`fx fy cx cy`): this is the layout of TUM"
    ))
}
