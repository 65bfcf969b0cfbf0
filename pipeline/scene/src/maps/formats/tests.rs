//! Every format against files of other programs, and damaged files.

use std::path::PathBuf;

use tempfile::TempDir;

use super::*;
use crate::npy_file::tests::npy_bytes;

/// Writes bytes to a temporary file.
fn file(name: &str, bytes: &[u8]) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (dir, path)
}

fn hex(text: &str) -> Vec<u8> {
    (0..text.len() / 2).map(|at| u8::from_str_radix(&text[2 * at..2 * at + 2], 16).unwrap()).collect()
}

fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn middlebury_flow_marks_unknown_pixels() {
    let bytes = hex("5049454802000000020000000000c03f000000c0000000000000803e286b6e4e286b6e4e000070c000000041");
    let (_dir, path) = file("a.flo", &bytes);
    let image = read(&path, Content::Flow).unwrap();
    assert_eq!((image.width, image.height, image.channels), (2, 2, 2));
    assert_eq!(image.values[..4], [1.5, -2.0, 0.0, 0.25]);
    assert!(image.values[4].is_nan() && image.values[5].is_nan());
    assert_eq!(image.values[6..], [-3.75, 8.0]);
    for end in 0..bytes.len() {
        let (_dir, path) = file("a.flo", &bytes[..end]);
        assert!(read(&path, Content::Flow).unwrap_err().to_string().contains("a.flo"), "{end} bytes");
    }
}

#[test]
fn pfm_rows_run_from_bottom_to_top() {
    let (_dir, path) = file("a.pfm", &hex("50660a3320320a2d312e300a000080400000a0400000c0400000803f0000004000004040"));
    let image = read(&path, Content::Depth).unwrap();
    assert_eq!((image.width, image.height), (3, 2));
    assert_eq!(image.values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let big_endian = [b"PF 1 1 1.0\n".as_slice(), &1.5_f32.to_be_bytes(), &2.5_f32.to_be_bytes(), &[0; 4]].concat();
    let (_dir, path) = file("flow.pfm", &big_endian);
    assert_eq!(read(&path, Content::Flow).unwrap().values, [1.5, 2.5], "flow is the first two of three channels");
    for damaged in ["Pf 3 2 -1.0\nabcd", "Pf 3", "P6 1 1 1\nabcd", "Pf x 1 -1\nabcd", "Pf 99999999 99999999 -1\n"] {
        let (_dir, path) = file("a.pfm", damaged.as_bytes());
        assert!(read(&path, Content::Depth).unwrap_err().to_string().ends_with("a.pfm"), "{damaged}");
    }
}

#[test]
fn every_numpy_layout_decodes_to_the_same_image() {
    // Rows (1, 2, 3) and (4, 5, 6) in u; v is negative.
    let interleaved = [1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 4.0, -4.0, 5.0, -5.0, 6.0, -6.0];
    let planes = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0, -2.0, -3.0, -4.0, -5.0, -6.0];
    let columns = [1.0, 4.0, 2.0, 5.0, 3.0, 6.0, -1.0, -4.0, -2.0, -5.0, -3.0, -6.0];
    let doubles: Vec<u8> = interleaved.iter().flat_map(|value| f64::from(*value).to_be_bytes()).collect();
    let arrays = [
        npy_bytes("<f4", false, "(2, 3, 2)", &bytes_of(&interleaved)),
        npy_bytes("<f4", false, "(2, 2, 3)", &bytes_of(&planes)),
        npy_bytes("<f4", true, "(2, 3, 2)", &bytes_of(&columns)),
        npy_bytes(">f8", false, "(2, 3, 2)", &doubles),
        npy_bytes("<f4", false, "(1, 2, 3, 2)", &bytes_of(&interleaved)),
        npy_bytes("<f4", false, "(1, 1, 2, 2, 3)", &bytes_of(&planes)),
    ];
    for (at, array) in arrays.iter().enumerate() {
        // In the shape [2, 2, 3], the channels can only be the first axis.
        let (_dir, path) = file("a.npy", array);
        let image = read(&path, Content::Flow).unwrap();
        assert_eq!((image.width, image.height), (3, 2), "array {at}");
        assert_eq!(image.values, interleaved, "array {at}");
    }
}

#[test]
fn numpy_depth_of_several_types_is_decoded() {
    let golden = "934e554d5059010076007b276465736372273a20273c6634272c2027666f727472616e5f6f72646572273a2046616c73652c20277368617065273a2028322c2032292c207d202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020200a0000003f0000a0bf0000404000000000";
    let (_dir, path) = file("a.npy", &hex(golden));
    assert_eq!(read(&path, Content::Depth).unwrap().values, [0.5, -1.25, 3.0, 0.0]);
    let halves: Vec<u8> = [0x3c00_u16, 0x4100].iter().flat_map(|bits| bits.to_le_bytes()).collect();
    let (_dir, path) = file("a.npy", &npy_bytes("<f2", false, "(1, 2, 1)", &halves));
    assert_eq!(read(&path, Content::Depth).unwrap().values, [1.0, 2.5]);
    let (_dir, path) = file("a.npy", &npy_bytes("<u2", false, "(1, 1, 2)", &[1, 0, 0, 1]));
    assert_eq!(read(&path, Content::Depth).unwrap().values, [1.0, 256.0], "one channel in front");
    let (_dir, path) = file("a.npy", &npy_bytes("<i8", false, "(1, 1)", &3_i64.to_le_bytes()));
    assert_eq!(read(&path, Content::Depth).unwrap().values, [3.0]);
}

#[test]
fn damaged_and_unsupported_arrays_are_rejected() {
    let whole = npy_bytes("<f4", false, "(2, 2)", &bytes_of(&[1.0; 4]));
    let cases: [(Vec<u8>, &str); 5] = [
        (whole[..whole.len() - 1].to_vec(), "not a readable NumPy array"),
        (npy_bytes("<f4", false, "(100000, 100000)", &[]), "not a readable NumPy array"),
        (npy_bytes("<f4", false, "(0, 9)", &[]), "an image of 9×0 pixels"),
        (npy_bytes("<c8", false, "(1, 1)", &[0; 8]), "type c8"),
        (npy_bytes("<f4", false, "(2, 2, 5)", &[0; 80]), "[2, 2, 5]"),
    ];
    for (bytes, reason) in cases {
        let (_dir, path) = file("a.npy", &bytes);
        let error = read(&path, Content::Depth).unwrap_err().to_string();
        assert!(error.contains(reason) && error.ends_with("a.npy"), "{error}");
    }
    for end in 0..whole.len() {
        let (_dir, path) = file("a.npy", &whole[..end]);
        assert!(read(&path, Content::Depth).is_err(), "{end} bytes");
    }
}

#[test]
fn archives_are_searched_by_array_name() {
    let write = |names: &[&str]| {
        let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for (at, name) in names.iter().enumerate() {
            let options = zip::write::SimpleFileOptions::default();
            archive.start_file(format!("{name}.npy"), options).unwrap();
            let array = npy_bytes("<f4", false, "(1, 1)", &bytes_of(&[at as f32 + 1.0]));
            std::io::Write::write_all(&mut archive, &array).unwrap();
        }
        archive.finish().unwrap().into_inner()
    };
    let (_dir, path) = file("a.npz", &write(&["mask", "depth"]));
    assert_eq!(read(&path, Content::Depth).unwrap().values, [2.0]);
    let (_dir, path) = file("a.npz", &write(&["arr_0"]));
    assert_eq!(read(&path, Content::Depth).unwrap().values, [1.0]);
    let (_dir, path) = file("a.npz", &write(&["a", "b"]));
    assert!(read(&path, Content::Depth).unwrap_err().to_string().contains("a.npy, b.npy"));
    let (_dir, path) = file("a.npz", b"PK nothing");
    assert!(read(&path, Content::Depth).unwrap_err().to_string().contains("not a readable NumPy archive"));
}

#[test]
fn png_decodes_kitti_flow_and_depth() {
    let codes: [[u16; 3]; 4] = [[32768, 32768, 1], [32864, 32624, 1], [1, 65535, 1], [32768, 32768, 0]];
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("flow.png");
    let image = image::ImageBuffer::<image::Rgb<u16>, _>::from_vec(4, 1, codes.concat()).unwrap();
    image.save(&path).unwrap();
    let values = read(&path, Content::Flow).unwrap().values;
    assert_eq!(values[..6], [0.0, 0.0, 1.5, -2.25, -511.984_38, 511.984_38]);
    assert!(values[6].is_nan());
    let error = read(&path, Content::Depth).unwrap_err().to_string();
    assert!(error.contains("8- or 16-bit grey"), "{error}");

    let path = dir.path().join("depth.png");
    let depth = vec![0_u16, 1, 65535, 32768, 1000, 12345];
    image::ImageBuffer::<image::Luma<u16>, _>::from_vec(3, 2, depth).unwrap().save(&path).unwrap();
    assert_eq!(read(&path, Content::Depth).unwrap().values, [0.0, 1.0, 65535.0, 32768.0, 1000.0, 12345.0]);

    // Depth Anything V2 without a palette: 8 bits, three equal channels; with one, a picture.
    image::RgbImage::from_vec(2, 1, vec![7, 7, 7, 255, 255, 255]).unwrap().save(&path).unwrap();
    assert_eq!(read(&path, Content::Depth).unwrap().values, [7.0, 255.0]);
    image::RgbImage::from_vec(2, 1, vec![7, 7, 7, 255, 80, 0]).unwrap().save(&path).unwrap();
    let error = read(&path, Content::Depth).unwrap_err().to_string();
    assert!(error.contains("a colour map is only a preview"), "{error}");
}

#[test]
fn exr_channels_are_found_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("flow.exr");
    exr_file::write(&path, 2, 1, &[("u", vec![1.0, 2.0]), ("v", vec![3.0, 4.0])]).unwrap();
    assert_eq!(read(&path, Content::Flow).unwrap().values, [1.0, 3.0, 2.0, 4.0]);
    let error = read(&path, Content::Normals).unwrap_err().to_string();
    assert!(error.contains("no channel X or R"), "{error}");
    let other = dir.path().join("depth.tiff");
    std::fs::write(&other, b"II").unwrap();
    let error = read(&other, Content::Depth).unwrap_err().to_string();
    assert!(error.contains("no decoder for depth files with the extension .tiff") && error.contains("npz"), "{error}");
}

#[test]
fn damaged_files_of_every_format_never_panic() {
    let values: Vec<f32> = (0..24).map(|at| at as f32 - 3.0).collect();
    let array = npy_bytes("<f4", false, "(3, 4, 2)", &bytes_of(&values));
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    archive.start_file("flow.npy", zip::write::SimpleFileOptions::default()).unwrap();
    std::io::Write::write_all(&mut archive, &array).unwrap();
    let flo = [b"PIEH".as_slice(), &4_u32.to_le_bytes(), &3_u32.to_le_bytes(), &bytes_of(&values)].concat();
    let pfm = [b"PF\n4 2\n-1.0\n".as_slice(), &bytes_of(&values)].concat();
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    std::fs::write(path("a.npy"), &array).unwrap();
    std::fs::write(path("a.npz"), archive.finish().unwrap().into_inner()).unwrap();
    std::fs::write(path("a.flo"), flo).unwrap();
    std::fs::write(path("a.pfm"), pfm).unwrap();
    let codes = vec![40_000_u16; 36];
    image::ImageBuffer::<image::Rgb<u16>, _>::from_vec(4, 3, codes).unwrap().save(path("a.png")).unwrap();
    let channel = |at: usize| values[12 * at..12 * (at + 1)].to_vec();
    exr_file::write(&path("a.exr"), 4, 3, &[("u", channel(0)), ("v", channel(1))]).unwrap();
    for (name, at_least) in
        [("a.npy", 60), ("a.npz", 100), ("a.flo", 60), ("a.pfm", 60), ("a.png", 150), ("a.exr", 100)]
    {
        let refused = support::mangle::refused(&path(name), 300, |path| read(path, Content::Flow).map(drop));
        assert!(refused >= at_least, "only {refused} of 300 damaged versions of {name} were refused");
    }
}

#[test]
fn videos_are_read_frame_by_frame() {
    let values: Vec<f32> = (0..12).map(|value| value as f32).collect();
    for shape in ["(2, 2, 3)", "(2, 2, 3, 1)", "(1, 2, 1, 2, 3)"] {
        let (_dir, path) = file("depths.npy", &npy_bytes("<f4", false, shape, &bytes_of(&values)));
        let frames = read_video(&path, Content::Depth).unwrap();
        assert_eq!(frames.iter().map(|frame| &frame.values[..]).collect::<Vec<_>>(), [&values[..6], &values[6..]]);
    }
    let (_dir, path) = file("depths.npy", &npy_bytes("<f4", false, "(2, 6)", &bytes_of(&values)));
    let error = read_video(&path, Content::Depth).unwrap_err().to_string();
    assert!(error.contains("[T, H, W, 1] or [T, 1, H, W]"), "{error}");
}
