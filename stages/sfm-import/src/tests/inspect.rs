use super::support::*;
use crate::Params;
use crate::inspect::inspect;
use crate::params::Format;

fn assert_contains(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in:\n{text}");
    }
}

#[test]
fn a_blender_capture_is_described_with_a_recipe() {
    let dir = blender_scene();
    let text = describe(dir.path()).unwrap();
    assert_contains(
        &text,
        &["D-NeRF", "24×16; 5 train, 2 val, 3 test", "40.1° wide", "0 to 1.0000 s", "ready to import"],
    );
    let name = dir.path().file_name().unwrap().to_str().unwrap().trim_start_matches('.');
    assert_contains(&text, &["[nodes.capture]", "stage = \"sfm-import\"", &format!("scene = [{name:?}]")]);
}

#[test]
fn a_colmap_capture_shows_its_reprojection_error() {
    let dir = Workspace::video(10).write();
    let text = describe(dir.path()).unwrap();
    assert_contains(
        &text,
        &["COLMAP", "30.0 × 31.0 px", "10 of 10 images registered", "6, 0.00 px from their keypoints"],
    );
    assert_contains(&text, &["8 train, 2 test", "static = true"]);
}

#[test]
fn problems_are_listed_with_files_and_no_recipe() {
    let dir = blender_scene();
    for index in 0..2 {
        std::fs::remove_file(dir.path().join(format!("val/r_00{index}.png"))).unwrap();
    }
    let text = describe(dir.path()).unwrap();
    assert_contains(&text, &["image file is missing", "val/r_000.png", "val/r_001.png", "cannot be imported"]);
    assert!(!text.contains("[nodes.capture]"), "{text}");
    let summary = &inspect(dir.path()).unwrap().captures[0];
    assert_eq!(summary.problems.len(), 2);
    let json = serde_json::to_value(summary).unwrap();
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
    let text = describe(root.path()).unwrap();
    assert_contains(&text, &["/a\n", "/b\n", "1 of 2 captures are ready", "scene = [\"a\"]", "source = \"{scene}\""]);
    assert_eq!(inspect(root.path()).unwrap().captures.len(), 2);
    assert_refused(root.path(), &Params::default(), &["folder of captures: choose one, as a"]);
}

#[test]
fn unknown_folders_say_what_was_found_and_what_is_supported() {
    let make = |files: &[&str]| {
        let dir = tempfile::tempdir().unwrap();
        for file in files {
            let path = dir.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "x").unwrap();
        }
        dir
    };
    let cases: [(&[&str], &str); 7] = [
        (&[], "the folder is empty"),
        (&["notes.txt"], "supported: transforms_{train,val,test}.json"),
        (&["transforms.json"], "nerfstudio"),
        (&["dataset.json", "camera/0.json"], "Nerfies"),
        (&["poses_bounds.npy"], "LLFF"),
        (&["cam00.mp4"], "needs poses_bounds.npy"),
        (&["cameras.bin"], "name the folder that holds both"),
    ];
    for (files, hint) in cases {
        let dir = make(files);
        assert_refused(
            dir.path(),
            &Params::default(),
            &["not a Blender/D-NeRF, COLMAP, Nerfies/HyperNeRF or Neural 3D Video capture (found", hint],
        );
        assert_contains(&describe(dir.path()).unwrap(), &["not recognised", hint]);
    }
    assert_refused(
        blender_scene().path(),
        &Params { format: Format::Colmap, ..Params::default() },
        &["not a COLMAP capture"],
    );
    assert!(describe(std::path::Path::new("/no/such/folder")).is_err());
    let both = blender_scene();
    let model = Workspace::video(3).write();
    std::fs::rename(model.path().join("sparse"), both.path().join("sparse")).unwrap();
    assert_refused(both.path(), &Params::default(), &["holds both", "set format"]);
    assert!(run(both.path(), &Params { format: Format::Blender, ..Params::default() }).is_ok());
}

#[test]
fn the_format_is_known_where_the_files_cannot_be_used() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| json["camera_angle_x"] = serde_json::json!(0.0));
    assert_contains(&describe(dir.path()).unwrap(), &["D-NeRF or Blender (transforms_*.json)", "camera_angle_x is 0"]);
}

#[test]
fn poses_that_no_camera_has_are_problems() {
    for (far, told) in [(1e30, "1e30 units from the origin"), (1e300, "inf units from the origin")] {
        let mut workspace = Workspace::video(10);
        workspace.model.images.get_mut(&3).unwrap().translation[0] = far;
        let text = describe(workspace.write().path()).unwrap();
        assert_contains(&text, &[told, "cannot be imported", "poses are wrong"]);
        assert!(!text.contains("NaN") && !text.contains(" px from their keypoints"), "{text}");
    }
}

#[test]
fn a_recipe_says_once_what_captures_have_in_common() {
    let root = tempfile::tempdir().unwrap();
    for name in ["lego", "my {scene}"] {
        std::fs::rename(blender_scene().keep(), root.path().join(name)).unwrap();
    }
    let recipe = inspect(root.path()).unwrap().recipe().unwrap();
    assert_contains(&recipe, &["scene = [\"lego\", \"my__scene_\"]", "params = { source = \"{scene}\" }"]);
    assert_contains(
        &recipe,
        &[
            "when = { scene = \"lego\" }\nnodes.capture.params.test_split = \"val\"",
            "when = { scene = \"my__scene_\" }\nnodes.capture.params.source = \"my {{scene}}\"",
        ],
    );
}
