//! Frames of a video, decoded by `ffmpeg` and taken from its output one at a time.

use std::io::{BufRead, BufReader, Error, ErrorKind, Read as _};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::OnceLock;

use engine::{Failure, FailureKind};
use scene::image_file::RgbImage;

/// The decoder.
const PROGRAM: &str = "ffmpeg";
/// The first version that knows `-fps_mode`.
const FPS_MODE: [u32; 2] = [5, 1];
/// Threads of one decoder; the videos of a rig are decoded in parallel.
const THREADS: &str = "2";
/// Messages of ffmpeg about frames in which it concealed errors. With several threads, `-xerror` misses these.
const DAMAGE: [&str; 2] = ["error while decoding", "corrupt decoded frame"];
/// The conversion to RGB is the same on every machine.
const CONVERSION: &str = "accurate_rnd+full_chroma_int+bitexact";

/// The first line of `ffmpeg -version`.
///
/// # Errors
///
/// The program is not installed; the hint says how to install it.
pub fn version() -> Result<&'static str, Failure> {
    static VERSION: OnceLock<Option<String>> = OnceLock::new();
    VERSION.get_or_init(|| version_of(PROGRAM)).as_deref().ok_or_else(missing)
}

/// The error for a machine without ffmpeg.
fn missing() -> Failure {
    let failure = Failure::new(FailureKind::World, "decoding videos needs ffmpeg, which is not installed");
    failure
        .hint("install it, e.g. `apt install ffmpeg` (macOS: `brew install ffmpeg`), or extract the frames elsewhere")
}

fn version_of(program: &str) -> Option<String> {
    let output = Command::new(program).arg("-version").stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    output.status.success().then(|| text.lines().next().unwrap_or_default().to_owned())
}

/// Every stored frame once: the option's name depends on the version.
fn passthrough(version: &str) -> [&'static str; 2] {
    let number = version.split_whitespace().nth(2).unwrap_or_default();
    let mut parts = number.split(['.', '-']).map_while(|part| part.parse::<u32>().ok());
    let is_old = parts.next().is_some_and(|major| [major, parts.next().unwrap_or(0)] < FPS_MODE);
    [if is_old { "-vsync" } else { "-fps_mode" }, "passthrough"]
}

/// Calls `on_frame` with the number, from 0, and the image of frames `first` to `last` of a video, or of all frames. One
/// frame is held at a time.
///
/// # Errors
///
/// ffmpeg is not installed or fails, the video ends before `last`, or `on_frame` fails.
pub fn decode(
    path: &Path,
    frames: Option<[u32; 2]>,
    mut on_frame: impl FnMut(u32, RgbImage) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut decoder = Decoder::start(path, frames)?;
    let mut give_all = || {
        for number in frames.map_or(0, |[first, _]| first).. {
            match decoder.next() {
                Ok(Some(image)) => on_frame(number, image)?,
                Ok(None) if frames.is_none_or(|[_, last]| number > last) => break,
                Ok(None) => return Err(damaged(number, "the video ends before it").into()),
                Err(error) => return Err(damaged(number, &error.to_string()).into()),
            }
        }
        Ok(())
    };
    let given: anyhow::Result<()> = give_all();
    let (is_success, messages) = decoder.end();
    let said = messages.lines().next().map(|line| format!(": {line}")).unwrap_or_default();
    match given {
        Ok(()) if is_success && !DAMAGE.iter().any(|sign| messages.contains(sign)) => Ok(()),
        Ok(()) if is_success => {
            let failure = Failure::new(FailureKind::BadInput, format!("a part of the video is damaged{said}"));
            Err(failure.hint("copy or download it again; encoded again, it is read with the damage").at(path).into())
        }
        Ok(()) => Err(Failure::new(FailureKind::BadInput, format!("ffmpeg failed{said}")).at(path).into()),
        Err(error) => match error.downcast::<Failure>() {
            Ok(failure) if failure.path.is_none() => {
                Err(Failure { message: failure.message.clone() + &said, ..failure }.at(path).into())
            }
            Ok(failure) => Err(failure.into()),
            Err(error) => Err(error),
        },
    }
}

/// The error for a frame that the decoder does not deliver.
fn damaged(number: u32, reason: &str) -> Failure {
    let message = format!("frame {number} cannot be decoded ({reason})");
    Failure::new(FailureKind::BadInput, message).hint("the file may be damaged: copy or download it again")
}

/// A running ffmpeg that writes PPM images.
struct Decoder {
    child: Child,
    images: BufReader<ChildStdout>,
    messages: std::thread::JoinHandle<String>,
}

impl Decoder {
    fn start(path: &Path, frames: Option<[u32; 2]>) -> Result<Self, Failure> {
        let not_run = |reason: &str| Failure::new(FailureKind::World, format!("ffmpeg cannot be started ({reason})"));
        let mut command = Command::new(PROGRAM);
        command.args(["-v", "error", "-nostdin", "-noautorotate", "-xerror", "-threads", THREADS, "-i"]).arg(path);
        if let Some([first, last]) = frames {
            let (select, count) = (format!("select=between(n\\,{first}\\,{last})"), (last - first + 1).to_string());
            command.args(["-vf", &select, "-frames:v", &count]);
        }
        command.args(passthrough(version()?)).args(["-sws_flags", CONVERSION]);
        command.args(["-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| not_run(&error.to_string()))?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let images = BufReader::new(stdout.ok_or_else(|| not_run("it has no output"))?);
        // Messages are read in parallel with the frames: a full pipe would stop the decoder.
        let messages = std::thread::spawn(move || {
            let mut text = String::new();
            let _ = stderr.map(|mut pipe| pipe.read_to_string(&mut text)); // the text is only advice
            text
        });
        Ok(Self { child, images, messages })
    }

    fn next(&mut self) -> std::io::Result<Option<RgbImage>> {
        next_image(&mut self.images)
    }

    /// Whether the decoder succeeded, and its messages. A decoder that still writes is terminated.
    fn end(mut self) -> (bool, String) {
        drop(self.images);
        let status = self.child.wait();
        (status.is_ok_and(|status| status.success()), self.messages.join().unwrap_or_default())
    }
}

/// The next of concatenated PPM images of 8 bits; none at their end.
fn next_image(images: &mut impl BufRead) -> std::io::Result<Option<RgbImage>> {
    if images.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let mut header = String::new();
    for _ in 0..3 {
        images.read_line(&mut header)?;
    }
    let invalid = || Error::from(ErrorKind::InvalidData);
    let [magic, width, height, white] = header.split_whitespace().collect::<Vec<_>>()[..] else {
        return Err(invalid());
    };
    let size: Option<(u32, u32)> = width.parse().ok().zip(height.parse().ok());
    let (width, height) = size.filter(|_| magic == "P6" && white == "255").ok_or_else(invalid)?;
    let mut pixels = vec![0; width as usize * height as usize * 3];
    images.read_exact(&mut pixels)?;
    Ok(RgbImage::from_raw(width, height, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_versions_know_another_option() {
        let old = ["ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright", "ffmpeg version 5.0 Copyright"];
        assert!(old.iter().all(|version| passthrough(version)[0] == "-vsync"));
        let new =
            ["ffmpeg version 5.1.6-0+deb12u1 Copyright", "ffmpeg version 9.0.2-static x", "ffmpeg version N-1 x", ""];
        assert!(new.iter().all(|version| passthrough(version)[0] == "-fps_mode"));
    }

    #[test]
    fn a_missing_decoder_names_what_to_install() {
        assert_eq!(version_of("no-such-decoder"), None);
        assert!(missing().to_string().contains("apt install ffmpeg"));
    }

    #[test]
    fn concatenated_images_are_read_one_by_one() {
        let two = [b"P6\n2 1\n255\n".as_slice(), &[1, 2, 3, 4, 5, 6], b"P6\n1 1\n255\n", &[10, 32, 9]].concat();
        let mut images = two.as_slice();
        let mut next = || next_image(&mut images).unwrap();
        assert_eq!(next().unwrap().dimensions(), (2, 1));
        assert_eq!(next().unwrap().into_raw(), [10, 32, 9]);
        assert!(next().is_none());
        let fails_when_cut = |end: usize| {
            let mut images = &two[..end];
            (0..2).any(|_| next_image(&mut images).is_err())
        };
        assert!((1..two.len()).filter(|end| *end != 17).all(fails_when_cut));
    }
}
