//! Data parallelism over chunks: what each chunk computes and the order in which partial sums are added depend on the data alone,
//! never on the number of threads. Chunks therefore have a fixed size, except where no sum depends on it.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::Mutex;

use rayon::prelude::*;

use super::Real;

/// Elements per chunk of a pointwise loop: 32 KiB of f32, which stays in the first-level cache and hides rayon's overhead.
pub(crate) const CHUNK: usize = 8192;
/// Independent sums of a chunk: additions in flight at once.
const LANES: usize = 8;

/// Calls `body(index)` for each of `0..count`, in parallel where there are several.
///
/// The body is not a type parameter: rayon's code would be compiled again for each of hundreds of loops.
fn for_each_index(count: usize, body: &(dyn Fn(usize) + Sync)) {
    match count {
        1 => body(0),
        _ => (0..count).into_par_iter().for_each(body),
    }
}

/// Runs `body(index, part)` for every part, in parallel where there are several, and returns the results in order.
pub(crate) fn map_parts<P: Send, R: Send>(
    parts: impl IntoIterator<Item = P>,
    body: impl Fn(usize, P) -> R + Sync,
) -> Vec<R> {
    let slots: Vec<_> = parts.into_iter().map(|part| Mutex::new((Some(part), None))).collect();
    for_each_index(slots.len(), &|index| {
        let mut slot = slots[index].lock().expect("each index once");
        let part = slot.0.take().expect("each index once");
        slot.1 = Some(body(index, part));
    });
    let result = |slot: Mutex<(_, Option<R>)>| slot.into_inner().ok()?.1;
    slots.into_iter().map(|slot| result(slot).expect("every index")).collect()
}

/// Calls `body(first element index, chunk)` for every chunk of `out`, in parallel where there are several.
pub(crate) fn for_each_chunk<T: Real>(out: &mut [T], chunk_len: usize, body: impl Fn(usize, &mut [T]) + Sync) {
    if out.len() > chunk_len {
        map_parts(out.chunks_mut(chunk_len), |chunk, out| body(chunk * chunk_len, out));
    } else if !out.is_empty() {
        body(0, out);
    }
}

/// Returns `len` elements, filled chunk by chunk by `body(first element index, chunk)`, in parallel where there are
/// several chunks. The elements of a chunk are 0 when its body begins.
///
/// A thread zeroes a chunk just before its body, so that the zeros never leave the cache. One pass of zeros over the whole
/// array (`vec![0; len]`) would run on one thread and write all of it to memory.
pub(crate) fn chunked<T: Real>(len: usize, chunk_len: usize, body: impl Fn(usize, &mut [T]) + Sync) -> Vec<T> {
    chunked_with(len, chunk_len, body).0
}

/// Like [`chunked`]; also returns the result of `body` for each chunk, in order.
pub(crate) fn chunked_with<T: Real, R: Send>(
    len: usize,
    chunk_len: usize,
    body: impl Fn(usize, &mut [T]) -> R + Sync,
) -> (Vec<T>, Vec<R>) {
    let ([elements], results) = chunked_arrays([len], [chunk_len], |chunk, [out]| body(chunk * chunk_len, out));
    (elements, results)
}

/// Like [`chunked_with`] for several arrays, each of which has equally many chunks or is empty: `body(index, chunks)` fills the chunk
/// with this index of every array.
pub(crate) fn chunked_arrays<T: Real, R: Send, const ARRAYS: usize>(
    lens: [usize; ARRAYS],
    chunk_lens: [usize; ARRAYS],
    body: impl Fn(usize, [&mut [T]; ARRAYS]) -> R + Sync,
) -> ([Vec<T>; ARRAYS], Vec<R>) {
    let counts = || lens.iter().zip(chunk_lens).map(|(len, chunk_len)| len.div_ceil(chunk_len.max(1)));
    let count = counts().max().unwrap_or_default();
    assert!(counts().all(|own| own == count || own == 0), "the numbers of chunks differ");
    let mut arrays = lens.map(Vec::with_capacity);
    let spare = arrays.iter_mut().zip(lens).map(|(array, len)| &mut array.spare_capacity_mut()[..len]);
    let mut rests: Vec<_> = spare.collect();
    let parts = (0..count).map(|_| {
        std::array::from_fn(|array| {
            let chunk_len = chunk_lens[array].min(rests[array].len());
            rests[array].split_off_mut(..chunk_len).expect("not longer than the rest")
        })
    });
    let results = map_parts(parts, |chunk, parts: [_; ARRAYS]| body(chunk, parts.map(zeroed)));
    for (array, len) in arrays.iter_mut().zip(lens) {
        // SAFETY: the chunks cover the first `len` elements, and `zeroed` has written each of them.
        unsafe { array.set_len(len) };
    }
    (arrays, results)
}

/// The elements, after zeros have been written to all of them.
fn zeroed<T: Real>(elements: &mut [MaybeUninit<T>]) -> &mut [T] {
    elements.iter_mut().for_each(|element| {
        element.write(T::ZERO);
    });
    // SAFETY: every element has just been written.
    unsafe { elements.assume_init_mut() }
}

/// Runs `body(range)` for consecutive ranges of `chunk_len` that cover `0..len`, and returns the results in order.
pub(crate) fn map_chunks<R: Send>(
    len: usize,
    chunk_len: usize,
    body: impl Fn(Range<usize>) -> R + Sync + Send,
) -> Vec<R> {
    let range = |chunk: usize| chunk * chunk_len..((chunk + 1) * chunk_len).min(len);
    match len.div_ceil(chunk_len) {
        1 => vec![body(range(0))],
        chunks => map_parts(0..chunks, |chunk, _| body(range(chunk))),
    }
}

/// Σ `term(i)` over `0..len`: f64 partial sums per fixed chunk, added in order. The terms of a chunk are added in
/// several sums, because each addition to a single one would wait for the one before.
pub fn sum(len: usize, term: impl Fn(usize) -> f64 + Sync + Send) -> f64 {
    let of_chunk = |range: Range<usize>| {
        let mut lanes = [0.0; LANES];
        let whole = range.start + range.len() / LANES * LANES;
        for first in (range.start..whole).step_by(LANES) {
            lanes.iter_mut().enumerate().for_each(|(lane, sum)| *sum += term(first + lane));
        }
        lanes.iter().sum::<f64>() + (whole..range.end).map(&term).sum::<f64>()
    };
    map_chunks(len, CHUNK, of_chunk).into_iter().sum()
}
