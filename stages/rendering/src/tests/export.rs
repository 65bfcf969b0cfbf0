//! Tests of the PLY export.

use super::trained;
use crate::export::ply_sequence;

#[test]
fn exported_gaussians_render_like_the_model() {
    let (dir, ..) = trained("deformable4dgs");
    let [capture, model, out] = ["capture", "model", "ply"].map(|name| dir.path().join(name));
    let report = ply_sequence(&model, &capture, &[0.0, 0.7, 2.0], None, &out).unwrap();
    assert_eq!(report.lines().count(), 3);
    for (index, line) in report.lines().enumerate() {
        assert!(out.join(format!("frame_{index:04}.ply")).is_file());
        let (_, agreement) = line.split_once("render: ").unwrap();
        let psnr = agreement.split_whitespace().next().and_then(|number| number.parse::<f64>().ok());
        assert!(agreement.starts_with("equal") || psnr.is_some_and(|psnr| psnr >= 60.0), "{line}");
    }
    // Planted fault: the file of another time must differ.
    let read = |index: usize| std::fs::read(out.join(format!("frame_{index:04}.ply"))).unwrap();
    assert_ne!(read(0), read(2));
    // Manually typed times may exceed the capture by their rounding.
    let report = ply_sequence(&model, &capture, &[0.0, 2.00005], None, &dir.path().join("rounded")).unwrap();
    assert!(report.lines().last().unwrap().starts_with("2.0000 s"), "{report}");
    let file = out.join("frame_0000.ply");
    assert!(ply_sequence(&model, &capture, &[0.0], None, &file).unwrap_err().to_string().contains("not a folder"));
}

#[test]
fn nonsense_times_are_refused() {
    let (dir, ..) = trained("static3dgs");
    let [capture, model, out] = ["capture", "model", "ply"].map(|name| dir.path().join(name));
    for times in [&[][..], &[f64::NAN], &[-1.0], &[2.5], &[1.0, 1.0], &[1.0, 0.5], &[f64::INFINITY]] {
        assert!(ply_sequence(&model, &capture, times, None, &out).is_err(), "{times:?} was accepted");
    }
    let falling = ply_sequence(&model, &capture, &[1.0, 0.5], None, &out).unwrap_err().to_string();
    assert!(
        falling.starts_with("times must increase, but 0.5 s follows 1 s; give them as FIRST:LAST:COUNT"),
        "{falling}"
    );
}
