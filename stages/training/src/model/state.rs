//! The trained tensors of a model by name.

use std::collections::BTreeMap;

use anyhow::Context as _;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::artifact::NamedTensor;

/// Every tensor of a model by name, e.g. `gaussians.positions`: the input and the output of a training phase.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ModelState<T: Real> {
    tensors: BTreeMap<String, Tensor<T>>,
}

impl<T: Real> ModelState<T> {
    /// A state without tensors.
    pub(crate) fn new() -> Self {
        Self { tensors: BTreeMap::new() }
    }

    /// Adds or replaces a tensor.
    pub(crate) fn insert(&mut self, name: impl Into<String>, tensor: Tensor<T>) {
        self.tensors.insert(name.into(), tensor);
    }

    /// The tensor of that name; the error lists the existing names.
    pub(crate) fn get(&self, name: &str) -> anyhow::Result<&Tensor<T>> {
        self.tensors.get(name).with_context(|| {
            format!("the model has no tensor {name}, only {}", self.names().collect::<Vec<_>>().join(", "))
        })
    }

    /// Names in alphabetical order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// Names and tensors in alphabetical order.
    #[cfg(test)]
    pub(crate) fn iter(&self) -> impl Iterator<Item = (&str, &Tensor<T>)> {
        self.tensors.iter().map(|(name, tensor)| (name.as_str(), tensor))
    }

    /// Converts all values to another precision.
    #[cfg(test)]
    pub(crate) fn cast<U: Real>(&self) -> ModelState<U> {
        ModelState { tensors: self.tensors.iter().map(|(name, tensor)| (name.clone(), tensor.cast())).collect() }
    }

    /// Puts every tensor on the tape: a leaf if `learns` returns true for its name, otherwise a constant.
    pub(crate) fn bind(&self, tape: &mut Tape<T>, learns: impl Fn(&str) -> bool) -> Variables {
        let bind = |(name, tensor): (&String, &Tensor<T>)| {
            let var = if learns(name) { tape.leaf(tensor.clone()) } else { tape.constant(tensor.clone()) };
            (name.clone(), var)
        };
        Variables::new(self.tensors.iter().map(bind).collect())
    }
}

impl<T: Real> IntoIterator for ModelState<T> {
    type Item = (String, Tensor<T>);
    type IntoIter = std::collections::btree_map::IntoIter<String, Tensor<T>>;

    fn into_iter(self) -> Self::IntoIter {
        self.tensors.into_iter()
    }
}

impl ModelState<f32> {
    /// The tensors as the artifact stores them.
    pub(crate) fn to_named(&self) -> BTreeMap<String, NamedTensor> {
        let convert = |(name, tensor): (&String, &Tensor<f32>)| {
            (name.clone(), NamedTensor { shape: tensor.shape().to_vec(), values: tensor.as_slice().to_vec() })
        };
        self.tensors.iter().map(convert).collect()
    }

    /// The tensors of an artifact.
    pub(crate) fn from_named(tensors: &BTreeMap<String, NamedTensor>) -> Self {
        let convert = |(name, tensor): (&String, &NamedTensor)| {
            (name.clone(), Tensor::from_vec(tensor.shape.clone(), tensor.values.clone()))
        };
        Self { tensors: tensors.iter().map(convert).collect() }
    }
}

/// A model's tensors on a tape.
#[derive(Clone, Debug)]
pub(crate) struct Variables {
    vars: BTreeMap<String, Var>,
}

impl Variables {
    /// Variables by name.
    pub(crate) fn new(vars: BTreeMap<String, Var>) -> Self {
        Self { vars }
    }

    /// The variable of that name. Panics if the model has no such tensor.
    pub(crate) fn get(&self, name: &str) -> Var {
        *self.vars.get(name).unwrap_or_else(|| panic!("the model has no tensor {name}"))
    }

    /// The variable of that name, if the model has such a tensor.
    pub(crate) fn find(&self, name: &str) -> Option<Var> {
        self.vars.get(name).copied()
    }

    /// Names and variables in alphabetical order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (&str, Var)> {
        self.vars.iter().map(|(name, &var)| (name.as_str(), var))
    }
}

/// Whether the tensor `name` belongs to `population`, e.g. `gaussians.positions` to `gaussians`. All tensors of a
/// population have one row per member, and their rows are added and removed together.
pub(crate) fn belongs(name: &str, population: &str) -> bool {
    name.strip_prefix(population).is_some_and(|rest| rest.starts_with('.'))
}
