//! Files and their hashes.

use std::io::Read as _;
use std::path::Path;

use engine::{Failure, FailureKind};
use sha2::{Digest as _, Sha256};

/// Bytes that are read at once.
const BLOCK: usize = 1 << 20;

/// A failure of the machine or the network.
pub(crate) fn world(message: impl Into<String>) -> Failure {
    Failure::new(FailureKind::World, message)
}

/// A failure to access a file.
pub(crate) fn io(error: std::io::Error) -> Failure {
    world(error.to_string())
}

/// Size and SHA-256 of a file.
pub(crate) fn digest(path: &Path) -> Result<(u64, String), Failure> {
    let mut file = fs_err::File::open(path).map_err(io)?;
    let (mut hash, mut block, mut size) = (Sha256::new(), vec![0; BLOCK], 0);
    loop {
        let count = file.read(&mut block).map_err(io)?;
        if count == 0 {
            return Ok((size, hex(&hash.finalize())));
        }
        hash.update(&block[..count]);
        size += count as u64;
    }
}

/// Bytes as hex digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
