//! The separate gradient of every loss of a step.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use shaders::arrays::totals::total;
use shaders::pointwise::{scale, square};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::named_loss::NamedLoss;
use crate::model::Variables;

/// Factor on gradients before they are squared: squares of f32 below 1e-19 would underflow.
const SCALE: f64 = (1_u64 << 20) as f64;

/// The losses and the tensors of [`gradient_norms`], in order.
#[derive(Clone, Debug)]
pub(crate) struct NormKeys(Vec<(&'static str, String)>);

impl NormKeys {
    /// The number of norms.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// The squared gradient norms, by loss and tensor, from the values of [`gradient_norms`].
    pub(crate) fn squared_by_loss(
        &self,
        scaled: impl IntoIterator<Item = f64>,
    ) -> BTreeMap<&'static str, Vec<(&str, f64)>> {
        let mut by_loss: BTreeMap<&'static str, Vec<(&str, f64)>> = BTreeMap::new();
        for ((loss, tensor), value) in self.0.iter().zip(scaled) {
            by_loss.entry(loss).or_default().push((tensor, value / (SCALE * SCALE)));
        }
        by_loss
    }
}

/// Differentiates the weighted losses of each name alone with respect to every tensor of the model that they reach.
/// Returns scaled squared norms [1], which may lie on a GPU. No value on the tape changes. `on_pass` gets the time of
/// each pass.
pub(crate) fn gradient_norms<T: Real>(
    tape: &mut Tape<T>,
    losses: &[NamedLoss],
    model: &Variables,
    mut on_pass: impl FnMut(&'static str, Duration),
) -> (NormKeys, Vec<Tensor<T>>) {
    let mut seeds: BTreeMap<&'static str, Vec<(Var, Tensor<T>)>> = BTreeMap::new();
    losses.iter().for_each(|loss| seeds.entry(loss.name).or_default().push(loss.seed(tape)));
    let (mut keys, mut norms) = (Vec::new(), Vec::new());
    for (loss, seeds) in seeds {
        let start = Instant::now();
        let mut gradients = tape.backward(&seeds);
        on_pass(loss, start.elapsed());
        for (tensor, var) in model.iter() {
            let Some(gradient) = gradients.take(var) else { continue };
            keys.push((loss, tensor.to_owned()));
            norms.push(squared_norm(tape.child(), gradient));
        }
    }
    (NormKeys(keys), norms)
}

/// The scaled squared norm of a gradient, computed on a tape that is then dropped.
fn squared_norm<T: Real>(mut child: Tape<T>, gradient: Tensor<T>) -> Tensor<T> {
    let gradient = child.constant(gradient);
    let scaled = scale(&mut child, gradient, SCALE);
    let squared = square(&mut child, scaled);
    let sum = total(&mut child, squared);
    child.value(sum).clone()
}

#[cfg(test)]
mod tests {
    use shaders::check::noise;
    use shaders::pointwise::mul;
    use shaders::tape::Device;

    use super::*;

    /// "near" = 3·Σa², in two parts; "coupled" = 0.5·Σa·b; "faint" = 1e-9·Σb².
    fn losses(tape: &mut Tape<f64>, [a, b]: [Var; 2]) -> Vec<NamedLoss> {
        let [a_squared, b_squared] = [a, b].map(|x| square(tape, x));
        let product = mul(tape, a, b);
        let [near, coupled, faint] = [a_squared, product, b_squared].map(|x| total(tape, x));
        let loss = |name, weight, value| NamedLoss { name, weight, value };
        vec![
            loss("near", 2.0, near),
            loss("coupled", 0.5, coupled),
            loss("near", 1.0, near),
            loss("faint", 1e-9, faint),
        ]
    }

    /// The weighted value of a loss.
    fn value_of(name: &str, values: &[Vec<f64>; 2]) -> f64 {
        let mut tape = Tape::new(Device::Cpu);
        let vars = values.clone().map(|values| tape.leaf(Tensor::from_vec([5], values)));
        let losses = losses(&mut tape, vars);
        let own = losses.iter().filter(|loss| loss.name == name);
        own.map(|loss| loss.weight * tape.value(loss.value).as_slice()[0]).sum()
    }

    /// The squared norm of central differences by one tensor.
    fn squared_differences(name: &str, values: &[Vec<f64>; 2], tensor: usize) -> f64 {
        let difference = |element: usize| {
            let [above, below] = [1e-5, -1e-5].map(|shift| {
                let mut values = values.clone();
                values[tensor][element] += shift;
                value_of(name, &values)
            });
            (above - below) / 2e-5
        };
        (0..5).map(|element| difference(element).powi(2)).sum()
    }

    #[test]
    fn norms_agree_with_central_differences_of_each_loss() {
        let values = [noise(5, 1), noise(5, 2)];
        let mut tape = Tape::new(Device::Cpu);
        let [a, b] = values.clone().map(|values| tape.leaf(Tensor::from_vec([5], values)));
        let losses = losses(&mut tape, [a, b]);
        let model = Variables::new([("a".to_owned(), a), ("b".to_owned(), b)].into());
        let (keys, norms) = gradient_norms(&mut tape, &losses, &model, |_, _| ());
        let found = keys.squared_by_loss(norms.iter().map(|norm| norm.as_slice()[0]));
        let tensors = |loss: &str| found[loss].iter().map(|(tensor, _)| *tensor).collect::<Vec<_>>();
        assert_eq!([tensors("near"), tensors("coupled"), tensors("faint")], [vec!["a"], vec!["a", "b"], vec!["b"]]);
        for (loss, norms) in &found {
            for (tensor, squared) in norms {
                let expected = squared_differences(loss, &values, usize::from(*tensor == "b"));
                assert!((squared / expected - 1.0).abs() <= 1e-6, "{loss} by {tensor}: {squared} for {expected}");
            }
        }
    }
}
