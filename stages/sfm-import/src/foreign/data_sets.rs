//! Layouts of published data sets.

use super::listing::Listing;
use crate::n3v;

/// How to state cameras of any origin.
const TO_COLMAP: &str = "write a COLMAP model instead: the frames in images/CAMERA/FRAME.png, one line per camera in \
                         sparse/0/cameras.txt (OPENCV fx fy cx cy k1 k2 p1 p2), and one pose per image (world to camera) in \
                         sparse/0/images.txt";

/// Neural 3D Video without its poses.
pub(super) fn neural_3d_video_without_poses(listing: &Listing) -> Option<String> {
    let has_cameras = !n3v::camera_names(listing.dir).is_empty();
    (has_cameras && !listing.has("poses_bounds.npy")).then(|| {
        "the Neural 3D Video layout needs poses_bounds.npy beside its cameras: check that the download is complete"
            .into()
    })
}

/// LLFF: poses of one folder of images.
pub(super) fn llff(listing: &Listing) -> Option<String> {
    listing.has("poses_bounds.npy").then(|| {
        "poses_bounds.npy is read beside one folder per camera (cam00/images, cam01/images, …, as in Neural 3D Video), not \
         beside a single folder of images (LLFF): add the COLMAP model that it was made from (sparse/0)"
            .into()
    })
}

/// Incomplete captures of Nerfies, HyperNeRF and DyCheck.
pub(super) fn nerfies(listing: &Listing) -> Option<String> {
    if listing.has_any(&["dataset.json", "camera"]) {
        return Some(
            "the Nerfies/HyperNeRF layout needs camera/, metadata.json and dataset.json: check that the download is complete"
                .into(),
        );
    }
    let file = listing.marked("json", &["\"principal_point\""])?;
    Some(format!(
        "{file} is one camera of the Nerfies layout, which has a file per view in camera/, images in rgb/, metadata.json and \
         dataset.json"
    ))
}

/// Calibrations of EasyMocap and EasyVolcap: ENeRF-Outdoor, MobileStage, ZJU-MoCap.
pub(super) fn easy_volcap(listing: &Listing) -> Option<String> {
    match (listing.has("intri.yml"), listing.has("extri.yml")) {
        (true, true) => Some(format!(
            "intri.yml and extri.yml are a calibration of EasyMocap or EasyVolcap: {TO_COLMAP}; Rot and T of extri.yml are \
             such a pose"
        )),
        (true, false) => Some(
            "intri.yml has the lenses of an EasyMocap or EasyVolcap calibration, but extri.yml with the poses is missing".into(),
        ),
        (false, true) => Some(
            "extri.yml has the poses of an EasyMocap or EasyVolcap calibration, but intri.yml with the lenses is missing".into(),
        ),
        (false, false) => None,
    }
}

/// Panoptic Sports as Dynamic 3D Gaussians stores it.
pub(super) fn dynamic_3d_gaussians(listing: &Listing) -> Option<String> {
    listing
        .has("train_meta.json")
        .then(|| format!("train_meta.json is the layout of Dynamic 3D Gaussians: {TO_COLMAP}; its w2c are such poses"))
}

/// Calibrations of the CMU Panoptic Studio.
pub(super) fn panoptic(listing: &Listing) -> Option<String> {
    let file = listing.marked("json", &["calibDataSource"])?;
    Some(format!(
        "{file} is a calibration of the CMU Panoptic Studio: {TO_COLMAP}; take the cameras of one type (hd), whose R and t \
         are such poses, in centimetres"
    ))
}

/// Driving logs.
pub(super) fn driving(listing: &Listing) -> Option<String> {
    let nuscenes = listing.names.iter().any(|name| name.starts_with("v1.0-")) && listing.has("samples");
    (nuscenes || !listing.with_extension(&["tfrecord"]).is_empty())
        .then(|| format!("a driving log (nuScenes, Waymo): extract the camera images; {TO_COLMAP}"))
}

/// Rigs with their own calibration files.
pub(super) fn motion_capture(listing: &Listing) -> Option<String> {
    let names = ["annots.npy", "cameras_parameters.txt", "rig_config.json"];
    match names.into_iter().find(|name| listing.has(name))? {
        "rig_config.json" => Some(
            "rig_config.json describes a rig without poses: run `colmap rig_configurator` and `colmap mapper`, and name the \
             folder with sparse/ and images/"
                .into(),
        ),
        file => Some(format!("{file} is a calibration of ZJU-MoCap or Technicolor: {TO_COLMAP}")),
    }
}
