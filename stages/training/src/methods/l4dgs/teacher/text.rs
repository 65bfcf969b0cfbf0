//! Generated embeddings of prompts, used if none were imported.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use shaders::tape::{Real, Tensor};

/// Width of a generated embedding: random directions in 64 dimensions are nearly orthogonal.
const WIDTH: usize = 64;

/// [P, 64]: one unit vector per prompt. It depends only on the prompt's text, so equal prompts have equal embeddings
/// everywhere.
pub(crate) fn prompt_embeddings<T: Real>(prompts: &[String]) -> Tensor<T> {
    let embedding = |prompt: &String| {
        let mut random = ChaCha8Rng::seed_from_u64(hash(prompt));
        let direction: Vec<f64> = (0..WIDTH).map(|_| StandardNormal.sample(&mut random)).collect();
        let length = direction.iter().map(|value| value * value).sum::<f64>().sqrt();
        direction.into_iter().map(move |value| T::from_f64(value / length))
    };
    Tensor::from_vec([prompts.len(), WIDTH], prompts.iter().flat_map(embedding).collect())
}

/// FNV-1a hash: a seed that does not depend on the version of the standard library.
fn hash(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}
