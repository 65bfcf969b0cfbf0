//! External programs: whether they are installed, and their versions.

use std::ffi::OsStr;
use std::process::{Command, Stdio};

use engine::Failure;

use crate::error::{Result, world};
use crate::process::kind_of_end;

/// A program, and how to install it.
pub(crate) struct Tool {
    /// Name in `PATH`.
    pub(crate) name: &'static str,
    /// The option that prints the version in the first line.
    version: &'static str,
    /// What to do without it.
    install: &'static str,
}

/// Decodes videos.
pub(crate) const FFMPEG: Tool = Tool {
    name: "ffmpeg",
    version: "-version",
    install: "install it, e.g. `apt install ffmpeg` (macOS: `brew install ffmpeg`), or name a folder of extracted images",
};

/// Describes videos; part of FFmpeg.
pub(crate) const FFPROBE: Tool = Tool { name: "ffprobe", version: "-version", install: FFMPEG.install };

/// Estimates poses.
pub(crate) const COLMAP: Tool = Tool {
    name: "colmap",
    version: "-h",
    install: "install it, e.g. `apt install colmap` (macOS: `brew install colmap`), and run the same command again: the \
              frames are kept. Poses of VGGT, MASt3R or MegaSaM can be imported instead (see the README of sfm-import)",
};

impl Tool {
    /// The first line of the program's version text, or the reason why it cannot be used.
    pub(crate) fn version(&self) -> Result<String> {
        let output = self.command().arg(self.version).stdin(Stdio::null()).output();
        let output = output.map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => world(format!("{} is not installed", self.name)).hint(self.install),
            _ => world(format!("{} cannot be started: {error}", self.name)),
        })?;
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        Ok(text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or(self.name).to_owned())
    }

    /// Everything that the program prints with these arguments.
    pub(crate) fn output(&self, arguments: &[impl AsRef<OsStr>]) -> Result<String> {
        self.version()?;
        let output = self.command().args(arguments).stdin(Stdio::null()).output();
        let output = output.map_err(|error| world(format!("{}: {error}", self.name)))?;
        if !output.status.success() {
            let reason = String::from_utf8_lossy(&output.stderr).trim().to_owned();
            let kind = kind_of_end(output.status, &reason);
            return Err(Failure::new(kind, format!("{} failed: {reason}", self.name)));
        }
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// A command without arguments. It disables the display that Qt, which COLMAP links, would otherwise require.
    pub(crate) fn command(&self) -> Command {
        let mut command = Command::new(self.name);
        command.env("QT_QPA_PLATFORM", "offscreen");
        command
    }
}

#[cfg(test)]
mod tests {
    use engine::FailureKind;

    use super::*;

    #[test]
    fn a_missing_program_is_a_failure_of_the_machine() {
        let tool = Tool { name: "no-such-program", version: "-h", install: "install it" };
        let failure = tool.version().unwrap_err();
        assert_eq!((failure.kind, failure.message.as_str()), (FailureKind::World, "no-such-program is not installed"));
    }
}
