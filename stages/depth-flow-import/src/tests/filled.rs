//! Flow without depth: the depth of the capture, or that between its points.

use scene::Split;

use super::files::params;
use super::*;

/// Writes the flow of every training view into `folder`.
fn write_flow(folder: &Path, capture: &Capture) {
    std::fs::create_dir_all(folder.join("flow_fwd")).unwrap();
    for (_, view) in capture.views_of(Split::Train).filter(|(_, view)| view.flow.is_some()) {
        let flow = capture.load_flow(view).unwrap().unwrap();
        let channel = |axis: usize| flow.flow_px.iter().map(|step| step[axis]).collect::<Vec<f32>>();
        let path = folder.join(format!("flow_fwd/{}.exr", view.name));
        scene::exr_file::write(&path, flow.width, flow.height, &[("X", channel(0)), ("Y", channel(1))]).unwrap();
    }
}

/// The depth and the number of flow maps of all views.
fn maps(capture: &Capture, folder: &Path, params: &Params) -> (Vec<scene::DepthMap>, usize, Priors) {
    let (_root, priors, _) = run(capture, folder, params).unwrap();
    let depths = (0..capture.views.len()).map(|view| priors.load_depth(view).unwrap().unwrap()).collect();
    let flows = priors.views.iter().filter(|view| view.flow.is_some()).count();
    (depths, flows, priors)
}

#[test]
fn flow_without_depth_takes_the_depth_of_the_capture_or_its_points() {
    let (dir, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut capture = capture_of(5, dir.path(), SceneKind::BouncingSpheres, CameraPath::Rig);
    write_flow(folder.path(), &capture);
    let (_root, alone, _) = run(&capture, folder.path(), &params()).unwrap();
    assert!(alone.views.iter().all(|view| view.depth.is_none()) && !alone.depth_is_static());

    let filled = Params { fill_depth: true, ..params() };
    let (own, flows, priors) = maps(&capture, folder.path(), &filled);
    let truth = |at: usize| capture.load_depth(&capture.views[at]).unwrap().unwrap();
    assert!(own.iter().enumerate().all(|(at, depth)| depth.depth_view == truth(at).depth_view));
    assert_eq!((flows > 0, priors.source.as_str(), priors.depth_is_static()), (true, "files", false));

    capture.views.iter_mut().for_each(|view| view.depth = None);
    scene::index_file::write(&dir.path().join("capture.json"), "a capture", &capture).unwrap();
    let (interpolated, same, priors) = maps(&capture, folder.path(), &filled);
    assert_eq!((same, priors.depth_is_static()), (flows, true));
    let points = Params { source: crate::params::MapSource::SparsePoints, ..Params::default() };
    let (expected, none, priors) = maps(&capture, folder.path(), &points);
    assert!(none == 0 && priors.depth_is_static());
    assert!(interpolated.iter().zip(&expected).all(|(a, b)| a.depth_view == b.depth_view));
    assert!(interpolated[0].depth_view != own[0].depth_view);

    capture.has_points = false;
    scene::index_file::write(&dir.path().join("capture.json"), "a capture", &capture).unwrap();
    assert_refused(&capture, folder.path(), &filled, &["no points to interpolate depth from"]);
}
