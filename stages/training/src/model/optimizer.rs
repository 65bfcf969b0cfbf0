//! The tensors of a model with their Adam moments, and the insertion and removal of rows.

use std::collections::BTreeMap;

use anyhow::{Context as _, ensure};
use shaders::adam::{Adam, Group, GroupState, Update};
use shaders::arrays::magnitude::largest_magnitudes;
use shaders::gpu::Gpu;
use shaders::tape::{Tape, Tensor};

use super::state::{ModelState, Variables, belongs};
use crate::artifact::NamedTensor;
use crate::schedule::LogLinear;

/// All tensors of a model in one phase, with learning rates for those that are trained.
#[derive(Clone, Default)]
pub(crate) struct Optimizer {
    adam: Adam,
    learners: BTreeMap<String, Learner>,
}

/// One tensor; without a rate it is constant.
#[derive(Clone)]
struct Learner {
    group: Group,
    rate: Option<LogLinear>,
}

impl Optimizer {
    /// Zero moments for a state; tensors without a rate are constant.
    pub(crate) fn new(state: ModelState<f32>, rate: impl Fn(&str) -> Option<LogLinear>) -> Self {
        let learner = |(name, tensor): (String, Tensor<f32>)| {
            let learner = Learner { rate: rate(&name), group: Group::new(name.clone(), tensor) };
            (name, learner)
        };
        Self { adam: Adam::default(), learners: state.into_iter().map(learner).collect() }
    }

    /// The tensors at the end of a phase.
    pub(crate) fn into_state(self) -> ModelState<f32> {
        let mut state = ModelState::new();
        for (name, learner) in self.learners {
            state.insert(name, learner.group.tensor().clone());
        }
        state
    }

    /// Puts every tensor on the tape; trained tensors are leaves.
    pub(crate) fn bind(&self, tape: &mut Tape<f32>) -> Variables {
        self.bind_as(tape, |learner| learner.rate.is_some())
    }

    /// Puts every tensor on the tape without gradients.
    pub(crate) fn bind_constant(&self, tape: &mut Tape<f32>) -> Variables {
        self.bind_as(tape, |_| false)
    }

    fn bind_as(&self, tape: &mut Tape<f32>, learns: impl Fn(&Learner) -> bool) -> Variables {
        let bind = |(name, learner): (&String, &Learner)| {
            let tensor = learner.group.tensor().clone();
            let var = if learns(learner) { tape.leaf(tensor) } else { tape.constant(tensor) };
            (name.clone(), var)
        };
        Variables::new(self.learners.iter().map(bind).collect())
    }

    /// The largest magnitude in each gradient; NaN if any value is NaN.
    pub(crate) fn largest_magnitudes<'a>(gradients: &BTreeMap<&'a str, Tensor<f32>>) -> BTreeMap<&'a str, f32> {
        let tensors: Vec<&Tensor<f32>> = gradients.values().collect();
        gradients.keys().copied().zip(largest_magnitudes(&tensors)).collect()
    }

    /// The first tensor in alphabetical order with a value that is not finite.
    pub(crate) fn first_bad_tensor(&self) -> Option<&str> {
        let tensors: Vec<&Tensor<f32>> = self.learners.values().map(|learner| learner.group.tensor()).collect();
        let mut magnitudes = self.learners.keys().zip(largest_magnitudes(&tensors));
        magnitudes.find(|(_, magnitude)| !magnitude.is_finite()).map(|(name, _)| name.as_str())
    }

    /// One Adam step with the rates of `iteration` (counted from 1); tensors without a gradient do not change.
    pub(crate) fn step(&mut self, gradients: &BTreeMap<&str, Tensor<f32>>, iteration: u64) -> anyhow::Result<()> {
        let adam = self.adam;
        adam.step(&mut self.updates(gradients, iteration)?);
        Ok(())
    }

    /// [`Optimizer::step`] on a GPU, without waiting for it. Returns the largest magnitudes of each gradient and of the
    /// new values, [count, 2].
    pub(crate) fn step_on(
        &mut self,
        gpu: Gpu,
        gradients: &BTreeMap<&str, Tensor<f32>>,
        iteration: u64,
    ) -> anyhow::Result<Tensor<f32>> {
        let adam = self.adam;
        Ok(adam.step_on(gpu, &mut self.updates(gradients, iteration)?))
    }

    /// One update per gradient, in order.
    fn updates<'a>(
        &'a mut self,
        gradients: &'a BTreeMap<&str, Tensor<f32>>,
        iteration: u64,
    ) -> anyhow::Result<Vec<Update<'a>>> {
        if let Some(unknown) = gradients.keys().find(|name| !self.learners.contains_key(**name)) {
            anyhow::bail!("a gradient of {unknown}, which the model does not have");
        }
        let update = |(name, learner): (&'a String, &'a mut Learner)| {
            let rate = learner.rate?;
            let gradient = gradients.get(name.as_str());
            let constant_learns =
                || constant_of(name).is_some_and(|constant| gradients.contains_key(constant.as_str()));
            if gradient.is_none() && constant_learns() {
                learner.group.count_step();
            }
            Some(Update { group: &mut learner.group, gradient: Some(gradient?), learning_rate: rate.at(iteration) })
        };
        Ok(self.learners.iter_mut().filter_map(update).collect())
    }

    /// A tensor's values.
    pub(crate) fn tensor(&self, name: &str) -> anyhow::Result<&Tensor<f32>> {
        Ok(self.learner(name)?.group.tensor())
    }

    /// Changes a tensor's values in place; its moments stay.
    pub(crate) fn edit(&mut self, name: &str, change: impl FnOnce(&mut [f32])) -> anyhow::Result<()> {
        change(self.learner_mut(name)?.group.values_mut());
        Ok(())
    }

    /// Replaces a tensor's values by a tensor of the same shape; its moments stay.
    pub(crate) fn set_values(&mut self, name: &str, tensor: Tensor<f32>) -> anyhow::Result<()> {
        self.learner_mut(name)?.group.set_values(tensor);
        Ok(())
    }

    /// Resets a tensor's moments to zero.
    pub(crate) fn reset_moments(&mut self, name: &str) -> anyhow::Result<()> {
        self.learner_mut(name)?.group.reset_moments();
        Ok(())
    }

    /// Number of rows of a population.
    pub(crate) fn population_len(&self, population: &str) -> anyhow::Result<usize> {
        let member = self.learners.iter().find(|(name, _)| belongs(name, population));
        let (_, learner) = member.with_context(|| format!("the model has no population {population}"))?;
        Ok(learner.group.rows())
    }

    /// Appends copies of rows to every tensor of a population, with zero moments.
    pub(crate) fn append_copies(&mut self, population: &str, rows: &[usize]) -> anyhow::Result<()> {
        let count = self.population_len(population)?;
        ensure!(rows.iter().all(|&row| row < count), "a copy of a row beyond the {count} rows of {population}");
        for group in self.groups_of(population) {
            let copies: Vec<f32> = rows.iter().flat_map(|&row| group.tensor().row(row)).copied().collect();
            group.append_rows(&copies);
        }
        Ok(())
    }

    /// Removes the rows of a population whose flag is false, with their moments.
    pub(crate) fn keep(&mut self, population: &str, keep: &[bool]) -> anyhow::Result<()> {
        let count = self.population_len(population)?;
        ensure!(keep.len() == count, "{} flags for the {count} rows of {population}", keep.len());
        if keep.contains(&false) {
            self.groups_of(population).for_each(|group| group.keep_rows(keep));
        }
        Ok(())
    }

    /// Whether every tensor has at least one row.
    pub(crate) fn has_rows(&self) -> bool {
        self.learners.values().all(|learner| learner.group.rows() > 0)
    }

    /// Values and moments by name, and the number of optimizer steps of every tensor.
    pub(crate) fn save(&self) -> (BTreeMap<String, NamedTensor>, BTreeMap<String, u64>) {
        let mut tensors = BTreeMap::new();
        let mut steps = BTreeMap::new();
        for (name, learner) in &self.learners {
            let GroupState { shape, values, first_moment, second_moment, step, .. } = learner.group.state();
            for (part, values) in [(VALUE, values), (FIRST, first_moment), (SECOND, second_moment)] {
                tensors.insert(format!("{part}{name}"), NamedTensor { shape: shape.clone(), values });
            }
            steps.insert(name.clone(), step);
        }
        (tensors, steps)
    }

    /// Inverse of [`Optimizer::save`], with the learning rates of the phase.
    pub(crate) fn restore(
        tensors: &BTreeMap<String, NamedTensor>,
        steps: &BTreeMap<String, u64>,
        rate: impl Fn(&str) -> Option<LogLinear>,
    ) -> anyhow::Result<Self> {
        let mut learners = BTreeMap::new();
        for (name, &step) in steps {
            let part = |part: &str| {
                let tensor = tensors.get(&format!("{part}{name}"));
                tensor.cloned().with_context(|| format!("the checkpoint lacks {part}{name}"))
            };
            let NamedTensor { shape, values } = part(VALUE)?;
            let (first_moment, second_moment) = (part(FIRST)?.values, part(SECOND)?.values);
            let same = first_moment.len() == values.len() && second_moment.len() == values.len();
            ensure!(same, "the moments of {name} in the checkpoint have other sizes than its values");
            let state = GroupState { name: name.clone(), shape, values, first_moment, second_moment, step };
            learners.insert(name.clone(), Learner { group: Group::from_state(state), rate: rate(name) });
        }
        Ok(Self { adam: Adam::default(), learners })
    }

    fn groups_of<'a>(&'a mut self, population: &'a str) -> impl Iterator<Item = &'a mut Group> {
        let members = self.learners.iter_mut().filter(move |(name, _)| belongs(name, population));
        members.map(|(_, learner)| &mut learner.group)
    }

    fn learner(&self, name: &str) -> anyhow::Result<&Learner> {
        self.learners.get(name).with_context(|| format!("the model has no tensor {name}"))
    }

    fn learner_mut(&mut self, name: &str) -> anyhow::Result<&mut Learner> {
        self.learners.get_mut(name).with_context(|| format!("the model has no tensor {name}"))
    }
}

/// Prefixes of the tensors in a checkpoint.
const VALUE: &str = "value.";
const FIRST: &str = "first_moment.";
const SECOND: &str = "second_moment.";

/// The constant harmonic that belongs to a tensor of higher harmonics. Both count the same steps, as in the published
/// code, where harmonics above the current degree have a gradient of zero.
fn constant_of(name: &str) -> Option<String> {
    let (population, attribute) = name.rsplit_once('.')?;
    ["sh_rest", "sh_waves"].contains(&attribute).then(|| format!("{population}.sh_dc"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn optimizer() -> Optimizer {
        let mut state = ModelState::new();
        state.insert("points.a", Tensor::from_vec([3, 2], vec![0.0, 1.0, 10.0, 11.0, 20.0, 21.0]));
        state.insert("points.b", Tensor::from_vec([3, 1], vec![0.5, 1.5, 2.5]));
        state.insert("points_of_others", Tensor::from_vec([1], vec![7.0]));
        Optimizer::new(state, |name| belongs(name, "points").then(|| LogLinear::constant(0.1)))
    }

    fn gradients() -> BTreeMap<&'static str, Tensor<f32>> {
        [("points.a", Tensor::full([3, 2], 1.0)), ("points.b", Tensor::from_vec([3, 1], vec![1.0, 0.0, -1.0]))].into()
    }

    #[test]
    fn rows_change_together_within_their_population() {
        let mut optimizer = optimizer();
        optimizer.append_copies("points", &[2, 0]).unwrap();
        optimizer.keep("points", &[false, true, true, true, true]).unwrap();
        let state = optimizer.into_state();
        assert_eq!(state.get("points.a").unwrap().as_slice(), [10.0, 11.0, 20.0, 21.0, 20.0, 21.0, 0.0, 1.0]);
        assert_eq!(state.get("points.b").unwrap().as_slice(), [1.5, 2.5, 2.5, 0.5]);
        assert_eq!(state.get("points_of_others").unwrap().as_slice(), [7.0]);
    }

    #[test]
    fn a_restored_optimizer_steps_like_the_saved_one() {
        let mut saved = optimizer();
        saved.step(&gradients(), 1).unwrap();
        let (tensors, steps) = saved.save();
        let rate = |name: &str| belongs(name, "points").then(|| LogLinear::constant(0.1));
        let mut restored = Optimizer::restore(&tensors, &steps, rate).unwrap();
        saved.step(&gradients(), 2).unwrap();
        restored.step(&gradients(), 2).unwrap();
        assert_eq!(saved.save(), restored.save());
        assert_eq!(saved.into_state().get("points_of_others").unwrap().as_slice(), [7.0]);
    }

    #[test]
    fn higher_harmonics_count_the_steps_before_their_first_use() {
        let mut state = ModelState::new();
        for name in ["g.sh_dc", "g.sh_rest", "g.other"] {
            state.insert(name, Tensor::full([1, 1], 0.0));
        }
        let mut optimizer = Optimizer::new(state, |_| Some(LogLinear::constant(0.1)));
        optimizer.step(&[("g.sh_dc", Tensor::full([1, 1], 1.0))].into(), 1).unwrap();
        let (_, steps) = optimizer.save();
        assert_eq!([steps["g.sh_dc"], steps["g.sh_rest"], steps["g.other"]], [1, 1, 0]);
        assert_eq!(optimizer.tensor("g.sh_rest").unwrap().as_slice(), [0.0]);
    }

    #[test]
    fn damaged_checkpoints_and_wrong_rows_are_errors() {
        let (mut tensors, steps) = optimizer().save();
        tensors.remove("first_moment.points.b");
        assert!(Optimizer::restore(&tensors, &steps, |_| None).is_err());
        assert!(optimizer().append_copies("points", &[3]).is_err());
        assert!(optimizer().keep("points", &[true]).is_err());
        assert!(optimizer().keep("unknown", &[]).is_err());
        assert!(optimizer().step(&[("points.c", Tensor::full([1], 1.0))].into(), 1).is_err());
    }

    #[test]
    fn non_finite_values_are_found_by_name() {
        let mut gradients = gradients();
        let largest = |gradients: &BTreeMap<_, _>| Optimizer::largest_magnitudes(gradients)["points.b"];
        for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            gradients.insert("points.b", Tensor::from_vec([3, 1], vec![1.0, bad, -1.0]));
            assert!(!largest(&gradients).is_finite(), "{bad}");
        }
        gradients.insert("points.b", Tensor::from_vec([3, 1], vec![1.0, -3.0, 2.0]));
        assert_eq!(largest(&gradients), 3.0);
        gradients.insert("points.b", Tensor::full([3, 1], f32::MAX));
        let mut optimizer = optimizer();
        assert_eq!(optimizer.first_bad_tensor(), None);
        optimizer.edit("points.a", |values| values[5] = f32::INFINITY).unwrap();
        assert_eq!(optimizer.first_bad_tensor(), Some("points.a"));
        assert_eq!(largest(&gradients), f32::MAX);
    }
}
