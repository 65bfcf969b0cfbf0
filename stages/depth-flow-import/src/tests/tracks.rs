//! Flow from the tracks of CoTracker and TAPIR: a grid of points that all move alike, except for one.

use std::io::Write as _;

use super::files::{npy, numbered_from_one, params};
use super::*;
use crate::params::{FlowParams, MapKind};

/// Motion per frame.
const STEP: [f32; 2] = [1.5, -0.5];
/// Pixels between tracks.
const GRID: usize = 6;

/// [frames, tracks, 2] positions and [frames, tracks] visibility. The first track is hidden in the second frame.
fn tracks(frames: usize) -> (usize, Vec<f32>, Vec<f32>) {
    let starts: Vec<[f32; 2]> = (0..48 / GRID)
        .flat_map(|x| (0..32 / GRID).map(move |y| [(x * GRID) as f32 + 3.0, (y * GRID) as f32 + 3.0]))
        .collect();
    let position = |frame: usize, start: &[f32; 2]| [0, 1].map(|axis| start[axis] + frame as f32 * STEP[axis]);
    let positions = (0..frames).flat_map(|frame| starts.iter().flat_map(move |start| position(frame, start)));
    let visible = (0..frames * starts.len()).map(|at| if at == starts.len() { 0.0 } else { 1.0 });
    (starts.len(), positions.collect(), visible.collect())
}

fn write(folder: &Path, members: &[(&str, Vec<u8>)]) {
    std::fs::create_dir_all(folder).unwrap();
    let mut archive = zip::ZipWriter::new(std::fs::File::create(folder.join("clip.npz")).unwrap());
    for (name, array) in members {
        archive.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(array).unwrap();
    }
    archive.finish().unwrap();
}

/// [tracks, frames, channels] from [frames, tracks, channels].
fn transposed(values: &[f32], frames: usize, tracks: usize, channels: usize) -> Vec<f32> {
    let places = (0..tracks).flat_map(|track| (0..frames).map(move |frame| (frame * tracks + track) * channels));
    places.flat_map(|at| values[at..at + channels].to_vec()).collect()
}

fn flow_params() -> Params {
    Params { maps: [MapKind::Flow].into(), ..params() }
}

/// The share of pixels with flow in the first and second frame; all of it must be the motion of the tracks.
fn known_shares(capture: &Capture, folder: &Path, params: &Params) -> [f64; 2] {
    let (_root, priors, _) = run(capture, folder, params).unwrap();
    assert!(priors.load_flow(capture.views.len() - 1).unwrap().is_none(), "no flow leads from the last frame");
    [0, 1].map(|at| {
        let flow = priors.load_flow(at).unwrap().unwrap();
        assert_eq!(flow.view_to, Some(at + 1));
        let known: Vec<_> = flow.map.flow_px.iter().filter(|flow| flow[0].is_finite()).collect();
        assert!(known.iter().all(|flow| (flow[0] - STEP[0]).abs() < 1e-4 && (flow[1] - STEP[1]).abs() < 1e-4));
        known.len() as f64 / flow.map.flow_px.len() as f64
    })
}

#[test]
fn cotracker_and_tapir_tracks_become_flow() {
    let dir = tempfile::tempdir().unwrap();
    let capture = numbered_from_one(dir.path(), SceneKind::BouncingSpheres);
    let frames = capture.views.len();
    let (count, positions, visible) = tracks(frames);
    let cotracker = tempfile::tempdir().unwrap();
    let array = |shape: String, values: &[f32]| npy(&shape, values.iter().copied());
    let [positions_array, visible_array] =
        [array(format!("(1, {frames}, {count}, 2)"), &positions), array(format!("(1, {frames}, {count})"), &visible)];
    write(&cotracker.path().join("tracks"), &[("tracks", positions_array), ("visibility", visible_array)]);
    let [first, second] = known_shares(&capture, cotracker.path(), &flow_params());
    assert!(first > 0.8, "{first}: the grid covers the image, less what leaves it");
    assert!(second < first && second > 0.6, "{second}: the hidden track has no flow");
    let tapir = tempfile::tempdir().unwrap();
    let positions_array = array(format!("({count}, {frames}, 2)"), &transposed(&positions, frames, count, 2));
    let visible_array = array(format!("({count}, {frames})"), &transposed(&visible, frames, count, 1));
    write(&tapir.path().join("tracks"), &[("tracks", positions_array), ("visibles", visible_array)]);
    assert_eq!(known_shares(&capture, tapir.path(), &flow_params()), [first, second]);
    // Tracked at twice the size.
    let large: Vec<f32> = positions.iter().map(|value| 2.0 * value).collect();
    write(&tapir.path().join("tracks"), &[("tracks", array(format!("({frames}, {count}, 2)"), &large))]);
    assert_refused(&capture, tapir.path(), &flow_params(), &["are outside of 48×32 pixels", "flow.track_width"]);
    let sized = Params { flow: FlowParams { track_width: Some(96), ..FlowParams::default() }, ..flow_params() };
    let visible = known_shares(&capture, tapir.path(), &sized);
    assert!(visible[0] > first, "without visibility, no track is hidden");
    let single = tempfile::tempdir().unwrap();
    std::fs::create_dir(single.path().join("tracks")).unwrap();
    let positions_array = array(format!("(1, {frames}, {count}, 2)"), &positions);
    std::fs::write(single.path().join("tracks/clip.npy"), positions_array).unwrap();
    assert_eq!(known_shares(&capture, single.path(), &flow_params()), visible);
}

#[test]
fn tracks_of_another_video_are_refused() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = numbered_from_one(dir.path(), SceneKind::BouncingSpheres);
    let frames = capture.views.len();
    let folder = maps.path().join("tracks");
    let array = |shape: String, count: usize| npy(&shape, (0..count).map(|_| 5.0));
    write(&folder, &[("tracks", array(format!("({}, 40, 2)", frames + 1), 80 * (frames + 1)))]);
    assert_refused(&capture, maps.path(), &flow_params(), &["tracks of shape", &format!("a video of {frames} frames")]);
    write(&folder, &[("tracks", array(format!("({frames}, {frames}, 2)"), 2 * frames * frames))]);
    assert_refused(&capture, maps.path(), &flow_params(), &["`visibility` or `visibles`"]);
    write(&folder, &[("video", array("(3,)".into(), 3))]);
    assert_refused(&capture, maps.path(), &flow_params(), &["none of the arrays tracks"]);
    std::fs::write(folder.join("other.npy"), b"").unwrap();
    assert_refused(&capture, maps.path(), &flow_params(), &["none or several"]);
}
