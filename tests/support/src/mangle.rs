//! Damaged copies of files, for the tests of every reader.

use std::fmt::Debug;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A damaged copy of `bytes`: truncated, with flipped bits, or with a short run overwritten. The seed selects the kind
/// and the places.
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

/// Calls `reader` on `count` damaged versions of the file at `path` and returns how many it refused. The file is
/// restored at the end.
///
/// # Panics
///
/// If the reader refuses the undamaged file, or the file cannot be written.
pub fn refused<E: Debug>(path: &Path, count: u64, mut reader: impl FnMut(&Path) -> Result<(), E>) -> usize {
    let original = std::fs::read(path).expect("the file can be read");
    reader(path).expect("the undamaged file is accepted");
    let mut is_refused = |seed: u64| {
        // A new file each time: some file systems flush to disk when an existing file is truncated.
        std::fs::remove_file(path).expect("the file can be removed");
        std::fs::write(path, mangled(&original, seed)).expect("the file can be written");
        reader(path).is_err()
    };
    let refused = (0..count).filter(|seed| is_refused(*seed)).count();
    std::fs::write(path, original).expect("the file can be written");
    refused
}
