//! Readers of damaged files: every format is rejected or read as valid data, without a panic.

use std::path::Path;

use support::mangle::refused;

use crate::cloud::PointCloud;
use crate::image_file::RgbImage;
use crate::maps::{DepthMap, FlowMap};
use crate::npy_file::tests::npy_bytes;
use crate::ply::PlyFormat;
use crate::{Capture, Gaussians, Result, exr_file, image_file, npy_file};

/// Reads a file and drops its content.
type Reader = fn(&Path) -> Result<()>;

#[test]
fn readers_reject_most_damage_and_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let cloud = PointCloud::random_in([[-1.0; 3], [1.0; 3]], 7, 3);
    cloud.write_ply(&path("binary.ply"), PlyFormat::BinaryLittleEndian).unwrap();
    cloud.write_ply(&path("ascii.ply"), PlyFormat::Ascii).unwrap();
    let gaussians = Gaussians {
        positions: vec![0.5; 6],
        log_scales: vec![0.5; 6],
        rotations: vec![0.5; 8],
        opacity_logits: vec![0.5; 2],
        sh: vec![0.5; 24],
        sh_degree: 1,
    };
    gaussians.write_ply(&path("gaussians.ply")).unwrap();
    let image = RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8 * 20, y as u8 * 30, 7]));
    image_file::write_rgb(&path("image.png"), &image).unwrap();
    let depth = DepthMap { width: 9, height: 7, depth_view: (0..63).map(|at| at as f32).collect() };
    depth.write(&path("depth.exr")).unwrap();
    let flow = FlowMap { width: 9, height: 7, flow_px: (0..63).map(|at| [at as f32, f32::NAN]).collect() };
    flow.write(&path("flow.exr")).unwrap();
    let array = npy_bytes("<f4", true, "(9, 7)", &[1; 252]);
    std::fs::write(path("array.npy"), array).unwrap();
    let cases: [(&str, Reader, usize); 9] = [
        ("array.npy", |path| npy_file::read(path).map(drop), 100),
        ("binary.ply", |path| PointCloud::read_ply(path).map(drop), 100),
        ("ascii.ply", |path| PointCloud::read_ply(path).map(drop), 100),
        ("gaussians.ply", |path| Gaussians::read_ply(path).map(drop), 100),
        ("image.png", |path| image_file::read_rgb(path).map(drop), 150),
        ("image.png", |path| image_file::read_size(path).map(drop), 20),
        ("depth.exr", |path| DepthMap::read(path).map(drop), 100),
        ("flow.exr", |path| FlowMap::read(path).map(drop), 100),
        ("flow.exr", |path| exr_file::read_header(path).map(drop), 50),
    ];
    for (name, reader, at_least) in cases {
        let refused = refused(&path(name), 300, reader);
        assert!(refused >= at_least, "only {refused} of 300 damaged versions of {name} were refused");
    }
}

#[test]
fn a_damaged_capture_index_is_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let json = r#"{"name":"a","pose_source":"b","protocol":{"dataset":"d","split":"s","width":1,"height":1,
        "resize":"none","background":"white","time":"t"},"background":[0,0,0],"time_map":{"start_secs":0,"end_secs":1,
        "frame_secs":1},"views":[],"class_names":[],"has_points":false,"bounds_world":null}"#;
    let path = dir.path().join("capture.json");
    std::fs::write(&path, json).unwrap();
    let reader: Reader = |path| Capture::open(path.parent().unwrap()).map(drop);
    assert!(refused(&path, 300, reader) >= 200);
    let error = Capture::open(&dir.path().join("absent")).unwrap_err().to_string();
    assert!(error.ends_with("absent/capture.json") && error.contains("is this a folder with a capture?"), "{error}");
}
