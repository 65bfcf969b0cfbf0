//! Faulty rigs of Neural 3D Video, and the reports of `inspect` about rigs.

use std::path::Path;

use scene::protocol::Preset;

use super::n3v::{NAMES, rig, rows, write_poses};
use super::support::*;
use crate::inspect::inspect;
use crate::recognise::read;
use crate::{Format, Params};

/// A change that makes a rig faulty.
type Fault = Box<dyn Fn(&Path)>;

/// The errors for rigs with these faults.
fn refusals(faults: Vec<Fault>) -> String {
    let mut refusals = Refusals::default();
    for fault in faults {
        let dir = rig(&NAMES, 3);
        fault(dir.path());
        refusals.add(dir.path(), &Params::default());
    }
    refusals.text().to_owned()
}

/// Changes one number of `poses_bounds.npy`.
fn with_number(row: usize, at: usize, value: f64) -> Fault {
    Box::new(move |dir| {
        let mut rows = rows(3);
        rows[row][at] = value;
        write_poses(dir, &rows);
    })
}

#[test]
fn wrong_poses_are_refused_with_the_camera() {
    let file = "poses_bounds.npy";
    insta::assert_snapshot!(refusals(vec![
        Box::new(|dir| write_poses(dir, &rows(4))),
        Box::new(|dir| write_poses(dir, &rows(2))),
        Box::new(move |dir| write_npy(&dir.join(file), "(3, 15)", &[0.0; 45])),
        Box::new(move |dir| std::fs::write(dir.join(file), "nonsense").unwrap()),
        with_number(1, 3, f64::NAN),
        with_number(2, 16, f64::INFINITY),
        with_number(1, 9, 23.5),
        with_number(2, 4, -16.0),
        with_number(1, 14, 0.0),
        with_number(1, 15, 50.0),
    ]));
    let skewed = rig(&NAMES, 3);
    with_number(1, 0, 0.5)(skewed.path());
    assert_refused(skewed.path(), &Params::default(), &["cam02", "not orthonormal", file]);
}

#[test]
fn wrong_frames_are_refused_with_the_camera() {
    let remove = |file: &'static str| -> Fault { Box::new(move |dir| std::fs::remove_file(dir.join(file)).unwrap()) };
    insta::assert_snapshot!(refusals(vec![
        remove("cam02/images/0002.png"),
        remove("cam10/images/0000.png"),
        remove("cam10/images/0001.png"),
        Box::new(|dir| write_image(&dir.join("cam02/images/0001.jpg"), 0)),
        Box::new(|dir| write_image(&dir.join("cam02/images/last.png"), 0)),
        Box::new(|dir| image::RgbImage::new(20, 16).save(dir.join("cam02/images/0001.png")).unwrap()),
        with_number(0, 9, 36.0),
        with_number(1, 9, 48.0),
        Box::new(|dir| std::fs::write(dir.join("points3D.ply"), "ply\n").unwrap()),
    ]));
}

#[test]
fn damaged_videos_and_empty_cameras_are_refused() {
    let leave_videos = |names: &'static [&str]| -> Fault {
        Box::new(move |dir| {
            for name in names {
                std::fs::remove_dir_all(dir.join(name)).unwrap();
                std::fs::write(dir.join(format!("{name}.mp4")), "x").unwrap();
            }
        })
    };
    let empty: Fault = Box::new(|dir| {
        std::fs::remove_dir_all(dir.join("cam02")).unwrap();
        std::fs::create_dir(dir.join("cam02")).unwrap();
    });
    insta::assert_snapshot!(refusals(vec![leave_videos(&NAMES), leave_videos(&["cam02"]), empty]));
    // Videos next to their frames are ignored, and so are other names.
    let dir = rig(&NAMES, 2);
    for name in ["cam02.mp4", "cam100.mp4", "camera.mp4", "cam05"] {
        std::fs::write(dir.path().join(name), "a file").unwrap();
    }
    assert!(run(dir.path(), &Params::default()).is_ok());
}

#[test]
fn a_rig_is_described_with_a_recipe() {
    let dir = rig(&NAMES, 4);
    insta::assert_snapshot!(describe(dir.path()).unwrap());
    assert_eq!(inspect(dir.path()).unwrap().captures[0].format, Format::N3v);
    assert_refused(dir.path(), &Params { format: Format::Nerfies, ..Params::default() }, &["not a Nerfies/HyperNeRF"]);
    std::fs::remove_dir_all(dir.path().join("cam02/images")).unwrap();
    insta::assert_snapshot!("a_rig_without_frames", describe(dir.path()).unwrap());
}

#[test]
fn coffee_martini_warns_of_its_late_camera() {
    let dir = rig(&["cam00", "cam13"], 2);
    let scene = dir.path().join("coffee_martini");
    std::fs::create_dir(&scene).unwrap();
    for name in ["cam00", "cam13", "poses_bounds.npy"] {
        std::fs::rename(dir.path().join(name), scene.join(name)).unwrap();
    }
    let warned = || describe(&scene).unwrap().contains("cam13 is badly synchronised");
    assert!(warned());
    std::fs::rename(scene.join("cam13"), scene.join("cam14")).unwrap();
    assert!(!warned());
}

/// At the real size.
#[test]
fn recipes_of_full_size_rigs_name_the_protocol() {
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
    assert_eq!(read(dir.path(), &Params::default()).unwrap().split_rule, preset.split);
}
