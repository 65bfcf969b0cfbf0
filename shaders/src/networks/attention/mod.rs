//! Attention: softmax(Q·Kᵀ/√d)·V (Vaswani et al. 2017), in the forms that methods use.

mod softmax;
mod top_k;
mod window;

pub use top_k::{TopKAttention, top_k_attention};
pub use window::window_attention;
