//! What renders said about anchors and their Gaussians since they were last judged.

use serde::{Deserialize, Serialize};

use crate::screen::ScreenGradients;

/// Sums per anchor and per place of a Gaussian (slot): K slots per anchor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    per_anchor: usize,
    /// [N·K] norms of the gradients of projected means, normalised device coordinates.
    gradient_sum: Vec<f32>,
    /// [N·K] steps that drew the Gaussian where a render sees it.
    seen_count: Vec<u32>,
    /// [N] opacities of all Gaussians of the anchor.
    opacity_sum: Vec<f32>,
    /// [N] renders that looked at the anchor.
    look_count: Vec<u32>,
}

impl Statistics {
    /// Whether nothing was seen yet.
    pub fn is_empty(&self) -> bool {
        self.look_count.is_empty()
    }

    /// Adds one step's renders.
    pub fn add(&mut self, screen: &ScreenGradients, per_anchor: usize) {
        self.per_anchor = per_anchor;
        self.resize(screen.visible.len() / per_anchor);
        for slot in (0..screen.visible.len()).filter(|&slot| screen.visible[slot]) {
            let [x, y] = screen.gradient_ndc[slot];
            self.gradient_sum[slot] += x.hypot(y);
            self.seen_count[slot] += 1;
        }
        for anchor in 0..self.look_count.len() {
            let slots = anchor * per_anchor..(anchor + 1) * per_anchor;
            let looks = screen.looks[slots.start];
            if looks > 0 {
                self.look_count[anchor] += looks;
                self.opacity_sum[anchor] += screen.opacity[slots].iter().sum::<f32>();
            }
        }
    }

    /// [N·K] the mean gradient of every Gaussian that was seen in more than `needed` steps.
    pub fn mean_gradients(&self, needed: f64) -> Vec<Option<f32>> {
        let mean = |(&sum, &count): (&f32, &u32)| (f64::from(count) > needed).then(|| sum / count as f32);
        self.gradient_sum.iter().zip(&self.seen_count).map(mean).collect()
    }

    /// [N] the mean opacity, summed over its Gaussians, of every anchor that more than `needed` renders looked at.
    pub fn mean_opacities(&self, needed: f64) -> Vec<Option<f32>> {
        let mean = |(&sum, &count): (&f32, &u32)| (f64::from(count) > needed).then(|| sum / count as f32);
        self.opacity_sum.iter().zip(&self.look_count).map(mean).collect()
    }

    /// Starts anew for the Gaussians that [`Statistics::mean_gradients`] judged.
    pub fn forget_seen(&mut self, needed: f64) {
        forget(&mut self.gradient_sum, &mut self.seen_count, needed);
    }

    /// Starts anew for the anchors that [`Statistics::mean_opacities`] judged.
    pub fn forget_looks(&mut self, needed: f64) {
        forget(&mut self.opacity_sum, &mut self.look_count, needed);
    }

    /// Room for so many anchors; new ones were never seen.
    pub fn resize(&mut self, anchors: usize) {
        self.gradient_sum.resize(anchors * self.per_anchor, 0.0);
        self.seen_count.resize(anchors * self.per_anchor, 0);
        self.opacity_sum.resize(anchors, 0.0);
        self.look_count.resize(anchors, 0);
    }

    /// Drops the anchors whose flag is false.
    pub fn keep(&mut self, keep: &[bool]) {
        retain(&mut self.gradient_sum, keep, self.per_anchor);
        retain(&mut self.seen_count, keep, self.per_anchor);
        retain(&mut self.opacity_sum, keep, 1);
        retain(&mut self.look_count, keep, 1);
    }
}

fn forget(sums: &mut [f32], counts: &mut [u32], needed: f64) {
    for (sum, count) in sums.iter_mut().zip(counts) {
        if f64::from(*count) > needed {
            (*sum, *count) = (0.0, 0);
        }
    }
}

/// Keeps the groups of `group` values whose flag is set.
fn retain<V: Copy>(values: &mut Vec<V>, keep: &[bool], group: usize) {
    *values =
        values.chunks_exact(group).zip(keep).filter(|(_, keep)| **keep).flat_map(|(row, _)| row).copied().collect();
}
