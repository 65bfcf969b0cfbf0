//! Frames of a video, decoded by ffmpeg and taken from its output one at a time.

use std::io::Read as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;

use engine::{Failure, FailureKind};
use image::RgbImage;

use crate::error::{Result, bad};

/// The decoder.
const PROGRAM: &str = "ffmpeg";
/// The first version that knows `-fps_mode`.
const FPS_MODE: [u32; 2] = [5, 1];
/// Threads of one decoder; the videos of a rig are decoded in parallel.
const THREADS: &str = "2";
/// The conversion to RGB is the same on every machine.
const CONVERSION: &str = "accurate_rnd+full_chroma_int+bitexact";

/// The first line of `ffmpeg -version`; an error with the next step if it is not installed.
pub(crate) fn version() -> Result<&'static str> {
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

/// Calls `on_frame` with the number and the image of frames `first` to `last` of a video with frames of this size, numbered
/// from 0. One frame is held at a time.
pub(crate) fn decode(
    path: &Path,
    size: (u32, u32),
    [first, last]: [u32; 2],
    mut on_frame: impl FnMut(u32, RgbImage) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut decoder = Decoder::start(path, [first, last])?;
    let given = (first..=last).try_for_each(|number| {
        let image = decoder.next(size).map_err(|error| {
            let message = format!("frame {number} cannot be decoded ({error})");
            bad(message).hint("the file may be damaged: download it again")
        })?;
        on_frame(number, image)
    });
    let (is_success, said) = decoder.end();
    let said = said.lines().next().map(|line| format!(": {line}")).unwrap_or_default();
    match given {
        Ok(()) if is_success => Ok(()),
        Ok(()) => Err(bad(format!("ffmpeg failed{said}")).at(path).into()),
        Err(error) => match error.downcast::<Failure>() {
            Ok(failure) if failure.path.is_none() => {
                Err(Failure { message: failure.message.clone() + &said, ..failure }.at(path).into())
            }
            Ok(failure) => Err(failure.into()),
            Err(error) => Err(error),
        },
    }
}

/// A running ffmpeg that writes raw frames.
struct Decoder {
    child: Child,
    messages: std::thread::JoinHandle<String>,
}

impl Decoder {
    fn start(path: &Path, [first, last]: [u32; 2]) -> Result<Self> {
        let not_run = |error| Failure::new(FailureKind::World, format!("ffmpeg cannot be started ({error})"));
        let select = format!("select=between(n\\,{first}\\,{last})");
        let count = (last - first + 1).to_string();
        let mut command = Command::new(PROGRAM);
        command.args(["-v", "error", "-nostdin", "-noautorotate", "-xerror", "-threads", THREADS, "-i"]).arg(path);
        command.args(["-vf", &select]).args(passthrough(version()?)).args(["-frames:v", &count]);
        command.args(["-sws_flags", CONVERSION, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(not_run)?;
        let stderr = child.stderr.take();
        // Messages are read in parallel with the frames: a full pipe would stop the decoder.
        let messages = std::thread::spawn(move || {
            let mut text = String::new();
            let _ = stderr.map(|mut pipe| pipe.read_to_string(&mut text)); // the text is only advice
            text
        });
        Ok(Self { child, messages })
    }

    /// The next frame.
    fn next(&mut self, (width, height): (u32, u32)) -> std::io::Result<RgbImage> {
        let mut pixels = vec![0; width as usize * height as usize * 3];
        if let Some(frames) = &mut self.child.stdout {
            frames.read_exact(&mut pixels)?;
        }
        RgbImage::from_raw(width, height, pixels).ok_or_else(|| std::io::ErrorKind::InvalidData.into())
    }

    /// Whether the decoder succeeded, and its messages. A decoder that still writes is terminated.
    fn end(mut self) -> (bool, String) {
        drop(self.child.stdout.take());
        let status = self.child.wait();
        (status.is_ok_and(|status| status.success()), self.messages.join().unwrap_or_default())
    }
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
}
