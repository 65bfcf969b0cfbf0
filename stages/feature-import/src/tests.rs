//! The stage on synthetic captures and on files.

use engine::Artifact as _;
use scene::{Capture, Naming};
use scene_synthesis::{CameraPath, Params as SceneParams, SceneKind, Truth};

use crate::run::{better_shift_of, from_files, from_labels};
use crate::{Features, Params, tensor_file};

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
fn tokens_encode_the_class_shares_of_their_cell() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::BouncingSpheres);
    let out = dir.path().join("features");
    let params = Params { grid: 10, dimension: 7, ..Params::default() };
    let features = from_labels(&capture, &params, &out).unwrap();
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
    assert!(seen.iter().all(|seen| *seen), "a class is never visible: {seen:?}");
}

#[test]
fn prompts_are_the_class_names_of_each_scene() {
    let dir = tempfile::tempdir().unwrap();
    for (scene, expected) in [
        (SceneKind::SwingingArm, &["background", "arm"][..]),
        (SceneKind::WavingCloth, &["background", "cloth"]),
        (SceneKind::Occluder, &["background", "ball"]),
        (SceneKind::StaticBlocks, &["background"]),
    ] {
        let root = dir.path().join(format!("{scene:?}"));
        let capture = capture(&root.join("capture"), scene);
        let features = from_labels(&capture, &Params { grid: 4, ..Params::default() }, &root.join("features")).unwrap();
        features.check().unwrap();
        assert_eq!(features.prompts, expected);
    }
}

#[test]
fn too_many_classes_and_missing_labels_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let labelled = capture(&dir.path().join("capture"), SceneKind::BouncingSpheres);
    let refusal = |capture: &Capture, params: &Params| {
        format!("{:#}", from_labels(capture, params, &dir.path().join("features")).unwrap_err())
    };
    let message = refusal(&labelled, &Params { dimension: 4, ..Params::default() });
    assert!(message.contains("5 classes") && message.contains("at least 5"), "{message}");
    let mut unlabelled = labelled;
    unlabelled.views[2].mask = None;
    let message = refusal(&unlabelled, &Params::default());
    assert!(message.contains("train_0002") && message.contains("masks"), "{message}");
}

#[test]
fn the_check_reports_damaged_files_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::SwingingArm);
    let out = dir.path().join("features");
    let features = from_labels(&capture, &Params { grid: 4, dimension: 3, ..Params::default() }, &out).unwrap();
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

    // Features of another capture are rejected.
    let mut renamed = capture;
    renamed.views[0].name = "other".into();
    assert!(features.check_against(&renamed).is_err());
    renamed.views.pop();
    assert!(features.check_against(&renamed).is_err());
}

/// Writes an `.npy` file of f32 values.
fn write_npy(path: &std::path::Path, shape: &str, values: &[f32]) {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = [&b"\x93NUMPY\x01\x00\x76\x00"[..], format!("{header:<117}\n").as_bytes()].concat();
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    std::fs::write(path, bytes).unwrap();
}

/// Writes files for the training views of a capture, in both formats, with three prompts of dimension 2.
fn write_files(folder: &std::path::Path, capture: &Capture) {
    std::fs::create_dir_all(folder.join("clip")).unwrap();
    std::fs::write(folder.join("prompts.txt"), "a ball\nthe floor\nnothing\n").unwrap();
    write_npy(&folder.join("text.npy"), "(3, 2)", &[1.0, 0.0, 0.0, 1.0, -1.0, 0.0]);
    for (index, view) in capture.views_of(scene::Split::Train) {
        let values = [index as f32, 1.0, 2.0, 3.0];
        if index % 2 == 0 {
            write_npy(&folder.join(format!("clip/{}.npy", view.name)), "(1, 2, 2)", &values);
        } else {
            let path = folder.join(format!("clip/{}.safetensors", view.name));
            tensor_file::write(&path, "anything", &[1, 2, 2], &values).unwrap();
        }
    }
}

#[test]
fn files_are_found_by_view_name_or_frame_number() {
    let dir = tempfile::tempdir().unwrap();
    let mut capture = capture(&dir.path().join("capture"), SceneKind::Occluder);
    let folder = dir.path().join("aux");
    write_files(&folder, &capture);
    let check = |capture: &Capture, out: &str| {
        let features = from_files(capture, &folder, Naming::Auto, &dir.path().join(out)).unwrap();
        features.check().unwrap();
        assert_eq!(features.prompts, ["a ball", "the floor", "nothing"]);
        assert_eq!(features.load_text().unwrap()[4..], [-1.0, 0.0]);
        for (index, view) in capture.views.iter().enumerate() {
            let tokens = features.load_tokens(index).unwrap();
            let expected = (view.split == scene::Split::Train).then(|| vec![index as f32, 1.0, 2.0, 3.0]);
            assert_eq!(tokens.map(|tokens| tokens.values), expected, "{}", view.name);
        }
    };
    check(&capture, "by-name");
    // Frame numbers must be unique, so the held-out views, which share theirs with training views, are removed.
    capture.views.retain(|view| view.split == scene::Split::Train);
    for (index, view) in capture.views.iter().enumerate() {
        let extension = if index % 2 == 0 { "npy" } else { "safetensors" };
        let path = |name: &str| folder.join(format!("clip/{name}.{extension}"));
        std::fs::rename(path(&view.name), path(&format!("{index:05}"))).unwrap();
    }
    check(&capture, "by-number");
}

#[test]
fn tokens_of_other_frames_are_noticed_by_the_changes_of_the_images() {
    let dir = tempfile::tempdir().unwrap();
    let params = SceneParams {
        scene: SceneKind::BouncingSpheres,
        camera: CameraPath::Rig,
        width: 48,
        height: 32,
        frames: 12,
        rig_cameras: 2,
        val_views: 0,
        test_views: 1,
        samples_per_pixel: 1,
        truths: [Truth::Masks].into(),
        ..SceneParams::default()
    };
    let capture = scene_synthesis::synthesize(&params, &dir.path().join("capture"), 1, |_, _| Ok(())).unwrap();
    // Without text, the longest axis is that of the features.
    let exact = Params { grid: 16, dimension: 20, ..Params::default() };
    let exact = from_labels(&capture, &exact, &dir.path().join("exact")).unwrap();
    let videos = scene::Videos::of(&capture);
    let shift_of = |shift: i64| {
        let folder = dir.path().join(format!("aux{shift}"));
        std::fs::create_dir_all(folder.join("dino")).unwrap();
        for (index, view) in capture.views.iter().enumerate() {
            let tokens = exact.load_tokens(videos.after(view, shift).unwrap_or(index)).unwrap().unwrap();
            let path = folder.join(format!("dino/{}.safetensors", view.name));
            tensor_file::write(&path, "tokens", &[tokens.rows, tokens.columns, 20], &tokens.values).unwrap();
        }
        let out = dir.path().join(format!("features{shift}"));
        better_shift_of(&from_files(&capture, &folder, Naming::Auto, &out).unwrap(), &capture).unwrap()
    };
    assert_eq!([-1, 0, 1].map(shift_of), [Some(1), None, Some(-1)]);
}

#[test]
fn inconsistent_files_are_rejected_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::Occluder);
    type Fault = fn(&std::path::Path);
    let cases: [(Fault, &[&str]); 9] = [
        (|folder| std::fs::remove_file(folder.join("prompts.txt")).unwrap(), &["prompts", "prompts.txt"]),
        (|folder| std::fs::write(folder.join("prompts.txt"), "a\n\nb\n").unwrap(), &["line 2", "prompts.txt"]),
        (
            |folder| std::fs::write(folder.join("prompts.txt"), "a\nb\n").unwrap(),
            &["3 text embeddings for 2", "text.npy"],
        ),
        (|folder| std::fs::remove_file(folder.join("text.npy")).unwrap(), &["no text", "text.npy"]),
        (|folder| write_npy(&folder.join("text.npy"), "(6,)", &[1.0; 6]), &["[6]", "[prompts, F]", "text.npy"]),
        (
            |folder| write_npy(&folder.join("text.npy"), "(3, 2)", &[1.0, 1.0, 0.0, 0.0, 1.0, 1.0]),
            &["vector 1 is zero"],
        ),
        (|folder| std::fs::remove_file(folder.join("clip/train_0002.npy")).unwrap(), &["train_0002 has no tokens"]),
        (
            |folder| write_npy(&folder.join("clip/train_0000.npy"), "(1, 1, 3)", &[1.0; 3]),
            &["dimension 3", "train_0000.npy"],
        ),
        (
            |folder| write_npy(&folder.join("clip/train_0000.npy"), "(1, 1, 2)", &[f32::NAN; 2]),
            &["vector 0 is not finite", "train_0000.npy"],
        ),
    ];
    for (at, (fault, expected)) in cases.into_iter().enumerate() {
        let folder = dir.path().join(format!("aux{at}"));
        write_files(&folder, &capture);
        fault(&folder);
        let message =
            format!("{:#}", from_files(&capture, &folder, Naming::Auto, &dir.path().join("features")).unwrap_err());
        assert!(expected.iter().all(|part| message.contains(part)), "{expected:?}: {message}");
    }
    let message =
        format!("{:#}", from_files(&capture, &dir.path().join("none"), Naming::Auto, dir.path()).unwrap_err());
    assert!(message.contains("--data-root"), "{message}");
}

#[test]
fn tokens_without_text_are_imported_from_dino() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::Occluder);
    let folder = dir.path().join("aux");
    std::fs::create_dir_all(folder.join("dino")).unwrap();
    // As DINOv2 in transformers writes them: a batch of one image, a class token, then 2 × 2 patches.
    for (index, view) in capture.views_of(scene::Split::Train) {
        let values: Vec<f32> = (0..5 * 3).map(|at| (at + index) as f32).collect();
        write_npy(&folder.join(format!("dino/{}.npy", view.name)), "(1, 5, 3)", &values);
    }
    let out = dir.path().join("features");
    let features = from_files(&capture, &folder, Naming::Auto, &out).unwrap();
    features.check().unwrap();
    assert_eq!(Features::open(&out).unwrap(), features);
    assert!(features.prompts.is_empty() && features.load_text().unwrap().is_empty() && features.dimension == 3);
    let (index, _) = capture.views_of(scene::Split::Train).nth(1).unwrap();
    let tokens = features.load_tokens(index).unwrap().unwrap();
    assert_eq!((tokens.rows, tokens.columns, tokens.values[0]), (2, 2, (3 + index) as f32));
}

/// CLIP's embeddings of the names of COCO's classes, which Detic ships: in half precision and not normalised.
#[test]
fn real_text_embeddings_of_clip_are_imported() {
    let Some(embeddings) = support::data("formats/outputs/features/coco_clip_a+cname.npy") else { return };
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::Occluder);
    let folder = dir.path().join("aux");
    std::fs::create_dir_all(folder.join("clip")).unwrap();
    let prompts: Vec<String> = (0..80).map(|class| format!("class {class}")).collect();
    std::fs::write(folder.join("prompts.txt"), prompts.join("\n")).unwrap();
    std::fs::copy(embeddings, folder.join("text.npy")).unwrap();
    for (_, view) in capture.views_of(scene::Split::Train) {
        write_npy(&folder.join(format!("clip/{}.npy", view.name)), "(1, 1, 512)", &[1.0; 512]);
    }
    let features = from_files(&capture, &folder, Naming::Auto, &dir.path().join("features")).unwrap();
    features.check().unwrap();
    assert_eq!((&features.prompts, features.dimension), (&prompts, 512));
    let text = features.load_text().unwrap();
    let lengths = text.chunks_exact(512).map(|row| row.iter().map(|value| value * value).sum::<f32>().sqrt());
    let lengths: Vec<f32> = lengths.collect();
    assert!(lengths.len() == 80 && lengths.iter().all(|length| (8.0..12.0).contains(length)), "{lengths:?}");
}

#[test]
fn segments_of_langsplat_are_imported() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::Occluder);
    let folder = dir.path().join("aux");
    write_files(&folder, &capture);
    for (_, view) in capture.views_of(scene::Split::Train) {
        let name = |ending: &str| folder.join(format!("clip/{}{ending}", view.name));
        [name(".npy"), name(".safetensors")].iter().for_each(|path| drop(std::fs::remove_file(path)));
        write_npy(&name("_f.npy"), "(2, 2)", &[1.0, 0.0, 0.0, 1.0]);
        // Four levels of 2 × 4 pixels; the left half shows the second segment.
        let whole = [1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0];
        write_npy(&name("_s.npy"), "(4, 2, 4)", &[[-1.0; 8], [-1.0; 8], [-1.0; 8], whole].concat());
    }
    let features = from_files(&capture, &folder, Naming::Auto, &dir.path().join("features")).unwrap();
    features.check().unwrap();
    let tokens = features.load_tokens(0).unwrap().unwrap();
    assert_eq!(tokens.values[..2], [0.0, 1.0]);
    assert_eq!(tokens.values[tokens.values.len() - 2..], [1.0, 0.0]);
}
