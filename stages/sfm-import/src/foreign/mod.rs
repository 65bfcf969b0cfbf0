//! Folders in layouts that this stage does not read: their names, and the export or command that produces a readable one.

mod apps;
mod data_sets;
mod listing;
mod media;
mod posed;

use std::path::Path;

use self::listing::Listing;

/// A layout: recognises a folder by its entries and returns the next step.
type Rule = fn(&Listing) -> Option<String>;

/// The rules, the most specific first; the last ones recognise any folder of images or videos.
const RULES: [Rule; 27] = [
    media::unfinished_preparation,
    posed::posed_images,
    posed::trajectory,
    data_sets::neural_3d_video_without_poses,
    data_sets::llff,
    data_sets::nerfies,
    data_sets::easy_volcap,
    data_sets::dynamic_3d_gaussians,
    data_sets::panoptic,
    data_sets::driving,
    data_sets::motion_capture,
    apps::polycam,
    apps::record3d,
    apps::open_drone_map,
    apps::metashape,
    apps::reality_capture,
    apps::aria,
    apps::estimator,
    apps::glb,
    apps::trained_model,
    apps::viewer,
    media::part_of_colmap,
    media::renamed_transforms,
    media::archives,
    media::videos,
    media::images,
    media::other_images,
];

/// The next step towards an import of the folder; a list of the supported layouts if nothing in it is known.
pub(crate) fn next_step(dir: &Path) -> String {
    let listing = Listing::of(dir);
    let known = RULES.iter().find_map(|rule| rule(&listing));
    known.unwrap_or_else(|| {
        "supported: transforms_{train,val,test}.json (Blender, D-NeRF), transforms.json (nerfstudio, instant-ngp), images/ \
         next to sparse/0/{cameras,images,points3D}.{bin,txt} (COLMAP), camera/, rgb/ and metadata.json (Nerfies, HyperNeRF, \
         DyCheck), poses_bounds.npy next to cam00/images, cam01/images, … (Neural 3D Video), to images/ (LLFF), or to images/ and \
         mv_images/ (NVIDIA), intri.yml and extri.yml next to images/CAMERA/ (EasyVolcap), train_meta.json next to ims/ or \
         calibration_*.json next to hdImgs/ (CMU Panoptic), cameras_parameters.txt (Technicolor), rgb.txt next to groundtruth.txt \
         (TUM RGB-D), color/ next to pose/ (ScanNet), models.json next to camera_0001.mp4, camera_0002.mp4, … (Immersive Light \
         Field Video), predictions.npz (VGGT), SCENE_sgd_cvd_hr.npz or SCENE_droid.npz (MegaSaM), or pred_traj.txt next to \
         pred_intrinsics.txt and frame_0000.png (MonST3R)"
            .into()
    })
}

/// The next step for a single file in place of a capture, e.g. for a video; `None` if its kind is not known.
pub fn next_step_for_file(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_string_lossy().into_owned();
    let listing = Listing::of_names(path.parent()?, vec![name]);
    [apps::record3d, apps::aria, apps::glb, media::archives, media::videos]
        .iter()
        .find_map(|rule: &Rule| rule(&listing))
}
