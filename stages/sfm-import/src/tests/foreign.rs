//! Next steps for folders in other layouts.

use std::path::Path;

use super::support::*;
use crate::Params;
use crate::inspect::inspect;

/// Writes files with their contents into a new folder.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, content) in files {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    }
    dir
}

/// The hint for a folder.
fn hint(dir: &Path) -> String {
    let failure = crate::recognise::recognise(dir, crate::Format::Auto).unwrap_err();
    failure.hint.unwrap()
}

#[test]
fn every_known_layout_gets_its_next_step() {
    let cases: [&[(&str, &str)]; 39] = [
        &[("keyframes/images/1.jpg", ""), ("mesh_info.json", "{}")],
        &[("scan.r3d", "")],
        &[("cameras.json", r#"{"v2 dji": {"projection_type": "brown"}}"#)],
        &[("opensfm/reconstruction.json", "[]")],
        &[("cameras.xml", "<?xml version=\"1.0\"?>\n<document version=\"2.0.0\">\n  <chunk label=\"a\">")],
        &[("project.psx", "")],
        &[("blocks.xml", "<BlocksExchange version=\"2.1\">")],
        &[("cameras.csv", "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2\n")],
        &[("recording.vrs", "")],
        &[("scene.glb", ""), ("images/a.png", "")],
        &[("tmpx1_scene.glb", "")],
        &[("pred_traj.txt", "")],
        &[("cameras.json", r#"[{"id": 0, "img_name": "a", "width": 10}]"#), ("cfg_args", "Namespace()")],
        &[("camera_path.json", r#"{"keyframes": [], "camera_path": []}"#)],
        &[("settings.json", r#"{"camera": {"fov": 75}, "animTracks": []}"#)],
        &[("intri.yml", "%YAML:1.0"), ("extri.yml", "%YAML:1.0")],
        &[("intri.yml", "%YAML:1.0")],
        &[("extri.yml", "%YAML:1.0")],
        &[("train_meta.json", "{}"), ("seg/0/0.png", "")],
        &[("calibration.json", r#"{"calibDataSource": "160422"}"#)],
        &[("camera.json", r#"{"focal_length": 3.0, "principal_point": [1, 2]}"#)],
        &[("rig_config.json", "[]")],
        &[("annots.npy", ""), ("Camera_B1/0.jpg", "")],
        &[("segment.tfrecord", "")],
        &[("database.db", ""), ("images/a.jpg", "")],
        &[("my_transforms.json", r#"{"fl_x": 1.0, "frames": []}"#)],
        &[("lego.zip", "")],
        &[("pose/0.txt", ""), ("intrinsics.txt", ""), ("rgb/0.png", "")],
        &[("traj.txt", ""), ("results/frame000000.jpg", "")],
        &[("cameras_sphere.npz", ""), ("image/000.png", "")],
        &[("calib_cam_to_cam.txt", ""), ("image_02/data/0.png", "")],
        &[("cams/00000000_cam.txt", ""), ("pair.txt", ""), ("images/0.jpg", "")],
        &[("bundle.out", ""), ("images/0.jpg", "")],
        &[("meta_data.json", r#"{"frames": [{"camtoworld": []}]}"#), ("0_rgb.png", "")],
        &[("metadata", "{}"), ("rgbd/0.jpg", "")],
        &[("metadata.json", r#"{"h": 960, "K": [1.0], "poses": [[0, 0, 0, 1, 0, 0, 0]]}"#), ("rgb/0.jpg", "")],
        &[("frame_00000.json", r#"{"cameraPoseARFrame": []}"#), ("frame_00000.jpg", "")],
        &[("cameras/1.json", "{}"), ("mesh_info.json", "{}"), ("images/1.jpg", "")],
        &[("unrelated.json", "{}")],
    ];
    let lines: Vec<String> =
        cases.iter().map(|files| format!("{}: {}", files[0].0, hint(folder(files).path()))).collect();
    insta::assert_snapshot!(lines.join("\n"));
}

#[test]
fn videos_and_images_get_commands() {
    let cases: [&[(&str, &str)]; 6] = [
        &[("IMG_0042.MOV", "")],
        &[("left.mp4", ""), ("right.mp4", "")],
        &[("left.mp4", ""), ("right.mov", "")],
        &[("images/1.jpg", ""), ("images/2.jpg", "")],
        &[("1.jpg", ""), ("2.jpg", "")],
        &[("photos/1.jpg", "")],
    ];
    let lines: Vec<String> =
        cases.iter().map(|files| format!("{}: {}", files[0].0, hint(folder(files).path()))).collect();
    insta::assert_snapshot!(lines.join("\n"));
    let dir = folder(&[("clip.mp4", "")]);
    let message = refusal(&dir.path().join("clip.mp4"), &Params::default());
    assert!(message.contains("`pipeline prepare "), "{message}");
    let spaced = folder(&[("my photos/1.jpg", "")]);
    assert!(hint(spaced.path()).contains("`pipeline prepare \"my photos\" --out DIR`"));
    let rig = folder(&[("cam00.avi", ""), ("poses_bounds.npy", "")]);
    assert!(hint(rig.path()).starts_with("videos of a rig are read as MP4: convert cam00.avi"));
}

#[test]
fn an_unfinished_preparation_is_to_be_repeated() {
    let dir = folder(&[("prepare.json", "{}"), ("images/00001.jpg", ""), ("masks/00001.png", "")]);
    let hint = hint(dir.path());
    let command = format!("run the same command again, with `--out {}`", dir.path().display());
    assert!(hint.contains(&command) && !hint.contains("prepare images"), "{hint}");
}

#[test]
fn poses_of_other_programs_are_noticed() {
    let to_transforms = "write the poses to a transforms.json";
    let youtube = "https://www.youtube.com/watch?v=x\n0 0.9 1.2 .5 .5 0 0 1 0 0 0 0 1 0 0 0 0 1 0\n";
    let sfm_data = r#"{"sfm_data_version": "0.3", "views": []}"#;
    let cases: [(&[(&str, &str)], &str); 23] = [
        (&[("pose/clip.npz", ""), ("intrinsics/clip.npz", ""), ("rgb/clip.mp4", "")], "ViPE"),
        (&[("camera/0.npz", ""), ("color/0.png", ""), ("depth/0.npz", "")], "CUT3R"),
        (&[("lowres_wide.traj", ""), ("lowres_depth/1.png", ""), ("lowres_wide/1.png", "")], "ARKitScenes"),
        (&[("anno.npz", ""), ("depths/1.png", ""), ("rgbs/1.jpg", "")], "PointOdyssey"),
        (&[("metadata.json", "{}"), ("rgba_00000.png", ""), ("segmentation_00000.png", "")], "Kubric"),
        (&[("frame-000000.pose.txt", ""), ("frame-000000.color.jpg", "")], "7-Scenes"),
        (&[("0a0b.txt", youtube), ("0.jpg", "")], "RealEstate10K"),
        (&[("dense.nvm", ""), ("visualize/0.jpg", "")], "VisualSFM"),
        (&[("pose_left.txt", ""), ("image_left/0.png", "")], "TartanAir"),
        (&[("camdata_left/frame_0001.cam", ""), ("final/0.png", "")], "Sintel"),
        (&[("calibration.csv", "name,w,h,rx,ry,rz,tx,ty,tz,fx,fy,px,py\n"), ("rgbs/Cam001/0.jpg", "")], "ActorsHQ"),
        (&[("ego_pose/0.txt", ""), ("extrinsics/0.txt", ""), ("images/0.png", "")], "ego_pose/"),
        (&[("odometry.csv", ""), ("camera_matrix.csv", ""), ("rgb.mp4", "")], "Stray Scanner"),
        (&[("sfm_data.json", ""), ("0.jpg", "")], "openMVG_main_openMVG2Colmap"),
        (&[("out.json", sfm_data), ("0.jpg", "")], "openMVG_main_openMVG2Colmap"),
        (&[("cameras.sfm", ""), ("0.jpg", "")], "Meshroom"),
        (&[("bundle.rd.out", ""), ("0.jpg", "")], "Bundler"),
        (&[("exports/npz/results.npz", ""), ("input_images/0.png", "")], "Depth Anything 3"),
        (&[("results.npz", "")], "Depth Anything 3"),
        (&[("reconstruction.json", "[]"), ("camera_models.json", "{}"), ("images/0.jpg", "")], "opensfm export_colmap"),
        (&[("KeyFrameTrajectory.txt", ""), ("0.png", "")], "rename it to groundtruth.txt"),
        (&[("traj_est.txt", ""), ("images/0.png", "")], "rename it to groundtruth.txt"),
        (&[("0012_11.smc", "")], "DNA-Rendering"),
    ];
    for (files, part) in cases {
        let hint = hint(folder(files).path());
        assert!(hint.contains(part) && !hint.contains("without poses"), "{}: {hint}", files[0].0);
        let has_advice = [to_transforms, "write a COLMAP model", "groundtruth.txt"].iter().any(|it| hint.contains(it));
        assert!(has_advice, "{hint}");
    }
    let readme = folder(&[("readme.txt", "See https://www.youtube.com/watch?v=x"), ("0.jpg", "")]);
    assert!(hint(readme.path()).starts_with("1 images without poses"));
}

#[test]
fn maps_are_not_photos_and_rigs_are_prepared_whole() {
    type Case = (&'static [(&'static str, &'static str)], &'static str, &'static str);
    let cases: [Case; 6] = [
        (&[("depth/1.png", ""), ("rgb/1.jpg", ""), ("rgb/2.jpg", "")], "2 images without poses", "prepare rgb --out"),
        (&[("1.jpg", ""), ("1_mask.png", ""), ("1.depth.png", "")], "1 images without poses", "prepare . --out"),
        (&[("a/1.png", ""), ("b/2.png", ""), ("b/3.png", "")], "2 images without poses", "prepare b --out"),
        (&[("images/1.png", ""), ("images_2/1.png", "")], "1 images without poses", "prepare images --out"),
        (
            &[("left/1.png", ""), ("right/1.png", "")],
            "2 images without poses in the folders left, right. If these are the cameras of a rig, run in",
            "prepare . --out",
        ),
        (
            &[("left/1.png", ""), ("right/1.png", ""), ("depth/1.png", "")],
            "2 images without poses in the folders left, right. If these are the cameras of a rig, move all other images out",
            "prepare . --out",
        ),
    ];
    for (files, start, command) in cases {
        let hint = hint(folder(files).path());
        assert!(hint.starts_with(start) && hint.contains(command), "{hint}");
    }
    // Cameras that are named like those of Neural 3D Video may be a rig of the user.
    let folders = folder(&[("cam00/0.png", ""), ("cam01/0.png", "")]);
    let videos = folder(&[("cam00.mp4", ""), ("cam01.mp4", "")]);
    for (dir, part) in [(folders, "`pipeline prepare . --out DIR`"), (videos, "2 videos without poses. Run: `for v in")]
    {
        let hint = hint(dir.path());
        assert!(hint.contains(part) && hint.contains("If this is not your own recording"), "{hint}");
    }
    let without_frames = folder(&[("cam00/notes.txt", ""), ("cam01/notes.txt", "")]);
    assert!(hint(without_frames.path()).starts_with("a scene of Neural 3D Video needs poses_bounds.npy"));
}

#[test]
fn images_in_other_formats_are_to_be_converted() {
    for (name, command) in [("0.bmp", "*.bmp"), ("IMG_1.HEIC", "*.HEIC"), ("images/0.exr", "*.exr")] {
        let hint = hint(folder(&[(name, "")]).path());
        assert!(hint.contains("convert the images to PNG or JPEG") && hint.contains(command), "{hint}");
    }
}

/// Each folder of real metadata is read, or refused with the reason. The images are not part of that data.
#[test]
fn real_folders_of_other_programs_are_named() {
    let Some(root) = support::data("formats/captures") else { return };
    let expected = [
        ("arkit-colmap-nopoints", "image file is missing"),
        ("camera-path-nerfstudio-legacy", "camera path"),
        ("colmap-full-opencv-realitycapture", "92 images registered"),
        ("colmap-opencv-8cams", "images.bin or images.txt, which has the poses, is missing"),
        ("colmap-opencv-fisheye", "images.bin or images.txt, which has the poses, is missing"),
        ("colmap-rig-config", "colmap rig_configurator"),
        ("colmap-rigs-99cams", "images.bin or images.txt, which has the poses, is missing"),
        ("colmap-rigs-doc-excerpt", "images.bin or images.txt, which has the poses, is missing"),
        ("colmap-rigs-frames-text/bin", "13 of 13 images registered"),
        ("dust3r-colmap", "2 of 2 images registered"),
        ("dust3r-colmap/interpolated", "image file is missing"),
        ("dynamic3dgs-train-meta", "folder ims with the images is missing"),
        ("easymocap-A-NeRF", "without frames"),
        ("easymocap-intri-example", "extri.yml with the poses is missing"),
        ("hypernerf-camera", "one camera of the Nerfies layout"),
        ("inria-cameras-json", "output of a 3D Gaussian Splatting training"),
        ("llff-poses-bounds-dsdnerf", "5 of 5 images registered"),
        ("llff-poses-bounds-rig", "has the poses of LLFF"),
        ("odm-cameras-json", "ns-process-data odm"),
        ("panoptic-calibration", "hdImgsExtractor.sh"),
        ("supersplat-viewer-settings", "viewer's setting"),
        ("survey-xml-transforms-odd", "rename it to transforms.json"),
        ("vggt-colmap", "8719"),
    ];
    for (name, part) in expected {
        let started = std::time::Instant::now();
        let text = inspect(&root.join(name)).unwrap().text();
        eprintln!("{text}({:.0?})\n", started.elapsed());
        assert!(text.contains(part), "{name}: {part:?} is not in\n{text}");
    }
}

#[test]
fn captures_in_deeper_folders_are_named() {
    let dir = folder(&[("archive/scene/transforms.json", "{}"), ("archive/readme.txt", "")]);
    let hint = hint(dir.path());
    assert!(hint.starts_with("name the folder of the capture, ") && hint.ends_with("archive/scene"), "{hint}");
}
