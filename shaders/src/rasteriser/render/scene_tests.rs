//! Helpers of the tests of projection, binning, blending and rendering: seeded scenes.

pub(crate) use crate::check::seeded::{camera, images, splats, tensors, vars};
use crate::rasteriser::splats::SplatTensors;
use crate::tape::{Real, Tensor};

/// The inverse of [`tensors`].
pub(crate) fn from_tensors<T: Real>(tensors: &[Tensor<T>]) -> SplatTensors<T> {
    let [positions, log_scales, rotations, opacity_logits, sh] = tensors else { panic!("five tensors") };
    SplatTensors {
        positions: positions.clone(),
        log_scales: log_scales.clone(),
        rotations: rotations.clone(),
        opacity_logits: opacity_logits.clone(),
        sh: sh.clone(),
    }
}

/// The splats converted to another scalar type.
pub(crate) fn cast<T: Real>(splats: &SplatTensors<f64>) -> SplatTensors<T> {
    from_tensors(&tensors(splats).iter().map(Tensor::cast).collect::<Vec<_>>())
}

/// The splats at the given indices.
pub(crate) fn select<T: Real>(splats: &SplatTensors<T>, indices: &[usize]) -> SplatTensors<T> {
    let rows = |tensor: &Tensor<T>| {
        let mut shape = tensor.shape().to_vec();
        shape[0] = indices.len();
        Tensor::from_vec(shape, indices.iter().flat_map(|&index| tensor.row(index).to_vec()).collect())
    };
    from_tensors(&tensors(splats).iter().map(rows).collect::<Vec<_>>())
}

/// `f` on a pool of `threads` threads.
pub(crate) fn with_threads<R: Send>(threads: usize, f: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool").install(f)
}
