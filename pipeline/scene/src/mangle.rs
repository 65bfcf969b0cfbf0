//! Damaged copies of files, for the tests of everything that reads files.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The bytes cut off, with bits flipped, or with a run overwritten, at places drawn by the seed.
pub fn mangled(bytes: &[u8], seed: u64) -> Vec<u8> {
    let random = &mut ChaCha8Rng::seed_from_u64(seed);
    let mut bytes = bytes.to_vec();
    if bytes.is_empty() {
        return vec![random.random()];
    }
    match random.random_range(0..3) {
        0 => bytes.truncate(random.random_range(0..bytes.len())),
        1 => {
            for _ in 0..random.random_range(1..8) {
                let at = random.random_range(0..bytes.len());
                bytes[at] ^= 1 << random.random_range(0..8);
            }
        }
        _ => {
            let at = random.random_range(0..bytes.len());
            let end = (at + random.random_range(1..16)).min(bytes.len());
            bytes[at..end].fill(random.random());
        }
    }
    bytes
}

/// Reads `count` damaged versions of the file, which the reader accepts as it is; how many were refused.
///
/// # Panics
///
/// If the reader refuses the whole file, or the file cannot be written.
pub fn refused<E: std::fmt::Debug>(path: &Path, count: u64, mut reader: impl FnMut(&Path) -> Result<(), E>) -> usize {
    let original = std::fs::read(path).expect("the file is there");
    reader(path).expect("the whole file is accepted");
    let mut is_refused = |seed: u64| {
        // A new file: cutting an existing one short makes some file systems wait for the disk.
        std::fs::remove_file(path).expect("the file can be replaced");
        std::fs::write(path, mangled(&original, seed)).expect("the file can be written");
        reader(path).is_err()
    };
    let refused = (0..count).filter(|seed| is_refused(*seed)).count();
    std::fs::write(path, original).expect("the file can be written");
    refused
}
