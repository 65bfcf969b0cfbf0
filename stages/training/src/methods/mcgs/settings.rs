//! Settings specific to MCGS.

use serde::{Deserialize, Serialize};

use super::markov::ChainSettings;
use super::noise::NoiseSettings;
use super::physics::PhysicsSettings;
use crate::bases::control_nodes::{ControlNodeSettings, NodeStageSettings};
use crate::bases::coordinate_mlp::CoordinateMlpSettings;
use crate::bases::time_noise::{FIRST_TIME_NOISE, TIME_NOISE_UNTIL};
use crate::check::{Checks, Table, fields};

/// The method's table in a recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    /// The network of the direct branch.
    pub network: CoordinateMlpSettings,
    /// The control nodes.
    pub nodes: ControlNodeSettings,
    /// The source of the nodes.
    pub nodes_from: NodeSource,
    /// The candidates, if nodes are chosen from them.
    pub node_stage: NodeStageSettings,
    /// The Markov chain.
    pub chain: ChainSettings,
    /// How direct and predicted motion are mixed.
    pub mixing: Mixing,
    /// Noise of the effect `noise`.
    pub noise: NoiseSettings,
    /// Initial rigidity weight of the effect `arap`.
    pub rigidity: f64,
    /// Weights of the effect `physics`.
    pub physics: PhysicsSettings,
    /// Weight of the loss that trains the chain to predict the states of the direct branch. The paper has none.
    pub prediction: f64,
    /// Initial standard deviation of the effect `time-noise`, in frame intervals.
    pub time_noise: f64,
    /// Iteration at which the time noise reaches zero.
    pub time_noise_until: u64,
}

/// Source of the control nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum NodeSource {
    /// Gaussians at the end of the static warm-up. Their nodes learn their positions.
    Gaussians,
    /// Candidates of the node stage of SC-GS, trained before the Gaussians.
    Candidates,
}

/// The chain's shares λ of the motion (equations 10 and 11), which grow linearly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Mixing {
    /// λ at the start of motion.
    pub first: f64,
    /// Final λ_pos.
    pub position: f64,
    /// Final λ_rot.
    pub rotation: f64,
    /// The iteration that reaches the final shares, counted from the start of the warm-up.
    pub until: u64,
    /// Share of the training views that render the direct branch alone.
    pub direct_views: f64,
}

impl Default for Mixing {
    fn default() -> Self {
        Self { first: 0.0, position: 0.5, rotation: 0.5, until: 15_000, direct_views: 0.5 }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            network: CoordinateMlpSettings::default(),
            nodes: ControlNodeSettings::default(),
            nodes_from: NodeSource::Gaussians,
            node_stage: NodeStageSettings::default(),
            chain: ChainSettings::default(),
            mixing: Mixing::default(),
            noise: NoiseSettings::default(),
            rigidity: 1e-4,
            physics: PhysicsSettings::default(),
            prediction: 0.0,
            time_noise: FIRST_TIME_NOISE,
            time_noise_until: TIME_NOISE_UNTIL,
        }
    }
}

impl Settings {
    /// Small settings with every part on. Each loss has a noticeable weight, but not so much that small gradients are
    /// lost in the rounding of their sum.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        Self {
            network: CoordinateMlpSettings::tiny(),
            nodes: ControlNodeSettings::tiny(),
            chain: ChainSettings { window: 2, width: 8, heads: 2, ..ChainSettings::default() },
            mixing: Mixing { first: 0.5, direct_views: 0.0, ..Mixing::default() },
            noise: NoiseSettings { rotation: 0.2, ..NoiseSettings::default() },
            rigidity: 0.01,
            physics: PhysicsSettings { acceleration: 0.01, speed_penalty: 0.01, ..PhysicsSettings::default() },
            prediction: 0.01,
            ..Self::default()
        }
    }
}

impl Table for Settings {
    fn check(&self) -> Checks {
        Checks::default()
            .table("network", &self.network)
            .table("nodes", &self.nodes)
            .table("node_stage", &self.node_stage)
            .table("chain", &self.chain)
            .shares(fields!(self, mixing.first, mixing.position, mixing.rotation, mixing.direct_views))
            .not_negative(fields!(self, noise.position_px, noise.rotation, rigidity, prediction, time_noise))
            .not_negative(fields!(self, physics.acceleration, physics.speed_penalty, physics.turning))
    }
}
