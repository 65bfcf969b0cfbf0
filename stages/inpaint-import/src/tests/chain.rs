//! The chain of stages from a capture to its background: the floor appears behind the balls.

use depth_flow_import::DepthFlowImport;
use engine::Stage;
use layer_split::LayerSplit;
use scene::{DepthMap, pixels};

use super::*;

/// Runs a stage on the artifacts in the given folders; its own artifact is in `output` below the returned folder.
fn run_stage<S: Stage>(inputs: &[(&str, &Path)], params: &S::Params) -> TempDir {
    let root = tempfile::tempdir().unwrap();
    let mut context = JobContext::detached(root.path()).unwrap();
    context.inputs = inputs.iter().map(|(port, dir)| ((*port).to_owned(), input(dir))).collect();
    S::run(&context, params).unwrap();
    root
}

#[test]
fn the_floor_is_filled_in_behind_bouncing_balls() {
    let dir = tempfile::tempdir().unwrap();
    let params = Scene {
        scene: SceneKind::BouncingSpheres,
        camera: CameraPath::Arc,
        width: SIZE,
        height: SIZE,
        frames: 16,
        fps: 10.0,
        val_views: 0,
        test_views: 0,
        samples_per_pixel: 1,
        truths: [Truth::Alpha, Truth::Depth, Truth::Flow].into(),
        ..Scene::default()
    };
    let capture = scene_synthesis::synthesize(&params, dir.path(), 2, |_, _| Ok(())).unwrap();
    let priors = run_stage::<DepthFlowImport>(&[("capture", dir.path())], &Default::default());
    let priors = priors.path().join("output");
    let inputs = [("capture", dir.path()), ("priors", &priors)];
    let layers = run_stage::<LayerSplit>(&inputs, &Default::default());
    let layers = layers.path().join("output");
    let inputs = [("capture", dir.path()), ("layers", &layers), ("priors", &priors)];
    let background = run_stage::<InpaintImport>(&inputs, &Params::default());
    let background = Background::open(&background.path().join("output")).unwrap();
    let layers = Layers::open(&layers).unwrap();
    assert_eq!(layers.source, "residual-flow");
    // World heights of pixels; everything static in the first view is the floor.
    let heights = |view: &View, depth: &DepthMap, inside: &dyn Fn(usize) -> bool| -> Vec<f64> {
        let world_from_camera = view.camera.camera_from_world.inverse();
        let centers = pixels::centers(SIZE, SIZE).zip(&depth.depth_view).enumerate();
        let seen = centers.filter(|(at, (_, z))| **z > 0.0 && inside(*at));
        seen.map(|(_, (center, z))| world_from_camera.apply(view.camera.ray_view(center) * f64::from(*z)).z).collect()
    };
    let moving = |index: usize| Mask::from(&layers.load_moving(index).unwrap().unwrap()).dilated(2);
    let first = &capture.views[0];
    let first_moving = moving(0);
    let mut floor = heights(first, &capture.load_depth(first).unwrap().unwrap(), &|at| !first_moving.inside[at]);
    floor.sort_by(f64::total_cmp);
    let floor = floor[floor.len() / 2];
    let (mut on_floor, mut all) = (0, 0);
    for (index, view) in capture.views.iter().enumerate() {
        let Some(filled) = background.load_view(index).unwrap() else { continue };
        let moving = moving(index);
        let found = heights(view, &filled.depth.unwrap(), &|at| moving.inside[at]);
        all += found.len();
        on_floor += found.iter().filter(|height| (*height - floor).abs() <= 0.03).count();
    }
    eprintln!("{on_floor} of {all} filled pixels show the floor, {:.4} unfilled", background.unfilled_share());
    assert!(all > 2000 && on_floor as f64 >= 0.97 * all as f64, "{on_floor} of {all}");
    assert!(background.unfilled_share() <= 0.05, "{}", background.unfilled_share());
}
