//! The stage on synthetic captures.

use engine::Artifact as _;
use scene::Capture;
use scene_synthesis::{Params as SceneParams, SceneKind, Truth};

use crate::{Features, Params, import};

/// Six small views of a scene, with instance labels.
fn capture(dir: &std::path::Path, scene: SceneKind) -> Capture {
    let params = SceneParams {
        scene,
        width: 40,
        height: 24,
        frames: 4,
        val_views: 1,
        test_views: 1,
        samples_per_pixel: 1,
        truths: [Truth::Masks].into(),
        ..SceneParams::default()
    };
    scene_synthesis::synthesize(&params, dir, 1, |_, _| Ok(())).unwrap()
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[test]
fn a_token_times_an_embedding_is_the_share_of_the_cell_that_shows_the_class() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::BouncingSpheres);
    let out = dir.path().join("features");
    let params = Params { grid: 10, dimension: 7, ..Params::default() };
    let features = import(&capture, &params, &out).unwrap();
    features.check().unwrap();
    assert_eq!(Features::open(&out).unwrap(), features);
    features.check_against(&capture).unwrap();
    assert_eq!(features.prompts, ["background", "red ball", "blue ball", "green ball", "orange ball"]);
    let text = features.load_text().unwrap();
    let mut seen = [false; 5];
    for (index, view) in capture.views.iter().enumerate() {
        let labels = capture.load_mask(view).unwrap().unwrap();
        let tokens = features.load_tokens(index).unwrap().unwrap();
        assert_eq!((tokens.rows, tokens.columns), (6, 10)); // cells of 4×4 pixels
        for (at, token) in tokens.values.chunks_exact(7).enumerate() {
            let (row, column) = (at / 10, at % 10);
            let pixels = (0..16).map(|at| labels.labels[(4 * row + at / 4) * 40 + 4 * column + at % 4]);
            for (label, embedding) in text.chunks_exact(7).enumerate() {
                let share = pixels.clone().filter(|found| usize::from(*found) == label).count() as f64 / 16.0;
                let error = (dot(token, embedding) - share).abs();
                assert!(error <= 1e-5, "view {index} cell {row},{column} label {label}: off by {error}");
                seen[label] |= share > 0.5;
            }
        }
    }
    assert!(seen.iter().all(|seen| *seen), "some class was never seen: {seen:?}");
}

#[test]
fn every_synthetic_scene_names_its_instances() {
    let dir = tempfile::tempdir().unwrap();
    for (scene, expected) in [
        (SceneKind::SwingingArm, &["background", "arm"][..]),
        (SceneKind::WavingCloth, &["background", "cloth"]),
        (SceneKind::Occluder, &["background", "ball"]),
        (SceneKind::StaticBlocks, &["background"]),
    ] {
        let root = dir.path().join(format!("{scene:?}"));
        let capture = capture(&root.join("capture"), scene);
        let features = import(&capture, &Params { grid: 4, ..Params::default() }, &root.join("features")).unwrap();
        features.check().unwrap();
        assert_eq!(features.prompts, expected);
    }
}

#[test]
fn what_cannot_work_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let labelled = capture(&dir.path().join("capture"), SceneKind::BouncingSpheres);
    let refusal = |capture: &Capture, params: &Params| {
        format!("{:#}", import(capture, params, &dir.path().join("features")).unwrap_err())
    };
    let message = refusal(&labelled, &Params { dimension: 4, ..Params::default() });
    assert!(message.contains("5 classes") && message.contains("at least 5"), "{message}");
    let mut unlabelled = labelled;
    unlabelled.views[2].mask = None;
    let message = refusal(&unlabelled, &Params::default());
    assert!(message.contains("train_0002") && message.contains("masks"), "{message}");
}

#[test]
fn damage_is_found_by_the_check_and_names_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::SwingingArm);
    let out = dir.path().join("features");
    let features = import(&capture, &Params { grid: 4, dimension: 3, ..Params::default() }, &out).unwrap();
    let path = out.join("visual/train_0001.safetensors");
    let original = std::fs::read(&path).unwrap();
    let refusal = || format!("{:#}", features.check().unwrap_err());
    let with_token = |value: f32| {
        let mut bytes = original.clone();
        let end = bytes.len();
        bytes[end - 12..].chunks_exact_mut(4).for_each(|bytes| bytes.copy_from_slice(&value.to_le_bytes()));
        std::fs::write(&path, bytes).unwrap();
    };
    for (value, expected) in [(f32::NAN, "not finite"), (f32::INFINITY, "not finite"), (0.0, "zero")] {
        with_token(value);
        let message = refusal();
        assert!(message.contains(expected) && message.contains("train_0001.safetensors"), "{value}: {message}");
    }
    std::fs::write(&path, &original[..original.len() - 1]).unwrap();
    assert!(refusal().contains("train_0001.safetensors"));
    std::fs::write(&path, &original).unwrap();
    features.check().unwrap();

    // Features of another capture are not taken for those of this one.
    let mut renamed = capture;
    renamed.views[0].name = "other".into();
    assert!(features.check_against(&renamed).is_err());
    renamed.views.pop();
    assert!(features.check_against(&renamed).is_err());
}
