//! Layouts of published data sets.

use super::listing::Listing;
use super::media;
use crate::{n3v, poses_bounds};

/// How to provide cameras from any source.
const TO_COLMAP: &str = "write a COLMAP model instead: the frames in images/CAMERA/FRAME.png, one line per camera in \
                         sparse/0/cameras.txt (OPENCV fx fy cx cy k1 k2 p1 p2), and one pose per image (world to camera) in \
                         sparse/0/images.txt";

/// Cameras named like those of Neural 3D Video, without poses: a rig of the user, or an incomplete download.
pub(super) fn neural_3d_video_without_poses(listing: &Listing) -> Option<String> {
    let has_cameras = !n3v::camera_names(listing.dir).is_empty();
    (has_cameras && !listing.has(poses_bounds::FILE)).then(|| {
        let download = "a scene of Neural 3D Video needs poses_bounds.npy next to its cameras: check that the download is complete";
        let own = media::videos(listing).or_else(|| media::images(listing));
        own.map_or_else(|| download.into(), |own| format!("{own}. If this is not your own recording: {download}"))
    })
}

/// LLFF without its photos, or a rig with videos in a container that is not read.
pub(super) fn llff(listing: &Listing) -> Option<String> {
    listing.has(poses_bounds::FILE).then(|| {
        if let Some(video) = listing.with_extension(&["avi", "mkv", "webm"]).first() {
            return format!(
                "videos of a rig are read as MP4: convert {video} and the others, e.g. with `for v in cam*; do ffmpeg -i \"$v\" \
                 -qscale:v 2 \"${{v%.*}}.mp4\"; done`, or extract their frames into cam00/images, cam01/images, …"
            );
        }
        "poses_bounds.npy has the poses of LLFF, but the images are missing: put them into images/, in the order of its rows, \
         or the frames of a rig into cam00/images, cam01/images, …"
            .into()
    })
}

/// Incomplete captures of Nerfies, HyperNeRF and DyCheck.
pub(super) fn nerfies(listing: &Listing) -> Option<String> {
    if listing.has("dataset.json") || listing.has_within("camera", ".json") {
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
        (true, true) => Some(
            "intri.yml and extri.yml are a calibration of EasyMocap or EasyVolcap without frames: put them into \
             images/CAMERA/000000.jpg or videos/CAMERA.mp4, with the names of intri.yml"
                .into(),
        ),
        (true, false) => Some(
            "intri.yml has the lenses of an EasyMocap or EasyVolcap calibration, but extri.yml with the poses is missing".into(),
        ),
        (false, true) => Some(
            "extri.yml has the poses of an EasyMocap or EasyVolcap calibration, but intri.yml with the lenses is missing".into(),
        ),
        (false, false) => None,
    }
}

/// Panoptic Sports as Dynamic 3D Gaussians stores it, without its images.
pub(super) fn dynamic_3d_gaussians(listing: &Listing) -> Option<String> {
    listing.has("train_meta.json").then(|| {
        "train_meta.json has the cameras of the layout of Dynamic 3D Gaussians, but the folder ims with the images is missing: \
         check that the download is complete"
            .into()
    })
}

/// Calibrations of the CMU Panoptic Studio.
pub(super) fn panoptic(listing: &Listing) -> Option<String> {
    let file = listing.marked("json", &["calibDataSource"])?;
    let name = "rename it to calibration_SEQUENCE.json, and ";
    Some(format!(
        "{file} is a calibration of the CMU Panoptic Studio without frames: {}put the videos into hdVideos (getData.sh of \
         panoptic-toolbox), or their frames into hdImgs (hdImgsExtractor.sh: hdImgs/00_00/00_00_00000000.jpg)",
        if file.starts_with("calibration") { "" } else { name },
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
    if let Some(file) = listing.with_extension(&["smc"]).first() {
        return Some(format!(
            "{file} is a recording of DNA-Rendering: extract its images and cameras with SMCReader of the data set's toolbox; \
             {TO_COLMAP}"
        ));
    }
    let names = ["annots.npy", "rig_config.json"];
    match names.into_iter().find(|name| listing.has(name))? {
        "rig_config.json" => Some(
            "rig_config.json describes a rig without poses: run `colmap rig_configurator` and `colmap mapper`, and name the \
             folder with sparse/ and images/"
                .into(),
        ),
        file => Some(format!("{file} is a calibration of ZJU-MoCap: {TO_COLMAP}")),
    }
}
