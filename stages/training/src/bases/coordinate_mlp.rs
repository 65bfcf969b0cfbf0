//! The coordinate network of Deformable 3D Gaussians (Yang et al. 2024, section 3.3): positionally encoded position and
//! time pass through eight layers of 256 ReLUs with a skip connection from the input; linear heads predict the changes.
//!
//! The network reads positions relative to the scene's box (`{name}.bounds`, [`crate::bases::bounds`]), and its shifts
//! are in units of the box. The published code reads world coordinates, which its scenes keep near [−1, 1]; at
//! coordinates of 10⁴ the highest frequencies in f32 would be noise.

use scene::cloud::PointCloud;
use serde::{Deserialize, Serialize};
use shaders::arrays::rows::{RowIndex, concat_columns, gather};
use shaders::networks::linear::Activation;
use shaders::networks::positional_encoding::PositionalEncoding;
use shaders::pointwise::scale;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::bases::bounds::{self, Bounds};
use crate::bases::layers::{FirstWeights, apply_layer, insert_layer};
use crate::check::{Checks, Table, fields};
use crate::data::Streams;
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::LogLinear;

/// Number of coordinates of a position.
const AXES: usize = 3;

/// Sizes, encodings and learning rate of the network; the defaults are the published ones for synthetic scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct CoordinateMlpSettings {
    /// Hidden layers.
    pub depth: usize,
    /// Width of the hidden layers.
    pub width: usize,
    /// The layer after which the encoded input is concatenated again, counted from 1; 0: never.
    pub skip_after: usize,
    /// Frequencies of the encoded position.
    pub position_bands: usize,
    /// Frequencies of the encoded time.
    pub time_bands: usize,
    /// Outputs of a small network that processes the encoded time; 0 passes the encoded time on unchanged (the
    /// published settings for real scenes, with 10 bands).
    pub time_features: usize,
    /// Learning rate.
    pub rate: LogLinear,
}

impl Default for CoordinateMlpSettings {
    fn default() -> Self {
        Self {
            depth: 8,
            width: 256,
            skip_after: 5,
            position_bands: 10,
            time_bands: 6,
            time_features: 30,
            rate: LogLinear { start: 8e-4, end: 1.6e-6, steps: 40_000 },
        }
    }
}

/// Maximum hidden layers; a larger value is a typing error.
const MAX_LAYERS: usize = 64;
/// Maximum size: at 4096 channels, the activations of 100 000 positions take 1.6 GB, so a larger value is a typing
/// error.
const MAX_CHANNELS: usize = 4096;
/// Maximum frequencies: at 2²⁰ the phase of a coordinate of 1 is lost to rounding in f32.
const MAX_BANDS: usize = 20;

impl CoordinateMlpSettings {
    /// Small, with every part.
    #[cfg(test)]
    pub(crate) fn tiny() -> Self {
        Self {
            depth: 3,
            width: 8,
            skip_after: 2,
            position_bands: 2,
            time_bands: 2,
            time_features: 3,
            ..Self::default()
        }
    }
}

impl Table for CoordinateMlpSettings {
    fn check(&self) -> Checks {
        Checks::default()
            .counts(MAX_LAYERS, fields!(self, depth))
            .counts(MAX_CHANNELS, fields!(self, width))
            .require("skip_after", self.skip_after < self.depth, "must be less than depth")
            .at_most(MAX_BANDS, fields!(self, position_bands, time_bands))
            .at_most(MAX_CHANNELS, fields!(self, time_features))
            .table("rate", &self.rate)
    }
}

/// A linear map of the last hidden layer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Head {
    /// The name, e.g. `position`; the tensors are `{network}.{name}.…`.
    pub name: &'static str,
    /// Number of outputs.
    pub outputs: usize,
    /// Initial weights.
    pub first: FirstWeights,
}

/// A network with its heads; its tensors are called `{name}.…`.
#[derive(Clone, Debug)]
pub(crate) struct CoordinateMlp {
    name: &'static str,
    settings: CoordinateMlpSettings,
    first: FirstWeights,
    heads: Vec<Head>,
}

impl CoordinateMlp {
    /// A network whose hidden layers have the initial weights `first`; those of time have PyTorch's default.
    pub(crate) fn new(
        name: &'static str,
        settings: &CoordinateMlpSettings,
        first: FirstWeights,
        heads: &[Head],
    ) -> Self {
        Self { name, settings: settings.clone(), first, heads: heads.to_vec() }
    }

    /// Adds the box of the points and all layers.
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, points: &PointCloud, random: Streams) {
        Bounds::typical_cube(&points.positions).insert(state, self.name);
        let CoordinateMlpSettings { depth, width, time_features, .. } = self.settings;
        if time_features > 0 {
            let columns = self.time_encoding().columns(1);
            insert_layer(state, &self.tensor("time.0"), columns, width, FirstWeights::FanIn, random);
            insert_layer(state, &self.tensor("time.1"), width, time_features, FirstWeights::FanIn, random);
        }
        for layer in 0..depth {
            let before = if layer == 0 { 0 } else { width };
            let joined = if self.joins_input(layer) { self.input_columns() } else { 0 };
            insert_layer(state, &self.layer(layer), before + joined, width, self.first, random);
        }
        for head in &self.heads {
            insert_layer(state, &self.tensor(head.name), width, head.outputs, head.first, random);
        }
    }

    /// The learning rate of this network's tensors.
    pub(crate) fn learning_rate(&self, tensor: &str) -> Option<LogLinear> {
        (belongs(tensor, self.name) && tensor != bounds::tensor_name(self.name)).then_some(self.settings.rate)
    }

    /// Whether a tensor takes part in the output of a head.
    pub(crate) fn reaches(&self, tensor: &str, head: &str) -> bool {
        let is_other = |other: &Head| other.name != head && belongs(tensor, &self.tensor(other.name));
        belongs(tensor, self.name) && !self.heads.iter().any(is_other)
    }

    /// The last hidden layer at every position [N, 3] (world) and time in [0, 1]: [T·N, width], time by time.
    ///
    /// Positions enter without gradient, as published: the motion model does not pull Gaussians to other positions.
    pub(crate) fn hidden<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, positions: Var, times: &[f64]) -> Var {
        let input = self.input(tape, model, positions, times);
        let mut hidden = None;
        for layer in 0..self.settings.depth {
            let x = match hidden {
                None => input,
                Some(hidden) if self.joins_input(layer) => concat_columns(tape, &[input, hidden]),
                Some(hidden) => hidden,
            };
            hidden = Some(apply_layer(tape, model, &self.layer(layer), x, Activation::Relu));
        }
        hidden.expect("at least one layer")
    }

    /// The output of a head in scene units, for rows of the last hidden layer.
    pub(crate) fn lengths<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, head: &str, hidden: Var) -> Var {
        let inside = self.head(tape, model, head, hidden);
        let half_side = bounds::half_side(tape, model, self.name);
        scale(tape, inside, half_side)
    }

    /// The output of a head, for rows of the last hidden layer.
    pub(crate) fn head<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, head: &str, hidden: Var) -> Var {
        apply_layer(tape, model, &self.tensor(head), hidden, Activation::Identity)
    }

    /// Encoded positions and times: [T·N, input columns].
    fn input<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, positions: Var, times: &[f64]) -> Var {
        let held = tape.detach(positions);
        let inside = bounds::inside(tape, model, self.name, held);
        let place = self.position_encoding().encode(tape, inside);
        let times_column = times.iter().map(|&time| T::from_f64(time)).collect();
        let times_column = tape.constant(Tensor::from_vec([times.len(), 1], times_column));
        let mut moment = self.time_encoding().encode(tape, times_column);
        if self.settings.time_features > 0 {
            let inner = apply_layer(tape, model, &self.tensor("time.0"), moment, Activation::Relu);
            moment = apply_layer(tape, model, &self.tensor("time.1"), inner, Activation::Identity);
        }
        let rows = tape.value(positions).rows();
        let items = || 0..(times.len() * rows);
        let time_of_item = RowIndex::new(items().map(|item| (item / rows) as u32).collect(), times.len());
        let moment_rows = gather(tape, moment, &time_of_item);
        let place_rows = match times.len() {
            1 => place,
            _ => gather(tape, place, &RowIndex::new(items().map(|item| (item % rows) as u32).collect(), rows)),
        };
        concat_columns(tape, &[place_rows, moment_rows])
    }

    fn joins_input(&self, layer: usize) -> bool {
        layer == 0 || layer == self.settings.skip_after
    }

    fn input_columns(&self) -> usize {
        let time = match self.settings.time_features {
            0 => self.time_encoding().columns(1),
            features => features,
        };
        self.position_encoding().columns(AXES) + time
    }

    fn position_encoding(&self) -> PositionalEncoding {
        PositionalEncoding { bands: self.settings.position_bands, with_input: true }
    }

    fn time_encoding(&self) -> PositionalEncoding {
        PositionalEncoding { bands: self.settings.time_bands, with_input: true }
    }

    fn layer(&self, layer: usize) -> String {
        self.tensor(&format!("hidden.{layer}"))
    }

    fn tensor(&self, part: &str) -> String {
        format!("{}.{part}", self.name)
    }
}

#[cfg(test)]
mod tests {
    use shaders::check::noise;
    use shaders::tape::Device;

    use super::*;
    use crate::data::Streams;

    fn network(settings: &CoordinateMlpSettings) -> (CoordinateMlp, ModelState<f64>) {
        let heads = [Head { name: "position", outputs: 3, first: FirstWeights::FanIn }];
        let network = CoordinateMlp::new("network", settings, FirstWeights::FanIn, &heads);
        let mut state = ModelState::new();
        let points = PointCloud { positions: vec![[-1.0; 3], [0.0; 3], [1.0; 3]], colors: vec![[0; 3]; 3] };
        network.insert(&mut state, &points, Streams::new(1));
        (network, state)
    }

    #[test]
    fn the_published_sizes() {
        let (_, state) = network(&CoordinateMlpSettings::default());
        let shape = |name: &str| state.get(name).unwrap().shape().to_vec();
        assert_eq!(shape("network.time.0.weight"), [256, 13]);
        assert_eq!(shape("network.hidden.0.weight"), [256, 63 + 30]);
        assert_eq!(shape("network.hidden.4.weight"), [256, 256]);
        assert_eq!(shape("network.hidden.5.weight"), [256, 63 + 30 + 256]);
        assert_eq!(shape("network.position.weight"), [3, 256]);
        let (_, real) = network(&CoordinateMlpSettings { time_bands: 10, time_features: 0, ..Default::default() });
        assert_eq!(real.get("network.hidden.0.weight").unwrap().shape(), [256, 63 + 21]);
        assert!(real.names().all(|name| !name.contains("time")));
    }

    #[test]
    fn several_times_at_once_are_each_time_alone() {
        let (network, state) = network(&CoordinateMlpSettings::tiny());
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| true);
        let positions = tape.constant(Tensor::from_vec([4, 3], noise(12, 1)));
        let together = network.hidden(&mut tape, &model, positions, &[0.1, 0.7]);
        let alone = [0.1, 0.7].map(|time| network.hidden(&mut tape, &model, positions, &[time]));
        let joined = alone.map(|hidden| tape.value(hidden).as_slice().to_vec()).concat();
        assert_eq!(tape.value(together).as_slice(), joined);
    }

    #[test]
    fn origin_and_unit_of_the_world_change_no_output() {
        let near = PointCloud::random_in([[-1.0; 3], [1.0; 3]], 30, 2);
        let to_far = |point: [f32; 3]| point.map(|value| 1e4 + 50.0 * value);
        let far = PointCloud { positions: near.positions.iter().copied().map(to_far).collect(), ..near.clone() };
        let outputs_on = |points: &PointCloud| {
            let settings = CoordinateMlpSettings::tiny();
            let heads = [Head { name: "position", outputs: 3, first: FirstWeights::FanIn }];
            let network = CoordinateMlp::new("network", &settings, FirstWeights::FanIn, &heads);
            let mut state = ModelState::<f64>::new();
            network.insert(&mut state, points, Streams::new(1));
            let mut tape = Tape::new(Device::Cpu);
            let model = state.bind(&mut tape, |_| false);
            let positions = points.positions.iter().flatten().map(|&value| f64::from(value)).collect();
            let positions = tape.constant(Tensor::from_vec([points.len(), 3], positions));
            let hidden = network.hidden(&mut tape, &model, positions, &[0.4]);
            let lengths = network.lengths(&mut tape, &model, "position", hidden);
            tape.value(lengths).as_slice().to_vec()
        };
        let (here, there) = (outputs_on(&near), outputs_on(&far));
        let differ = |(here, there): (&f64, &f64)| !((50.0 * here - there).abs() <= 0.05);
        assert!(!here.iter().zip(&there).any(differ) && here.iter().any(|length| length.abs() > 0.01));
    }

    #[test]
    fn positions_receive_no_gradient_through_the_network() {
        let (network, state) = network(&CoordinateMlpSettings::tiny());
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| true);
        let positions = tape.leaf(Tensor::from_vec([4, 3], noise(12, 1)));
        let hidden = network.hidden(&mut tape, &model, positions, &[0.3]);
        let gradients = tape.backward(&[(hidden, Tensor::full([4, 8], 1.0))]);
        assert!(gradients.get(positions).is_none());
        assert!(gradients.get(model.get("network.time.0.weight")).is_some());
    }
}
