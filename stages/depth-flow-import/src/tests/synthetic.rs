//! Imports of the maps of synthetic captures.

use super::*;
use crate::params::MapKind;

#[test]
fn maps_of_a_capture_are_copied_unchanged() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(dir.path(), SceneKind::BouncingSpheres, CameraPath::Arc);
    let (_root, priors, _) = run(&capture, Path::new(""), &Params::default()).unwrap();
    assert_eq!(priors.source, "capture");
    for (index, view) in capture.views.iter().enumerate() {
        assert_eq!(priors.load_depth(index).unwrap(), capture.load_depth(view).unwrap());
        assert_eq!(priors.load_velocity(index).unwrap(), capture.load_velocity(view).unwrap());
        assert_eq!(priors.load_normals(index).unwrap(), None);
        let flow = priors.load_flow(index).unwrap();
        assert_eq!(flow.is_some(), view.flow.is_some(), "the last frame has no flow");
        let Some(flow) = flow else { continue };
        let expected = capture.load_flow(view).unwrap().unwrap();
        assert!(
            flow.map
                .flow_px
                .iter()
                .flatten()
                .zip(expected.flow_px.iter().flatten())
                .all(|(a, b)| a.to_bits() == b.to_bits())
        );
        assert_eq!((flow.camera_to, flow.view_to), (view.camera, None), "no view shares the camera pose at that time");
        assert!((flow.time_to_secs - view.time_secs - 1.0 / 30.0).abs() <= 1e-12);
    }
    let depth = Params { maps: [MapKind::Depth].into(), ..Params::default() };
    let (_root, priors, _) = run(&capture, Path::new(""), &depth).unwrap();
    assert!(priors.views.iter().all(|view| view.depth.is_some() && view.flow.is_none() && view.velocity.is_none()));
}

#[test]
fn rig_flow_leads_to_the_next_view_of_its_camera() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(dir.path(), SceneKind::SwingingArm, CameraPath::Rig);
    let (_root, priors, _) = run(&capture, Path::new(""), &Params::default()).unwrap();
    let mut led = 0;
    for view in &priors.views {
        let Some(to) = view.flow.as_ref().and_then(|flow| flow.view_to) else { continue };
        let from = capture.views.iter().find(|other| other.name == view.name).unwrap();
        let target = &capture.views[to];
        assert_eq!((target.camera_index, target.frame_index), (from.camera_index, from.frame_index + 1));
        led += 1;
    }
    assert_eq!(led, 2 * 4, "four of five frames of two cameras");
}

#[test]
fn a_capture_without_maps_is_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let mut bare = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    for view in &mut bare.views {
        (view.depth, view.flow) = (None, None);
    }
    scene::index_file::write(&dir.path().join("capture.json"), "a capture", &bare).unwrap();
    assert_refused(&bare, Path::new(""), &Params::default(), &["no depth and no flow", "source = \"files\""]);
}
