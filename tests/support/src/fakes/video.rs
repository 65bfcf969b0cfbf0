//! Videos of fakes, encoded by ffmpeg.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use super::Fake;

/// Frames per second of the videos.
pub const FPS: u32 = 30;

/// Whether ffmpeg is installed; if it is not, reports the test as skipped.
pub fn has_ffmpeg() -> bool {
    let silent = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    let is_installed = silent.is_ok_and(|status| status.success());
    if !is_installed {
        crate::skip("ffmpeg is not installed");
    }
    is_installed
}

impl Fake {
    /// Neural 3D Video as it is published: `poses_bounds.npy` and `camNN.mp4` with 30 frames per second.
    pub fn neural_3d_videos(&self, dir: &Path) {
        self.write_poses_bounds(dir, 0..self.cameras);
        (0..self.cameras).for_each(|camera| self.write_video(camera, &dir.join(format!("cam{camera:02}.mp4"))));
    }

    /// Encodes what a camera films with the best quality of ffmpeg's own encoder for MPEG-4.
    fn write_video(&self, camera: usize, file: &Path) {
        let (size, rate) = (format!("{}x{}", self.size.0, self.size.1), FPS.to_string());
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", &rate, "-i", "-"]);
        command.args(["-c:v", "mpeg4", "-q:v", "1", "-y"]).arg(file).stdin(Stdio::piped());
        let mut encoder = command.spawn().expect("ffmpeg is installed");
        let mut input = encoder.stdin.take().expect("standard input is a pipe");
        for frame in 0..self.frames {
            input.write_all(self.image(camera, frame).as_raw()).expect("ffmpeg reads all frames");
        }
        drop(input);
        assert!(encoder.wait().expect("ffmpeg runs").success(), "ffmpeg cannot encode {}", file.display());
    }
}
