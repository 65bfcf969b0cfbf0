//! The network shape of hexplane methods: one trunk layer and a small head per attribute, each ReLU, Linear, ReLU,
//! Linear (Wu et al. 2024, section 4.3).

use shaders::networks::linear::Activation;
use shaders::pointwise::scale;
use shaders::tape::{Real, Tape, Var};

use crate::bases::layers::{FirstWeights, apply_layer, apply_layers, insert_layer};
use crate::data::Streams;
use crate::model::{ModelState, Variables};

/// The name of the head that moves positions.
pub(crate) const POSITION: &str = "position";

/// Converts displacements to scene units from units of `unit_world`, in which networks with fixed learning rates
/// predict them.
pub(crate) fn in_scene_units<T: Real>(tape: &mut Tape<T>, displacements: Var, unit_world: f64) -> Var {
    if unit_world == 1.0 { displacements } else { scale(tape, displacements, unit_world) }
}

/// Sizes of a network with the tensors `{name}.trunk`, `{name}.{head}.0` and `{name}.{head}.1`.
#[derive(Clone, Debug)]
pub(crate) struct HeadedNetwork {
    name: &'static str,
    features: usize,
    width: usize,
    heads: Vec<(&'static str, usize)>,
    silent_heads: Vec<(&'static str, usize)>,
}

impl HeadedNetwork {
    /// A network `features` → `width` → the outputs of each head.
    pub(crate) fn new(name: &'static str, features: usize, width: usize, heads: Vec<(&'static str, usize)>) -> Self {
        Self { name, features, width, heads, silent_heads: Vec::new() }
    }

    /// Adds heads that always start at 0.
    pub(crate) fn with_silent_heads(self, silent_heads: Vec<(&'static str, usize)>) -> Self {
        Self { silent_heads, ..self }
    }

    /// Adds trunk and heads; with `zero_heads` every head starts at 0.
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, zero_heads: bool, random: Streams) {
        let last = if zero_heads { FirstWeights::Zero } else { FirstWeights::Xavier };
        insert_layer(state, &format!("{}.trunk", self.name), self.features, self.width, FirstWeights::Xavier, random);
        let heads = self.heads.iter().map(|head| (head, last));
        for (&(head, outputs), last) in heads.chain(self.silent_heads.iter().map(|head| (head, FirstWeights::Zero))) {
            let [inner, outer] = self.layers(head);
            insert_layer(state, &inner, self.width, self.width, FirstWeights::Xavier, random);
            insert_layer(state, &outer, self.width, outputs, last, random);
        }
    }

    /// The common input of all heads: trunk and ReLU of features [N, F].
    pub(crate) fn hidden<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, features: Var) -> Var {
        apply_layer(tape, model, &format!("{}.trunk", self.name), features, Activation::Relu)
    }

    /// The outputs [N, outputs] of heads.
    pub(crate) fn heads<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        heads: &[&str],
        hidden: Var,
    ) -> Vec<Var> {
        let layers: Vec<[String; 2]> = heads.iter().map(|head| self.layers(head)).collect();
        let inner: Vec<_> = layers.iter().map(|[inner, _]| (inner.clone(), hidden)).collect();
        let inner = apply_layers(tape, model, &inner, Activation::Relu);
        let outer: Vec<_> = layers.iter().zip(inner).map(|([_, outer], x)| (outer.clone(), x)).collect();
        apply_layers(tape, model, &outer, Activation::Identity)
    }

    /// The output [N, outputs] of a head.
    pub(crate) fn head<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, head: &str, hidden: Var) -> Var {
        self.heads(tape, model, &[head], hidden)[0]
    }

    /// The output [N, 3] of the head `position` in scene units; the network counts in units of `unit_world`.
    pub(crate) fn displacements<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        hidden: Var,
        unit_world: f64,
    ) -> Var {
        let change = self.head(tape, model, POSITION, hidden);
        in_scene_units(tape, change, unit_world)
    }

    fn layers(&self, head: &str) -> [String; 2] {
        [0, 1].map(|layer| format!("{}.{head}.{layer}", self.name))
    }
}
