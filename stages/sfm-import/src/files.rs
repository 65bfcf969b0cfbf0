//! Access to the files and folders of a capture.

use std::io::{Cursor, ErrorKind, Read as _};
use std::path::{Component, Path};

use engine::{Failure, FailureKind};
use image::codecs::jpeg::JpegDecoder;
use image::metadata::Orientation;
use image::{ImageDecoder as _, ImageFormat, ImageReader, ImageResult};

use crate::error::{Result, bad};

/// Bytes of a JPEG file that contain its metadata, of which EXIF has at most 64 KiB.
const HEADER_BYTES: u64 = 1 << 18;
/// The folder of ScanNet++ with the images, next to the folders `nerfstudio` and `colmap` with the poses.
pub(crate) const RESIZED: &str = "resized_images";

/// The last component of a path.
pub(crate) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The sorted names of the files, folders and links in `dir`; empty if it is not a folder, or if it is [`unreadable`].
/// Pipes, sockets and devices are left out, because opening them may block.
pub(crate) fn children(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let entries = entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file() || kind.is_dir() || kind.is_symlink()));
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The failure if the folder `dir` exists, but cannot be read, e.g. without permission.
pub(crate) fn unreadable(dir: &Path) -> Option<Failure> {
    std::fs::read_dir(dir).err().and_then(|error| refused(dir, &error))
}

/// The failures of the folders in `dir` that cannot be read, except hidden ones.
pub(crate) fn unreadable_folders(dir: &Path) -> Vec<Failure> {
    let names = children(dir).into_iter().filter(|name| !name.starts_with('.'));
    let folders = names.map(|name| dir.join(name)).filter(|path| path.is_dir());
    folders.filter_map(|path| unreadable(&path)).collect()
}

fn refused(dir: &Path, error: &std::io::Error) -> Option<Failure> {
    let is_absent = matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory);
    let failure = || Failure::new(FailureKind::World, format!("cannot read the folder ({error})")).at(dir);
    (!is_absent).then(|| failure().hint("if permission is missing, give it with `chmod -R u+rX FOLDER`"))
}

/// Whether a name that a file states is that of one entry of a folder, and not a hidden one.
pub(crate) fn is_entry(stated: &str) -> bool {
    Path::new(stated).components().count() == 1 && !stated.starts_with('.')
}

/// A path that a file states relative to `folder`, and that must be below it.
pub(crate) fn inside<'a>(stated: &'a str, folder: &str) -> Result<&'a Path> {
    let path = Path::new(stated);
    let is_inside = path.components().all(|part| matches!(part, Component::Normal(_))) && !stated.is_empty();
    if is_inside { Ok(path) } else { Err(bad(format!("{stated:?} is not a path below {folder}"))) }
}

/// Reads a whole file.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| {
        let kind = match error.kind() {
            ErrorKind::NotFound => FailureKind::MissingData,
            _ => FailureKind::World,
        };
        Failure::new(kind, format!("cannot read the file ({error})")).at(path)
    })
}

/// Reads a text file as UTF-8. A byte order mark is dropped and UTF-16 is converted: tools on Windows write both.
pub(crate) fn read_text(path: &Path) -> Result<String> {
    let bytes = read_bytes(path)?;
    let units = |join: fn([u8; 2]) -> u16| bytes[2..].as_chunks().0.iter().map(move |pair| join(*pair));
    let text = match bytes.as_slice() {
        [0xff, 0xfe, ..] => char::decode_utf16(units(u16::from_le_bytes)).collect::<std::result::Result<_, _>>().ok(),
        [0xfe, 0xff, ..] => char::decode_utf16(units(u16::from_be_bytes)).collect::<std::result::Result<_, _>>().ok(),
        [0xef, 0xbb, 0xbf, text @ ..] => String::from_utf8(text.to_vec()).ok(),
        _ => String::from_utf8(bytes).ok(),
    };
    text.ok_or_else(|| bad("the file is not text").hint("save it as UTF-8").at(path))
}

/// Reads the width and height of an image from the file's header. Its content states the format, not its name.
pub(crate) fn image_size(path: &Path) -> Result<(u32, u32)> {
    if !path.is_file() {
        return Err(missing_image(path));
    }
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let size = reader.map_err(image::ImageError::from).and_then(ImageReader::into_dimensions);
    size.map_err(|error| {
        let failure = bad(format!("image cannot be read ({error})")).at(path);
        match error {
            image::ImageError::Unsupported(_) => failure.hint("convert the images to PNG, JPEG, WebP or TIFF"),
            _ => failure,
        }
    })
}

/// Whether the metadata of an image ask viewers to turn or mirror it. Only the header is read; false if it cannot be read.
pub(crate) fn is_turned_by_viewers(path: &Path) -> bool {
    let orientation = || -> ImageResult<Orientation> {
        let reader = ImageReader::open(path)?.with_guessed_format()?;
        if reader.format() != Some(ImageFormat::Jpeg) {
            return reader.into_decoder()?.orientation();
        }
        // The decoder of JPEG reads all that it is given.
        let mut head = Vec::new();
        reader.into_inner().take(HEADER_BYTES).read_to_end(&mut head)?;
        JpegDecoder::new(Cursor::new(head))?.orientation()
    };
    orientation().is_ok_and(|orientation| orientation != Orientation::NoTransforms)
}

/// The failure for an image that does not exist, or whose folder does not exist, is empty, or cannot be read.
fn missing_image(path: &Path) -> Failure {
    let folder = path.parent().unwrap_or(path);
    let missing = |message: String, hint: &str| Failure::new(FailureKind::MissingData, message).hint(hint).at(path);
    let has_resized = |above: &&Path| above.join(RESIZED).join(name(path)).is_file();
    if let Some(above) = folder.ancestors().skip(1).take(2).find(has_resized) {
        let hint = format!(
            "the folder {RESIZED} of ScanNet++ has it: name {}, which contains both this folder and the poses in nerfstudio",
            above.display()
        );
        return missing("image file is missing".into(), &hint);
    }
    let state = match std::fs::read_dir(folder) {
        Err(error) => match refused(folder, &error) {
            Some(failure) => return failure,
            None => "does not exist",
        },
        Ok(_) if children(folder).is_empty() => "is empty",
        Ok(_) => {
            let hint = "download the capture again, or remove the frame from the file that lists it";
            return missing("image file is missing".into(), hint);
        }
    };
    let message = format!("image file is missing: the folder {} {state}", name(folder));
    let hint = "put the images of the capture there; for COLMAP, the parameter images may name another folder";
    missing(message, hint)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_windows_tools_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.json");
        let read = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read_text(&path)
        };
        assert_eq!(read("{é}".as_bytes()).unwrap(), "{é}");
        assert_eq!(read("\u{feff}{é}".as_bytes()).unwrap(), "{é}");
        let units: Vec<u16> = "\u{feff}{é}".encode_utf16().collect();
        assert_eq!(read(&units.iter().flat_map(|unit| unit.to_le_bytes()).collect::<Vec<_>>()).unwrap(), "{é}");
        assert_eq!(read(&units.iter().flat_map(|unit| unit.to_be_bytes()).collect::<Vec<_>>()).unwrap(), "{é}");
        assert!(read(b"\xff").unwrap_err().to_string().contains("not text"));
        assert!(read(&[0xff, 0xfe, 0x00, 0xd8]).is_err());
    }

    #[test]
    fn folders_without_permission_are_not_empty() {
        let (dir, denied) = (Path::new("a/masks"), std::io::Error::from(ErrorKind::PermissionDenied));
        let text = refused(dir, &denied).unwrap().to_string();
        assert!(text.contains("permission denied") && text.contains("chmod") && text.contains("a/masks"), "{text}");
        assert!(unreadable(dir).is_none(), "it does not exist");
        assert!(
            unreadable(&Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml/masks")).is_none(),
            "it is below a file"
        );
    }

    #[test]
    fn the_content_of_an_image_states_its_format() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        image::RgbImage::new(5, 3).save_with_format(&path, image::ImageFormat::Jpeg).unwrap();
        assert_eq!(image_size(&path).unwrap(), (5, 3));
        std::fs::write(&path, b"BM\x9a\0\0\0\0\0\0\0").unwrap();
        assert!(image_size(&path).unwrap_err().to_string().contains("convert the images"));
        std::fs::write(&path, "").unwrap();
        assert!(image_size(&path).unwrap_err().to_string().contains("a.png"));
    }

    #[test]
    fn the_orientation_of_an_image_is_read_from_its_header() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.jpg");
        image::RgbImage::new(64, 64).save(&path).unwrap();
        assert!(!is_turned_by_viewers(&path) && !is_turned_by_viewers(dir.path()));
        let jpeg = std::fs::read(&path).unwrap();
        for (orientation, is_turned) in [(1, false), (3, true), (6, true)] {
            let turned = crate::tests::support::with_orientation(&jpeg, orientation);
            std::fs::write(&path, &turned).unwrap();
            assert_eq!(is_turned_by_viewers(&path), is_turned, "{orientation}");
            // The pixels are not needed.
            std::fs::write(&path, &turned[..turned.len() - 20]).unwrap();
            assert_eq!(is_turned_by_viewers(&path), is_turned, "{orientation}");
        }
        let png = dir.path().join("a.png");
        image::RgbImage::new(64, 64).save(&png).unwrap();
        assert!(!is_turned_by_viewers(&png));
    }
}
