use super::*;
use crate::ply::Ply;

fn some(count: usize, sh_degree: usize) -> Gaussians {
    let values = |length: usize, offset: f32| (0..length).map(|at| offset + 0.37 * at as f32).collect::<Vec<_>>();
    Gaussians {
        positions: values(3 * count, -1.0),
        log_scales: values(3 * count, -5.0),
        rotations: values(4 * count, 0.1),
        opacity_logits: values(count, -2.0),
        sh: values(3 * (sh_degree + 1).pow(2) * count, -0.5),
        sh_degree,
    }
}

#[test]
fn every_degree_round_trips() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gaussians.ply");
    for sh_degree in 0..=3 {
        for count in [0, 1, 5] {
            let gaussians = some(count, sh_degree);
            gaussians.write_ply(&path).unwrap();
            assert_eq!(Gaussians::read_ply(&path).unwrap(), gaussians);
        }
    }
}

#[test]
fn higher_coefficients_are_stored_channel_major() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gaussians.ply");
    let gaussians = some(2, 2);
    gaussians.write_ply(&path).unwrap();
    let ply = Ply::open(&path).unwrap();
    let second = |name: &str| ply.vertices(&[name]).unwrap()[1];
    // The second of two Gaussians with nine coefficients: coefficient 3 of channel 1 has the number (9 - 1) · 1 + 3 -
    // 1.
    assert_eq!(second("f_rest_10"), gaussians.sh[27 + 3 * 3 + 1]);
    assert_eq!(second("f_dc_2"), gaussians.sh[27 + 2]);
    assert_eq!((second("nx"), second("opacity")), (0.0, gaussians.opacity_logits[1]));
    assert_eq!((second("scale_1"), second("rot_3")), (gaussians.log_scales[4], gaussians.rotations[7]));
}

#[test]
fn missing_properties_and_nan_values_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gaussians.ply");
    some(3, 1).write_ply(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for (name, reason) in [("f_rest_4", "match no degree"), ("opacity", "no property opacity")] {
        let at = bytes.windows(name.len()).position(|window| window == name.as_bytes()).unwrap();
        let mut changed = bytes.clone();
        changed[at] = b'q';
        std::fs::write(&path, changed).unwrap();
        let error = Gaussians::read_ply(&path).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    let mut changed = bytes.clone();
    let last = changed.len() - 4;
    changed[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&path, changed).unwrap();
    assert!(Gaussians::read_ply(&path).unwrap_err().to_string().contains("rotations[11]"));
    assert!(Gaussians { sh: vec![], ..some(2, 0) }.write_ply(&path).is_err());
}
