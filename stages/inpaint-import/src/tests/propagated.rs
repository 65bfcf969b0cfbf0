//! Filling from other views, which see behind the square.

use depth_flow_import::Priors;

use super::*;

#[test]
fn a_static_camera_recovers_every_pixel_exactly() {
    let painted = Painted::new(CameraPath::Rig, Behind::White, false, crossing);
    let (_root, background) = painted.run(None, no_folders(), &Params::default()).unwrap();
    assert_eq!(painted.errors(&background), (0.0, 0.0, 0.0), "a static camera needs no resampling");
    assert_eq!(background.source, "propagate");
    let held_out: Vec<_> = painted.capture.views_of(Split::Test).map(|(index, _)| index).collect();
    assert!(held_out.iter().all(|index| background.load_view(*index).unwrap().is_none()));
}

#[test]
fn pixels_hidden_in_every_view_stay_unfilled() {
    let painted = Painted::new(CameraPath::Rig, Behind::White, false, |_| (30, 40));
    let params = Params { margin_px: 0, ..Params::default() };
    let (_root, background) = painted.run(None, no_folders(), &params).unwrap();
    let expected = (SIDE * SIDE) as f64 / f64::from(SIZE * SIZE);
    assert!((background.unfilled_share() - expected).abs() <= 1e-12, "{}", background.unfilled_share());
    for (_, filled, mask) in painted.filled(&background) {
        assert_eq!(Mask::from(&filled.unfilled), mask);
        let inside = filled.image.pixels().zip(&mask.inside).filter(|(_, inside)| **inside);
        assert!(inside.into_iter().all(|(pixel, _)| pixel.0 == [255; 3]), "no moving pixel is left");
    }
}

#[test]
fn a_moving_camera_sees_behind_the_square() {
    for behind in [Behind::White, Behind::None] {
        let painted = Painted::new(CameraPath::Arc, behind, true, crossing);
        let (_root, background) = painted.run(None, no_folders(), &Params::default()).unwrap();
        let (error, depth_error, unfilled) = painted.errors(&background);
        eprintln!("{behind:?}: {error:.2} grey levels, depth {depth_error:.4}, unfilled {unfilled:.4}");
        // Errors concentrate at edges of textures and bodies, which no two views sample alike.
        assert!(error <= 15.0, "{behind:?}: {error}");
        assert!(depth_error <= 0.02, "{behind:?}: {depth_error}");
        // The square hides some pixels in every frame that could show them.
        assert!(unfilled <= 0.25, "{behind:?}: {unfilled}");
    }
}

#[test]
fn the_number_of_threads_changes_no_pixel() {
    let painted = Painted::new(CameraPath::Arc, Behind::White, true, crossing);
    let run = |threads| painted.run_with(threads, None, no_folders(), &Params::default()).unwrap();
    let ((_one, one), (_three, three)) = (run(1), run(3));
    for index in 0..painted.capture.views.len() {
        assert_eq!(one.load_view(index).unwrap(), three.load_view(index).unwrap());
    }
}

#[test]
fn inconsistent_depth_is_noticed_by_the_comparison() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, true, crossing);
    let dir = tempfile::tempdir().unwrap();
    let wrong = |(at, view): (usize, &View)| {
        let mut depth = painted.capture.load_depth(view).unwrap();
        // Planted fault: the depth of every other view has another scale.
        let factor = if at.is_multiple_of(2) { 0.8 } else { 1.2 };
        depth.iter_mut().flat_map(|map| &mut map.depth_view).for_each(|z| *z *= factor);
        let maps = depth_flow_import::ViewMaps { depth, ..Default::default() };
        Priors::write_view(dir.path(), &view.name, view.camera, &maps).unwrap()
    };
    let views = painted.capture.views.iter().enumerate().map(wrong).collect();
    Priors::save(dir.path(), "files", views).unwrap();
    let (_root, background) = painted.run(Some(dir.path()), no_folders(), &Params::default()).unwrap();
    let (error, depth_error, unfilled) = painted.errors(&background);
    eprintln!("inconsistent depth: {error:.2} grey levels, depth {depth_error:.4}, unfilled {unfilled:.4}");
    assert!(depth_error > 0.1 || unfilled > 0.5, "the comparison is blind to {depth_error} {unfilled}");
}
