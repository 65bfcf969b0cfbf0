//! What is wrong with rigs of Neural 3D Video, and what is said of them before they are imported.

use std::path::Path;

use scene::protocol::Preset;

use super::n3v::{NAMES, rig, rows, write_poses};
use super::support::*;
use crate::Params;
use crate::inspect::inspect;
use crate::params::Format;

/// Spoils a good rig and tells its message; an error names its camera and its file.
fn assert_fault(spoil: impl Fn(&Path), parts: &[&str]) {
    let dir = rig(&NAMES, 3);
    spoil(dir.path());
    assert_refused(dir.path(), &Params::default(), parts);
}

/// Changes one number of `poses_bounds.npy`.
fn with_number(row: usize, at: usize, value: f64) -> impl Fn(&Path) {
    move |dir| {
        let mut rows = rows(3);
        rows[row][at] = value;
        write_poses(dir, &rows);
    }
}

#[test]
fn wrong_poses_are_refused_by_the_name_of_their_camera() {
    let file = "poses_bounds.npy";
    assert_fault(
        |dir| write_poses(dir, &rows(4)),
        &["poses of 4 cameras beside 3 cameras (cam00, cam02, cam10)", file],
    );
    assert_fault(|dir| write_poses(dir, &rows(2)), &["poses of 2 cameras beside 3 cameras", file]);
    assert_fault(
        |dir| write_npy(&dir.join(file), "(3, 15)", &[0.0; 45]),
        &["shape [3, 15] where [cameras, 17] is expected", file],
    );
    assert_fault(|dir| std::fs::write(dir.join(file), "nonsense").unwrap(), &["not a readable NumPy array", file]);
    assert_fault(with_number(1, 3, f64::NAN), &["cam02: number 3 of the row is NaN", file]);
    assert_fault(with_number(2, 16, f64::INFINITY), &["cam10: number 16 of the row is inf", file]);
    assert_fault(with_number(1, 0, 0.5), &["cam02", "not orthonormal", file]);
    assert_fault(with_number(1, 9, 23.5), &["cam02: 23.5×16 is no size of a video", file]);
    assert_fault(with_number(2, 4, -16.0), &["cam10: 24×-16 is no size", file]);
    assert_fault(with_number(1, 14, 0.0), &["cam02", "focal lengths must be positive", file]);
    assert_fault(with_number(1, 15, 50.0), &["cam02: no scene lies between the depths 50 and 40", file]);
}

#[test]
fn wrong_frames_are_refused_by_the_name_of_their_camera() {
    let remove = |file: &'static str| move |dir: &Path| std::fs::remove_file(dir.join(file)).unwrap();
    assert_fault(
        remove("cam02/images/0002.png"),
        &["cam02 has 2 frames (0 to 1) where cam00 has 3 frames (0 to 2)", "same instants", "/cam02"],
    );
    assert_fault(remove("cam10/images/0000.png"), &["cam10 has 2 frames (1 to 2) where cam00 has 3", "/cam10"]);
    assert_fault(remove("cam10/images/0001.png"), &["cam10 has frame 2 after frame 0", "consecutive", "0002.png"]);
    assert_fault(|dir| write_image(&dir.join("cam02/images/0001.jpg"), 0), &["cam02 has frame 1 after frame 1"]);
    assert_fault(
        |dir| write_image(&dir.join("cam02/images/last.png"), 0),
        &["does not end in a frame number", "last.png"],
    );
    assert_fault(
        |dir| image::RgbImage::new(20, 16).save(dir.join("cam02/images/0001.png")).unwrap(),
        &["image is 20×16 where 24×16 is expected", "cam02/images/0001.png"],
    );
    assert_fault(with_number(0, 9, 36.0), &["image is 24×16 where 36×16 is expected", "cam00/images/0000.png"]);
    assert_fault(with_number(1, 9, 48.0), &["image is 24×16 where 48×16 is expected", "cam02/images/0000.png"]);
    assert_fault(
        |dir| std::fs::rename(dir.join("cam00"), dir.join("cam01")).unwrap(),
        &["no camera cam00, which is the one that is tested on (found cam01, cam02, cam10)"],
    );
    assert_fault(|dir| std::fs::write(dir.join("points3D.ply"), "ply\n").unwrap(), &["points3D.ply"]);
}

#[test]
fn videos_without_frames_come_with_the_command_that_extracts_them() {
    let leave_videos = |names: &'static [&str]| {
        move |dir: &Path| {
            for name in names {
                std::fs::remove_dir_all(dir.join(name)).unwrap();
                std::fs::write(dir.join(format!("{name}.mp4")), "x").unwrap();
            }
        }
    };
    let command = "ffmpeg -i \"$v\" -frames:v 300";
    assert_fault(leave_videos(&NAMES), &["no frames of cam00, cam02, cam10: videos are not decoded", command]);
    assert_fault(leave_videos(&["cam02"]), &["no frames of cam02: videos are not decoded", command]);
    // A video beside its frames is left alone, and other names are no cameras.
    let dir = rig(&NAMES, 2);
    for name in ["cam02.mp4", "cam100.mp4", "camera.mp4", "cam05"] {
        std::fs::write(dir.path().join(name), "a file").unwrap();
    }
    assert!(run(dir.path(), &Params::default()).is_ok());
    let readme = include_str!("../../README.md");
    assert!(readme.contains(crate::n3v::videos::EXTRACT), "the README has another command than the error");
}

#[test]
fn a_rig_is_described_with_a_recipe_for_its_protocol() {
    let dir = rig(&NAMES, 4);
    let text = describe(dir.path()).unwrap();
    for part in
        ["Neural 3D Video", "24×16; 8 train, 4 test", "3 (a rig)", "0 to 0.1000 s", "no points3D_downsample2.ply"]
    {
        assert!(text.contains(part), "{part:?} is not in:\n{text}");
    }
    assert!(text.contains("ready to import") && !text.contains("width ="), "{text}");
    assert_eq!(inspect(dir.path()).unwrap().captures[0].format, Format::N3v);
    assert_refused(dir.path(), &Params { format: Format::Nerfies, ..Params::default() }, &["not a Nerfies/HyperNeRF"]);
    std::fs::remove_dir_all(dir.path().join("cam02/images")).unwrap();
    let text = describe(dir.path()).unwrap();
    assert!(text.contains("Neural 3D Video") && text.contains("ffmpeg") && !text.contains("ready"), "{text}");
}

#[test]
fn the_scene_with_a_late_camera_is_noted() {
    let dir = rig(&["cam00", "cam13"], 2);
    let scene = dir.path().join("coffee_martini");
    std::fs::create_dir(&scene).unwrap();
    for name in ["cam00", "cam13", "poses_bounds.npy"] {
        std::fs::rename(dir.path().join(name), scene.join(name)).unwrap();
    }
    let noted = || describe(&scene).unwrap().contains("cam13 is badly synchronised");
    assert!(noted());
    std::fs::rename(scene.join("cam13"), scene.join("cam14")).unwrap();
    assert!(!noted());
}

/// At the real size, without pixels: inspection reads headers only.
#[test]
fn the_recipe_of_a_real_sized_rig_names_the_protocol() {
    let dir = rig(&["cam00", "cam01"], 300);
    let mut rows = rows(2);
    rows.iter_mut().for_each(|row| (row[4], row[9], row[14]) = (2028.0, 2704.0, 1462.0));
    write_poses(dir.path(), &rows);
    let large = dir.path().join("large.png");
    image::RgbImage::new(2704, 2028).save(&large).unwrap();
    for name in ["cam00", "cam01"] {
        for frame in 0..300 {
            let image = dir.path().join(format!("{name}/images/{frame:04}.png"));
            std::fs::remove_file(&image).unwrap();
            std::fs::hard_link(&large, image).unwrap();
        }
    }
    let recipe = inspect(dir.path()).unwrap().recipe().unwrap();
    let size = "width = 1352, resize = \"lanczos3\", protocol = \"n3v-1352\"";
    assert!(recipe.contains(size), "{recipe}");
    let preset = Preset::named("n3v-1352").unwrap().protocol();
    assert_eq!(crate::source::read(dir.path(), &Params::default()).unwrap().split_rule, preset.split);
}
