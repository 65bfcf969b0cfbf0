//! Reports and recipes of `inspect`.

use super::support::*;
use crate::inspect::inspect;
use crate::{Format, Params};

#[test]
fn a_blender_capture_is_described_with_a_recipe() {
    insta::assert_snapshot!(describe(blender_scene().path()).unwrap());
}

#[test]
fn a_colmap_capture_is_described_with_its_reprojection_error() {
    insta::assert_snapshot!(describe(Workspace::video(10).write().path()).unwrap());
}

#[test]
fn problems_are_listed_without_a_recipe() {
    let dir = blender_scene();
    for index in 0..2 {
        std::fs::remove_file(dir.path().join(format!("val/r_00{index}.png"))).unwrap();
    }
    insta::assert_snapshot!(describe(dir.path()).unwrap());
    let inspection = inspect(dir.path()).unwrap();
    assert!(inspection.recipe().is_none());
    let json = serde_json::to_value(&inspection.captures[0]).unwrap();
    assert_eq!(json["problems"].as_array().unwrap().len(), 2);
    assert_eq!(json["frames"]["counts"]["train"], 5);
    assert_eq!(json["format"], "blender");
}

#[test]
fn a_folder_of_captures_lists_each() {
    let root = tempfile::tempdir().unwrap();
    for name in ["a", "b"] {
        let scene = blender_scene();
        std::fs::rename(scene.keep(), root.path().join(name)).unwrap();
    }
    std::fs::remove_file(root.path().join("b/test/r_000.png")).unwrap();
    std::fs::create_dir(root.path().join("notes")).unwrap();
    insta::assert_snapshot!(describe(root.path()).unwrap());
    insta::assert_snapshot!("import_of_a_folder_of_captures", refusal(root.path(), &Params::default()));
}

#[test]
fn unrecognised_folders_get_a_hint_for_their_files() {
    let cases: [&[&str]; 6] = [
        &[],
        &["notes.txt"],
        &["dataset.json", "camera/0.json"],
        &["poses_bounds.npy"],
        &["cam00.mp4"],
        &["cameras.bin"],
    ];
    let mut refusals = Refusals::default();
    for files in cases {
        let dir = tempfile::tempdir().unwrap();
        for file in files {
            let path = dir.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "x").unwrap();
        }
        refusals.add(dir.path(), &Params::default());
        let text = describe(dir.path()).unwrap();
        assert!(text.contains("not recognised") && text.contains(&refusal(dir.path(), &Params::default())), "{text}");
    }
    insta::assert_snapshot!(refusals.text());
    assert!(describe(std::path::Path::new("/no/such/folder")).is_err());
}

#[test]
fn ambiguous_folders_need_a_format() {
    let mut refusals = Refusals::default();
    refusals.add(blender_scene().path(), &Params { format: Format::Colmap, ..Params::default() });
    let both = blender_scene();
    let model = Workspace::video(3).write();
    std::fs::rename(model.path().join("sparse"), both.path().join("sparse")).unwrap();
    refusals.add(both.path(), &Params::default());
    insta::assert_snapshot!(refusals.text());
    assert!(run(both.path(), &Params { format: Format::Blender, ..Params::default() }).is_ok());
}

#[test]
fn the_format_is_shown_for_unusable_files() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| json["camera_angle_x"] = serde_json::json!(0.0));
    insta::assert_snapshot!(describe(dir.path()).unwrap());
}

#[test]
fn impossible_poses_are_problems() {
    for (name, far) in [("a_pose_at_1e30", 1e30), ("a_pose_at_1e300", 1e300)] {
        let mut workspace = Workspace::video(10);
        workspace.model.images.get_mut(&3).unwrap().translation[0] = far;
        insta::assert_snapshot!(name, describe(workspace.write().path()).unwrap());
    }
}

#[test]
fn recipes_state_common_parameters_once() {
    let root = tempfile::tempdir().unwrap();
    for name in ["lego", "my {scene}"] {
        std::fs::rename(blender_scene().keep(), root.path().join(name)).unwrap();
    }
    let recipe = inspect(root.path()).unwrap().recipe().unwrap();
    insta::assert_snapshot!(shortened(&recipe, root.path()));
}
