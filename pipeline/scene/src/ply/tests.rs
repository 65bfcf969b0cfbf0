use super::*;
use crate::cloud::PointCloud;

const FORMATS: [PlyFormat; 3] = [PlyFormat::Ascii, PlyFormat::BinaryLittleEndian, PlyFormat::BinaryBigEndian];

fn file(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("points.ply");
    std::fs::write(&path, bytes).unwrap();
    (dir, path)
}

#[test]
fn clouds_round_trip_in_every_format() {
    let cloud = PointCloud {
        positions: vec![[0.1, -2.5e-7, 3.0e8], [f32::MIN_POSITIVE, 0.333_333_34, -0.0]],
        colors: vec![[0, 127, 255], [1, 2, 3]],
    };
    for format in FORMATS {
        let (_dir, path) = file(b"");
        cloud.write_ply(&path, format).unwrap();
        assert_eq!(PointCloud::read_ply(&path).unwrap(), cloud, "{format:?}");
    }
}

#[test]
fn extra_properties_lists_and_elements_are_skipped() {
    let text = "ply\r\nformat ascii 1.0\r\ncomment made by hand\r\nelement camera 1\r\nproperty list uchar int ids\r\n\
        element vertex 2\r\nproperty double x\r\nproperty float quality\r\nproperty double y\r\nproperty double z\r\n\
        property list uchar float weights\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n\
        3 7 8 9\r\n1.5 0.9 2 3e-1 0\r\n-4 0.8 5 6 2 0.1 0.2\r\n3 0 1 0\r\n";
    let (_dir, path) = file(text.as_bytes());
    let cloud = PointCloud::read_ply(&path).unwrap();
    assert_eq!(cloud.positions, [[1.5, 2.0, 0.3], [-4.0, 5.0, 6.0]]);
    assert_eq!(cloud.colors, [[128; 3]; 2], "grey where the file has no colours");
}

#[test]
fn binary_doubles_and_float_colours_are_converted() {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty double x\nproperty double y\n\
        property double z\nproperty float red\nproperty float green\nproperty float blue\nend_header\n"
        .to_vec();
    [1.25_f64, -2.0, 1e3].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    [0.0_f32, 0.5, 1.0].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    let (_dir, path) = file(&bytes);
    let cloud = PointCloud::read_ply(&path).unwrap();
    assert_eq!((cloud.positions, cloud.colors), (vec![[1.25, -2.0, 1e3]], vec![[0, 128, 255]]));
}

#[test]
fn colours_may_have_other_ranges_and_comments_any_encoding() {
    let colors = |kind: &str, values: &str| {
        let names = ["red", "green", "blue"].map(|name| format!("property {kind} {name}\n")).concat();
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        let comment = b"ply\nformat ascii 1.0\ncomment Export\xe9\n".as_slice();
        let rest = format!("element vertex 2\n{xyz}{names}end_header\n1 2 3 {values}\n1 nan 3 0 0 0\n");
        let (_dir, path) = file(&[comment, rest.as_bytes()].concat());
        assert!(PointCloud::read_ply(&path).unwrap_err().to_string().contains("has the position"));
        let (cloud, dropped) = PointCloud::read_finite_ply(&path).unwrap();
        assert_eq!((cloud.positions, dropped), (vec![[1.0, 2.0, 3.0]], 1));
        cloud.colors[0]
    };
    assert_eq!(colors("float", "10.0 128.0 255.0"), [10, 128, 255]);
    assert_eq!(colors("float", "0.0 0.5 1.1"), [0, 128, 255]);
    assert_eq!(colors("ushort", "2570 32896 65535"), [10, 128, 255]);
    assert_eq!(colors("ushort", "10 128 255"), [10, 128, 255]);
}

#[test]
fn gaussians_have_the_colours_of_degree_0() {
    let coefficient = |level: f32| (level / 255.0 - 0.5) / crate::gaussians::SH_C0;
    let colors = [coefficient(10.0), coefficient(128.0), coefficient(300.0)].map(|value| value.to_string()).join(" ");
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"].map(|name| format!("property float {name}\n")).concat();
    let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{names}end_header\n1 2 3 {colors}\n");
    let (_dir, path) = file(text.as_bytes());
    assert_eq!(PointCloud::read_ply(&path).unwrap().colors, [[10, 128, 255]]);
}

#[test]
fn malformed_files_are_rejected_with_the_reason() {
    let header = |body: &str| format!("ply\nformat ascii 1.0\n{body}end_header\n");
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let cases = [
        ("plain text\n".to_owned(), "no `ply` at the start"),
        ("ply\nformat ascii 1.0\n".to_owned(), "does not end"),
        ("ply\nend_header\n".to_owned(), "no format"),
        (header("property float x\n"), "before any element"),
        (header("element vertex 99999999999\n"), "no properties"),
        (header("element vertex many\n"), "not a count"),
        (header(&format!("element vertex 999999999999\n{xyz}")), "truncated"),
        (header("element vertex 0\nproperty float x\n"), "no property y"),
        (header(&format!("element face 0\n{xyz}")), "no element vertex"),
        (header(&format!("element vertex 1\n{xyz}")) + "1 nan 2\n", "has the position"),
        (
            header(&format!("element vertex 1\n{xyz}")) + "1 2 1e39\n",
            "single precision; remove the point, or correct it",
        ),
    ];
    for (text, reason) in cases {
        let (_dir, path) = file(text.as_bytes());
        let error = PointCloud::read_ply(&path).unwrap_err().to_string();
        assert!(error.contains(reason) && error.ends_with("points.ply"), "{error} instead of {reason}");
    }
}
