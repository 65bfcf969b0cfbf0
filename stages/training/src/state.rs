//! What a method learns: tensors by name.

use std::collections::BTreeMap;

use anyhow::Context as _;
use shaders::tape::{Real, Tape, Tensor, Var};

use crate::artifact::NamedTensor;

/// Every tensor of a model by name, as `gaussians.positions`; the state in and the state out of a training phase.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelState<T: Real> {
    tensors: BTreeMap<String, Tensor<T>>,
}

impl<T: Real> ModelState<T> {
    /// A state without tensors.
    pub fn new() -> Self {
        Self { tensors: BTreeMap::new() }
    }

    /// Adds or replaces a tensor.
    pub fn insert(&mut self, name: impl Into<String>, tensor: Tensor<T>) {
        self.tensors.insert(name.into(), tensor);
    }

    /// The tensor of that name; the error lists what there is.
    pub fn get(&self, name: &str) -> anyhow::Result<&Tensor<T>> {
        self.tensors.get(name).with_context(|| {
            format!("the model has no tensor {name}, only {}", self.names().collect::<Vec<_>>().join(", "))
        })
    }

    /// Names in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// Names and tensors in alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Tensor<T>)> {
        self.tensors.iter().map(|(name, tensor)| (name.as_str(), tensor))
    }

    /// Values in all tensors.
    pub fn value_count(&self) -> usize {
        self.tensors.values().map(Tensor::len).sum()
    }

    /// The same values in another precision.
    pub fn cast<U: Real>(&self) -> ModelState<U> {
        ModelState { tensors: self.tensors.iter().map(|(name, tensor)| (name.clone(), tensor.cast())).collect() }
    }

    /// Puts every tensor on the tape: a leaf where `learns` says so, else a constant.
    pub fn bind(&self, tape: &mut Tape<T>, learns: impl Fn(&str) -> bool) -> Variables {
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
    pub fn to_named(&self) -> BTreeMap<String, NamedTensor> {
        let convert = |(name, tensor): (&String, &Tensor<f32>)| {
            (name.clone(), NamedTensor { shape: tensor.shape().to_vec(), values: tensor.as_slice().to_vec() })
        };
        self.tensors.iter().map(convert).collect()
    }

    /// The tensors of an artifact.
    pub fn from_named(tensors: &BTreeMap<String, NamedTensor>) -> Self {
        let convert = |(name, tensor): (&String, &NamedTensor)| {
            (name.clone(), Tensor::from_vec(tensor.shape.clone(), tensor.values.clone()))
        };
        Self { tensors: tensors.iter().map(convert).collect() }
    }
}

/// A model's tensors on a tape.
#[derive(Clone, Debug)]
pub struct Variables {
    vars: BTreeMap<String, Var>,
}

impl Variables {
    /// Variables by name.
    pub fn new(vars: BTreeMap<String, Var>) -> Self {
        Self { vars }
    }

    /// The variable of that name; a method asks only for tensors that it made.
    pub fn get(&self, name: &str) -> Var {
        *self.vars.get(name).unwrap_or_else(|| panic!("the model has no tensor {name}"))
    }

    /// The variable of that name, for tensors that a model need not have.
    pub fn find(&self, name: &str) -> Option<Var> {
        self.vars.get(name).copied()
    }

    /// Names and variables in alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, Var)> {
        self.vars.iter().map(|(name, &var)| (name.as_str(), var))
    }
}

/// Whether `name` belongs to `population`, as `gaussians.positions` belongs to `gaussians`: all its tensors have one row
/// per member, and rows come and go together.
pub fn belongs(name: &str, population: &str) -> bool {
    name.strip_prefix(population).is_some_and(|rest| rest.starts_with('.'))
}
