//! Activation of each particle: a time window around a trained centre (KineticGS equations 7 to 9).

use std::collections::BTreeMap;

use shaders::losses::histogram::{divergence_from_uniform, soft_histogram};
use shaders::networks::linear::Activation;
use shaders::networks::positional_encoding::PositionalEncoding;
use shaders::pointwise::{add, hyperbolic_tangent, mul, scale, shift, sigmoid, sub};
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::bases::layers::{FirstWeights, apply_layer, insert_layer, uniform};
use crate::data::Streams;
use crate::model::{ModelState, Variables};

/// Prefix of the network's tensors.
pub(crate) const ACTIVATION: &str = "activation";
/// Six octaves of the position in the scene's box.
const ENCODING: PositionalEncoding = PositionalEncoding { bands: 6, with_input: true };
/// Width of the two hidden layers.
const WIDTH: usize = 64;
/// Width of a window's edges (τ), as a share of the clip.
const SHARPNESS: f64 = 0.02;
/// Minimum half-width of a window (ε), as a share of the clip.
const LEAST_RADIUS: f64 = 0.01;
/// Initial Δ^cr before its tanh: windows of half-width 0.47 around the middle, so that no particle is frozen initially.
const FIRST_RADIUS: f64 = 1.5;
/// Standard deviation of the initial weights of Δ^ct (uniform) before their division by √[`WIDTH`]: window centres
/// differ.
const FIRST_CENTERS: f64 = 0.3;
/// Times of the report on active particles, as shares of the clip.
const REPORTED_TIMES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// A particle counts as active in the report where its window is above this value.
const ACTIVE: f64 = 0.5;
/// Bins of the histograms over (−1, 1).
const BINS: usize = 32;

/// Adds the network 39 → 64 → 64 → (Δ^ct, Δ^cr).
pub(crate) fn insert<T: Real>(state: &mut ModelState<T>, random: Streams) {
    insert_layer(state, "activation.0", ENCODING.columns(3), WIDTH, FirstWeights::Xavier, random);
    insert_layer(state, "activation.1", WIDTH, WIDTH, FirstWeights::Xavier, random);
    // A uniform distribution with standard deviation s has the limits ±√3·s; s is divided among the inputs.
    let bound = FIRST_CENTERS * (3.0 / WIDTH as f64).sqrt();
    insert_layer(state, "activation.center", WIDTH, 1, FirstWeights::Zero, random);
    let center = "activation.center.weight";
    state.insert(center, uniform(&[1, WIDTH], -bound, bound, &mut random.tensor(center)));
    insert_layer(state, "activation.radius", WIDTH, 1, FirstWeights::Zero, random);
    state.insert("activation.radius.bias", Tensor::full([1], T::from_f64(FIRST_RADIUS)));
}

/// The windows of P particles, in shares of the clip.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Windows {
    /// Δ^ct [P, 1] in (−1, 1), the network's shift of the centre.
    pub center_deltas: Var,
    /// Δ^cr [P, 1] in (−1, 1), the network's change of the half-width.
    radius_deltas: Var,
    /// Window centres t^ct [P, 1].
    pub centers: Var,
    /// Window starts t^ct − t^cr [P, 1].
    starts: Var,
    /// Window ends t^ct + t^cr [P, 1].
    ends: Var,
}

impl Windows {
    /// The windows of particles at canonical positions [P, 3] in [−1, 1] coordinates: in shares of the clip, t^ct = ½ +
    /// ½Δ^ct and t^cr = ¼ + (¼ − ε)Δ^cr.
    pub(crate) fn of<T: Real>(tape: &mut Tape<T>, model: &Variables, positions: Var) -> Self {
        let encoded = ENCODING.encode(tape, positions);
        let hidden = apply_layer(tape, model, "activation.0", encoded, Activation::Relu);
        let hidden = apply_layer(tape, model, "activation.1", hidden, Activation::Relu);
        let mut delta = |head: &str| {
            let raw = apply_layer(tape, model, head, hidden, Activation::Identity);
            hyperbolic_tangent(tape, raw)
        };
        let (center_deltas, radius_deltas) = (delta("activation.center"), delta("activation.radius"));
        let half = scale(tape, center_deltas, 0.5);
        let centers = shift(tape, half, 0.5);
        let quarter = scale(tape, radius_deltas, 0.25 - LEAST_RADIUS);
        let radii = shift(tape, quarter, 0.25);
        let (starts, ends) = (sub(tape, centers, radii), add(tape, centers, radii));
        Self { center_deltas, radius_deltas, centers, starts, ends }
    }

    /// [P, 1]: w = σ((t − start) / τ)·σ((end − t) / τ) in (0, 1) at a time in [0, 1].
    pub(crate) fn at<T: Real>(&self, tape: &mut Tape<T>, time: f64) -> Var {
        let mut edge = |border: Var, sign: f64| {
            let distance = scale(tape, border, -sign / SHARPNESS);
            let distance = shift(tape, distance, sign * time / SHARPNESS);
            sigmoid(tape, distance)
        };
        let (opened, not_closed) = (edge(self.starts, 1.0), edge(self.ends, -1.0));
        mul(tape, opened, not_closed)
    }

    /// Percentages by name: the share of active particles (with a window above [`ACTIVE`]) at [`REPORTED_TIMES`], and
    /// the mean width and the spread of the centres of the windows, as shares of the clip.
    pub(crate) fn figures<T: Real>(&self, tape: &mut Tape<T>) -> BTreeMap<String, f64> {
        let mut figures = BTreeMap::new();
        for time in REPORTED_TIMES {
            let window = self.at(tape, time);
            let window = tape.value(window).as_slice();
            let active = window.iter().filter(|w| w.to_f64() > ACTIVE).count();
            let share = 100.0 * active as f64 / window.len() as f64;
            figures.insert(format!("particles active at {:.0} % of the clip (%)", 100.0 * time), share);
        }
        let values = |var: Var| tape.value(var).as_slice().iter().map(|value| value.to_f64()).collect::<Vec<f64>>();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (centers, starts, ends) = (values(self.centers), values(self.starts), values(self.ends));
        let widths: Vec<f64> = starts.iter().zip(&ends).map(|(start, end)| end - start).collect();
        let middle = mean(&centers);
        let squares: Vec<f64> = centers.iter().map(|center| (center - middle).powi(2)).collect();
        figures.insert("width of the windows, mean (% of the clip)".into(), 100.0 * mean(&widths));
        figures.insert("window centres, standard deviation (% of the clip)".into(), 100.0 * mean(&squares).sqrt());
        figures
    }

    /// Deviation of centres and half-widths from an even spread; shape [1].
    pub(crate) fn unevenness<T: Real>(&self, tape: &mut Tape<T>) -> Var {
        let [centers, radii] = [self.center_deltas, self.radius_deltas].map(|deltas| {
            let shares = soft_histogram(tape, deltas, BINS, [-1.0, 1.0]);
            divergence_from_uniform(tape, shares)
        });
        add(tape, centers, radii)
    }
}
