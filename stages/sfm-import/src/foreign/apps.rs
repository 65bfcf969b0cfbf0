//! Exports of scanning apps, photogrammetry programs, pose estimators and trainers.

use super::listing::Listing;

/// Polycam's raw data.
pub(super) fn polycam(listing: &Listing) -> Option<String> {
    (listing.has("keyframes") || listing.has("mesh_info.json") && listing.has("cameras")).then(|| {
        "Polycam's raw data: run `ns-process-data polycam --data THIS_FOLDER --output-dir OUT` of nerfstudio and name OUT, \
         which has a transforms.json"
            .into()
    })
}

/// Record3D's archive of an iPhone recording.
pub(super) fn record3d(listing: &Listing) -> Option<String> {
    let file = *listing.with_extension(&["r3d"]).first()?;
    Some(format!(
        "{file} is a Record3D recording: unzip it, run `ns-process-data record3d --data UNZIPPED --output-dir OUT` of \
         nerfstudio and name OUT, which has a transforms.json"
    ))
}

/// OpenDroneMap.
pub(super) fn open_drone_map(listing: &Listing) -> Option<String> {
    let is_odm = listing.has_any(&["opensfm", "odm_report"]) || listing.marked("json", &["projection_type"]).is_some();
    is_odm.then(|| {
        "OpenDroneMap: run `ns-process-data odm --data PROJECT --output-dir OUT` of nerfstudio on the whole project, whose poses are \
         in opensfm/ and odm_report/, and name OUT, which has a transforms.json"
            .into()
    })
}

/// Agisoft Metashape, and the XML of ContextCapture that other programs write too.
pub(super) fn metashape(listing: &Listing) -> Option<String> {
    let colmap = "put cameras.txt, images.txt and points3D.txt into sparse/0 next to the undistorted images in images/";
    if let Some(file) = listing.marked("xml", &["<BlocksExchange"]) {
        return Some(format!(
            "{file} is a BlocksExchange export (ContextCapture, iTwin): export COLMAP instead; {colmap}"
        ));
    }
    let xml = listing.marked("xml", &["<chunk", "<document"]);
    let file = xml.or_else(|| listing.with_extension(&["psx"]).first().copied())?;
    Some(format!(
        "{file} is a project or an export of Agisoft Metashape: choose File > Export > Export Cameras and the type COLMAP \
         (version 2.2 or newer); {colmap}"
    ))
}

/// RealityCapture, now RealityScan.
pub(super) fn reality_capture(listing: &Listing) -> Option<String> {
    let csv = listing.marked("csv", &["#name,x,y", "#cameras", "heading,pitch,roll"]);
    let file = csv.or_else(|| listing.with_extension(&["rcproj", "rsproj"]).first().copied())?;
    Some(format!(
        "{file} is a project or a camera list of RealityCapture: choose Alignment > Export > Registration and the format \
         COLMAP (version 1.5 or newer), with undistorted images; name the folder with sparse/0 and images/"
    ))
}

/// Recordings of Project Aria.
pub(super) fn aria(listing: &Listing) -> Option<String> {
    let file = *listing.with_extension(&["vrs"]).first()?;
    Some(format!(
        "{file} is a recording of Aria glasses: run `ns-process-data aria` of nerfstudio with the MPS poses and name its \
         output, which has a transforms.json"
    ))
}

/// 3D models, which the demos of DUSt3R and MASt3R write as their only result.
pub(super) fn glb(listing: &Listing) -> Option<String> {
    let file = *listing.with_extension(&["glb"]).first()?;
    Some(format!(
        "{file} is a 3D model, e.g. of the demo of DUSt3R or MASt3R (scene.glb): its cameras are drawings, without the \
         depth of each frame. Save the aligned scene as predictions.npz instead (a few lines of Python: see DUSt3R in the \
         README of sfm-import), or run demo_glomap.py of MASt3R and copy reconstruction/0 to sparse/0 next to images/"
    ))
}

/// Native outputs of feed-forward pose estimators.
pub(super) fn estimator(listing: &Listing) -> Option<String> {
    let names = ["pred_traj.txt", "pred_intrinsics.txt", "droid.npz", "poses.npy"];
    let file = names.into_iter().find(|name| listing.has(name))?;
    Some(format!(
        "{file} is a part of the output of a pose estimator (DUSt3R, MASt3R, MonST3R, DROID-SLAM): name the whole folder of \
         MonST3R, the folder with predictions.npz of VGGT or with the npz file of MegaSaM, or the folder of a COLMAP export \
         with sparse/ and images/"
    ))
}

/// The output folder of a Gaussian-splatting program.
pub(super) fn trained_model(listing: &Listing) -> Option<String> {
    let is_camera_list = listing.marked("json", &["\"img_name\""]).is_some();
    (is_camera_list || listing.has("cfg_args") || listing.has("point_cloud")).then(|| {
        "the output of a 3D Gaussian Splatting training: its cameras.json has poses, but not the images. Name the capture \
         that it was trained on (source_path in cfg_args)"
            .into()
    })
}

/// Camera paths and settings of viewers.
pub(super) fn viewer(listing: &Listing) -> Option<String> {
    let marks = ["\"keyframes\"", "\"camera_path\"", "\"animTracks\"", "\"startAnim\"", "\"annotations\""];
    let file = listing.marked("json", &marks)?;
    Some(format!(
        "{file} is a camera path or a viewer's setting, not a capture: name the folder with the images and their poses"
    ))
}
