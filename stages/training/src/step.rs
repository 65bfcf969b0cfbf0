//! One forward and backward pass, in any precision.

use std::collections::BTreeMap;

use shaders::tape::{Gradients, Real, Tensor, first_elements};

use crate::method::{Method, NamedLoss, ScreenGradients, SkippedWork, SplatRows, Step, WatchedRender};

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
    step.clock.enter("backward");
    let seed = |loss: &NamedLoss| {
        let shape = step.tape.value(loss.value).shape().to_vec();
        (loss.value, Tensor::full(shape, T::from_f64(loss.weight)))
    };
    let seeds: Vec<_> = step.losses.iter().map(seed).collect();
    let gradients = step.tape.backward(&seeds);
    // Looked at last: a GPU has the backward pass by then, and goes on meanwhile.
    let values: Vec<&Tensor<T>> = step.losses.iter().map(|loss| step.tape.value(loss.value)).collect();
    let mut losses = BTreeMap::new();
    for (NamedLoss { name, weight, .. }, value) in step.losses.iter().zip(first_elements(&values)) {
        *losses.entry(*name).or_default() += weight * value.to_f64();
    }
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
                screens.push(ScreenGradients::empty(&render.population, render));
                screens.len() - 1
            });
            screens[at].add(render, self.gradients.get(render.means2d));
        }
        screens
    }
}

impl ScreenGradients {
    fn empty(population: &str, render: &WatchedRender) -> Self {
        let (count, of_rows) = match &render.rows {
            None => (render.visible.len(), 0),
            Some((rows, _)) => (rows.looked_at.len(), rows.looked_at.len()),
        };
        Self {
            population: population.into(),
            gradient_ndc: vec![[0.0; 2]; count],
            visible: vec![false; count],
            radius_px: vec![0.0; count],
            opacity: vec![0.0; of_rows],
            looks: vec![0; of_rows],
        }
    }

    /// Adds one render: gradients are summed, visibility joined, the larger radius kept. A pixel is 2 / size of the
    /// normalised device coordinates.
    fn add<T: Real>(&mut self, render: &WatchedRender, gradient_px: Option<&Tensor<T>>) {
        let [half_width, half_height] = render.size_px.map(|size| 0.5 * size);
        for splat in (0..render.visible.len()).filter(|&splat| render.visible[splat]) {
            let row_of = |(rows, _): &(SplatRows, _)| rows.row_of_splat.get(splat).map(|&row| row as usize);
            let Some(at) = render.rows.as_ref().map_or(Some(splat), row_of) else { continue };
            self.visible[at] = true;
            self.radius_px[at] = self.radius_px[at].max(render.radius_px[splat]);
            let Some(gradient) = gradient_px else { continue };
            let row = gradient.row(splat);
            self.gradient_ndc[at][0] += (row[0].to_f64() * half_width) as f32;
            self.gradient_ndc[at][1] += (row[1].to_f64() * half_height) as f32;
        }
        if let Some((rows, opacities)) = &render.rows {
            let drawn = rows.row_of_splat.iter().zip(opacities);
            drawn.for_each(|(&row, &opacity)| self.opacity[row as usize] += opacity);
            self.looks.iter_mut().zip(&rows.looked_at).for_each(|(looks, &now)| *looks += u32::from(now));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use shaders::tape::{Device, Tape};

    use super::*;
    use crate::method::SplatRows;

    /// A render of two splats in an image of 20 × 10 pixels, of which only the first is visible.
    fn render(rows: Option<(SplatRows, Vec<f32>)>) -> (WatchedRender, Tensor<f64>) {
        let means2d = Tape::<f64>::new(Device::Cpu).constant(Tensor::zeros([2, 2]));
        let (visible, radius_px, size_px) = (vec![true, false], vec![3.0, 5.0], [20.0, 10.0]);
        let render = WatchedRender { population: "points".into(), means2d, visible, radius_px, size_px, rows };
        (render, Tensor::from_vec([2, 2], vec![0.1, 0.2, 7.0, 7.0]))
    }

    #[test]
    fn splats_count_for_the_rows_that_they_are() {
        let row_of_splat = Arc::new(vec![2, 0]);
        let rows = SplatRows { population: "points", row_of_splat, looked_at: vec![true, false, true] };
        let (render, gradient) = render(Some((rows, vec![0.25, 0.5])));
        let mut screen = ScreenGradients::empty("points", &render);
        screen.add(&render, Some(&gradient));
        screen.add(&render, Some(&gradient));
        assert_eq!(screen.visible, [false, false, true]);
        assert_eq!(screen.gradient_ndc, [[0.0; 2], [0.0; 2], [2.0, 2.0]]);
        assert_eq!(screen.radius_px, [0.0, 0.0, 3.0]);
        assert_eq!((screen.opacity, screen.looks), (vec![1.0, 0.0, 0.5], vec![2, 0, 2]));
    }

    #[test]
    fn splats_that_are_the_rows_count_in_order() {
        let (render, gradient) = render(None);
        let mut screen = ScreenGradients::empty("points", &render);
        screen.add(&render, Some(&gradient));
        assert_eq!((screen.visible, screen.gradient_ndc), (vec![true, false], vec![[1.0, 1.0], [0.0; 2]]));
        assert!(screen.opacity.is_empty() && screen.looks.is_empty());
    }
}
