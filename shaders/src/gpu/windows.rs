//! Launches over rows in windows, as adapters let a kernel see less of an array than they have memory for.
//!
//! For kernels whose rows, of all their arrays, are those with one number: several launches then see the same rows of every
//! array, counted from zero, and do together what one launch would have done.

#[cfg(test)]
pub(crate) mod tests;

use super::binding::ALIGNMENT;
use super::{Binding, Gpu};

/// Bytes of the largest window: places within it are 32-bit, also where those of a few arrays are counted together.
const LARGEST_BYTES: u64 = 1 << 32;

/// Calls `launch` for windows of `rows` rows, with the number of rows and what it binds: a part of every array, which are
/// [rows, …], and all of what is bound in part already ([`Binding::all`]). It is called once, with what is given, where all
/// arrays fit.
pub fn in_windows<'a>(gpu: Gpu, rows: usize, arrays: &[Binding<'a>], launch: impl FnMut(usize, &[Binding<'a>])) {
    in_windows_with(gpu, rows, 0, arrays, launch);
}

/// The same for launches that make arrays of their own, with up to `row_len` elements per row.
pub fn in_windows_with<'a>(
    gpu: Gpu,
    rows: usize,
    row_len: usize,
    arrays: &[Binding<'a>],
    mut launch: impl FnMut(usize, &[Binding<'a>]),
) {
    let longest = arrays.iter().filter_map(|array| array.row_len(rows)).fold(row_len, usize::max);
    let fitting = fitting_rows(gpu, longest);
    if rows <= fitting {
        return launch(rows, arrays);
    }
    #[cfg(test)]
    let is_faulty = tests::is_faulty();
    // The next window begins where a part of an array can begin.
    let step = fitting / ALIGNMENT * ALIGNMENT;
    for first in (0..rows).step_by(step) {
        let count = step.min(rows - first);
        let parts: Vec<Binding> = arrays.iter().map(|array| array.rows(rows, first, count)).collect();
        #[cfg(test)]
        let parts = if is_faulty { tests::misplaced(arrays, rows, first, count) } else { parts };
        launch(count, &parts);
    }
}

/// Rows of so many elements that a kernel sees; so few at least that windows can begin behind each other: where not even
/// they fit, the launch fails.
fn fitting_rows(gpu: Gpu, row_len: usize) -> usize {
    let bytes = gpu.visible_bytes().min(LARGEST_BYTES);
    #[cfg(test)]
    let bytes = bytes.min(tests::visible_bytes());
    let elements = usize::try_from(bytes / 4).expect("at most 2³⁰");
    (elements / row_len.max(1)).max(ALIGNMENT)
}

/// Elements of which a launch sees parts, wherever they begin in their arrays.
pub fn fitting_elements(gpu: Gpu) -> usize {
    // Parts begin at most so many elements before.
    (fitting_rows(gpu, 1) - ALIGNMENT).max(ALIGNMENT)
}
