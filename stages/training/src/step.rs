//! One forward and backward pass, in any precision.

use std::collections::BTreeMap;

use shaders::tape::{Gradients, Real, Tensor};

use crate::method::{Method, NamedLoss, ScreenGradients, SkippedWork, Step, WatchedRender};

/// What a step computed: its losses, its gradients and what its renders saw.
pub struct StepOutcome<T: Real> {
    /// Weighted losses by name, summed over views.
    pub losses: BTreeMap<&'static str, f64>,
    /// Gradients of the sum of the weighted losses by everything on the tape.
    pub gradients: Gradients<T>,
    /// What the step left out.
    pub skipped: SkippedWork,
    renders: Vec<WatchedRender>,
}

/// Evaluates a method's losses on a step and differentiates their sum.
pub fn run_step<T: Real>(method: &dyn Method<T>, mut step: Step<'_, T>) -> anyhow::Result<StepOutcome<T>> {
    method.losses(&mut step)?;
    let mut losses = BTreeMap::new();
    for NamedLoss { name, weight, value } in &step.losses {
        *losses.entry(*name).or_default() += weight * step.tape.value(*value).as_slice()[0].to_f64();
    }
    step.clock.enter("backward");
    let seed = |loss: &NamedLoss| {
        let shape = step.tape.value(loss.value).shape().to_vec();
        (loss.value, Tensor::full(shape, T::from_f64(loss.weight)))
    };
    let seeds: Vec<_> = step.losses.iter().map(seed).collect();
    let gradients = step.tape.backward(&seeds);
    Ok(StepOutcome { losses, gradients, skipped: step.skipped, renders: step.renders })
}

impl<T: Real> StepOutcome<T> {
    /// The sum of the weighted losses.
    pub fn total(&self) -> f64 {
        self.losses.values().sum()
    }

    /// What the renders say about each population, in normalised device coordinates.
    pub fn screen_gradients(&self) -> Vec<ScreenGradients> {
        let mut screens: Vec<ScreenGradients> = Vec::new();
        for render in &self.renders {
            let at = screens.iter().position(|screen| screen.population == render.population);
            let at = at.unwrap_or_else(|| {
                screens.push(ScreenGradients::empty(&render.population, render.visible.len()));
                screens.len() - 1
            });
            screens[at].add(render, self.gradients.get(render.means2d));
        }
        screens
    }
}

impl ScreenGradients {
    fn empty(population: &str, count: usize) -> Self {
        Self {
            population: population.into(),
            gradient_ndc: vec![[0.0; 2]; count],
            visible: vec![false; count],
            radius_px: vec![0.0; count],
        }
    }

    /// Adds one render: gradients are summed, visibility joined, the larger radius kept. A pixel is 2 / size of the
    /// normalised device coordinates.
    fn add<T: Real>(&mut self, render: &WatchedRender, gradient_px: Option<&Tensor<T>>) {
        let [half_width, half_height] = render.size_px.map(|size| 0.5 * size);
        for at in (0..self.visible.len()).filter(|&at| render.visible[at]) {
            self.visible[at] = true;
            self.radius_px[at] = self.radius_px[at].max(render.radius_px[at]);
            let Some(gradient) = gradient_px else { continue };
            let row = gradient.row(at);
            self.gradient_ndc[at][0] += (row[0].to_f64() * half_width) as f32;
            self.gradient_ndc[at][1] += (row[1].to_f64() * half_height) as f32;
        }
    }
}
