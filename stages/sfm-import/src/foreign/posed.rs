//! Images with poses in files of other programs: no estimation is needed, only a conversion.

use super::listing::Listing;

/// How to provide known poses.
const TO_TRANSFORMS: &str = "write the poses to a transforms.json next to the images: fl_x, fl_y, cx, cy, w, h in pixels, and per \
                             frame file_path, transform_matrix (camera to world, x right, y up, looking along −z) and, if \
                             something moves, time in seconds";

/// A layout: how to recognise it, and what its files contain.
type Layout = (fn(&Listing) -> bool, &'static str);

/// Poses that map camera to world with OpenCV's axes need a change of two signs.
const LAYOUTS: [Layout; 9] = [
    (
        |it| it.has("pose") && it.has_any(&["intrinsics.txt", "intrinsics"]),
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
        |it| it.has("bundle.out"),
        "a model of Bundler: bundle.out has lenses and world-to-camera poses, looking along −z",
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
];

/// Images whose poses are in the files of another program.
pub(super) fn posed_images(listing: &Listing) -> Option<String> {
    let (_, what) = LAYOUTS.iter().find(|(is_layout, _)| is_layout(listing))?;
    Some(format!("{what}; {TO_TRANSFORMS}"))
}
