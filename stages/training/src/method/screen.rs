//! Screen-space statistics of a population in the renders of a step: gradients, visibility and radii.

use std::cell::OnceCell;

use shaders::rasteriser::screen::{self, PopulationRender, StepGradient};
use shaders::tape::{Gradients, Tape, Tensor};

use super::step::{ParentVars, RenderRecord};

/// The renders of one step that show a population. Statistics of single Gaussians are read back from a GPU only if a
/// hook requests them on the host.
pub(crate) struct ScreenStats<'a> {
    /// The population's name, e.g. `gaussians`.
    pub population: &'a str,
    renders: Vec<&'a RenderRecord>,
    /// The tape of the renders and the gradients of the step.
    step: Option<(&'a Tape<f32>, &'a Gradients<f32>)>,
    by_view: OnceCell<Vec<ScreenGradients>>,
    on_host: OnceCell<ScreenGradients>,
    parents: Vec<Parents>,
}

/// Values of one render about the N parents of a population's rows, evaluated from [`ParentVars`].
#[derive(Clone, Debug)]
pub(crate) struct Parents {
    /// [N, 1]: 1 where the parent lies in the view, otherwise 0.
    pub in_view: Tensor<f32>,
    /// [N, 1]: the sum of the opacities of the parent's splats.
    pub opacity: Tensor<f32>,
}

/// Screen-space gradient, visibility and radius of each Gaussian of a population in one or more renders of a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ScreenGradients {
    /// [N, 2] gradient of the loss with respect to the projected mean, normalised device coordinates, summed over the
    /// renders.
    pub gradient_ndc: Vec<[f32; 2]>,
    /// [N] whether the Gaussian is visible in any render.
    pub visible: Vec<bool>,
    /// [N] largest radius in pixels.
    pub radius_px: Vec<f32>,
}

impl<'a> ScreenStats<'a> {
    /// Groups the renders of a step by population, in the order in which the populations were first rendered.
    pub(crate) fn by_population(
        renders: &'a [RenderRecord],
        tape: &'a Tape<f32>,
        gradients: &'a Gradients<f32>,
    ) -> Vec<Self> {
        let mut populations: Vec<Self> = Vec::new();
        for render in renders {
            match populations.iter_mut().find(|stats| stats.population == render.population) {
                Some(stats) => stats.renders.push(render),
                None => populations.push(Self {
                    population: &render.population,
                    renders: vec![render],
                    step: Some((tape, gradients)),
                    by_view: OnceCell::new(),
                    on_host: OnceCell::new(),
                    parents: Vec::new(),
                }),
            }
        }
        for stats in &mut populations {
            stats.parents = stats.renders.iter().filter_map(|render| render.parents(tape)).collect();
        }
        populations
    }

    /// Statistics of a population from given values in one render.
    #[cfg(test)]
    pub(crate) fn of(population: &'a str, values: ScreenGradients) -> Self {
        Self::of_views(population, vec![values])
    }

    /// Statistics of a population from given values in each render.
    #[cfg(test)]
    pub(crate) fn of_views(population: &'a str, views: Vec<ScreenGradients>) -> Self {
        let (by_view, on_host, parents) = (views.into(), OnceCell::new(), Vec::new());
        Self { population, renders: Vec::new(), step: None, by_view, on_host, parents }
    }

    /// Adds one render's values of the parents.
    #[cfg(test)]
    pub(crate) fn with_parents(self, parents: Parents) -> Self {
        Self { parents: vec![parents], ..self }
    }

    /// The values of the rows' parents, one item per render; empty for a population without parents.
    pub(crate) fn parents(&self) -> &[Parents] {
        &self.parents
    }

    /// The values of every Gaussian in each render, read back from a GPU if necessary.
    pub(crate) fn by_view(&self) -> &[ScreenGradients] {
        self.by_view.get_or_init(|| {
            let Some((tape, gradients)) = self.step else { return Vec::new() };
            self.renders.iter().map(|render| ScreenGradients::of(render, tape, gradients)).collect()
        })
    }

    /// The values of every Gaussian in all renders together, read back from a GPU if necessary.
    pub(crate) fn on_host(&self) -> &ScreenGradients {
        match self.by_view() {
            [only] => only,
            views => self.on_host.get_or_init(|| views.iter().fold(ScreenGradients::default(), ScreenGradients::join)),
        }
    }

    /// Adds this step to the statistics of every Gaussian ([`screen::observe`]) on the GPU that rendered it; `None` for
    /// renders on the CPU.
    pub(crate) fn observe_on_gpu(&self, gradient: StepGradient, statistics: &Tensor<f32>) -> Option<Tensor<f32>> {
        let (tape, gradients) = self.step?;
        let of_render = |render: &&'a RenderRecord| PopulationRender {
            rendered: &render.rendered,
            size_px: render.size_px,
            row_of_splat: render.row_of_splat(),
        };
        let renders: Vec<PopulationRender> = self.renders.iter().map(of_render).collect();
        screen::observe(tape, gradients, &renders, gradient, statistics)
    }

    /// The number of Gaussians.
    pub(crate) fn rows(&self) -> usize {
        self.renders.first().map_or_else(|| self.on_host().visible.len(), |render| render.count)
    }
}

impl RenderRecord {
    /// The row of each of the first splats; `None`: all rows in order.
    fn row_of_splat(&self) -> Option<&[u32]> {
        Some(self.rows.as_ref()?.row_of_splat.as_ref()?.as_slice())
    }

    fn parents(&self, tape: &Tape<f32>) -> Option<Parents> {
        let ParentVars { in_view, opacity } = self.rows.as_ref()?.parents;
        let value = |var| tape.value(var).clone();
        Some(Parents { in_view: value(in_view), opacity: value(opacity) })
    }
}

impl ScreenGradients {
    /// The values of one render. A pixel is 2 / size in normalised device coordinates.
    fn of(render: &RenderRecord, tape: &Tape<f32>, gradients: &Gradients<f32>) -> Self {
        let count = render.count;
        let mut values = Self::default();
        values.resize(count);
        let [half_width, half_height] = render.size_px.map(|size| 0.5 * size);
        let (visible, radius_px) = (render.rendered.visible(), render.rendered.radii_px(tape));
        let gradient_px = gradients.get(render.rendered.means2d);
        for splat in (0..visible.len()).filter(|&splat| visible[splat]) {
            let first = (splat < count).then_some(splat);
            let Some(at) = render.row_of_splat().map_or(first, |rows| rows.get(splat).map(|&row| row as usize)) else {
                continue;
            };
            values.visible[at] = true;
            values.radius_px[at] = radius_px[splat];
            let Some(gradient) = gradient_px else { continue };
            let row = gradient.row(splat);
            let [x, y] = [f64::from(row[0]) * half_width, f64::from(row[1]) * half_height];
            values.gradient_ndc[at] = [x as f32, y as f32];
        }
        values
    }

    /// Both: sums gradients, joins visibility, keeps the larger radius.
    fn join(mut self, other: &Self) -> Self {
        self.resize(other.visible.len());
        for at in 0..other.visible.len() {
            let ([x, y], [of_x, of_y]) = (self.gradient_ndc[at], other.gradient_ndc[at]);
            self.gradient_ndc[at] = [x + of_x, y + of_y];
            self.visible[at] |= other.visible[at];
            self.radius_px[at] = self.radius_px[at].max(other.radius_px[at]);
        }
        self
    }

    fn resize(&mut self, count: usize) {
        self.gradient_ndc.resize(count, [0.0; 2]);
        self.visible.resize(count, false);
        self.radius_px.resize(count, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use shaders::geometry::camera::PinholeCamera;
    use shaders::rasteriser::{RasterSettings, SplatTensors, render};
    use shaders::tape::Device;

    use super::*;
    use crate::method::step::SplatRows;

    /// Two splats in an image of 20 × 10 pixels, of which only the first is visible, with the gradient of the sum of
    /// its colours. They are the rows `rows` of `count`, each its own parent; with `None`, they are all rows.
    fn step(rows: Option<&[u32]>, count: usize, times: usize) -> (Tape<f32>, Vec<RenderRecord>, Gradients<f32>) {
        let splats = SplatTensors {
            positions: Tensor::from_vec([2, 3], vec![0.3, 0.2, 4.0, 0.0, 0.0, -4.0]),
            log_scales: Tensor::full([2, 3], -1.0),
            rotations: Tensor::from_vec([2, 4], [[1.0, 0.0, 0.0, 0.0]; 2].concat()),
            opacity_logits: Tensor::from_vec([2, 1], vec![0.0, 1.0]),
            sh: Tensor::full([2, 1, 3], 0.5),
        };
        let camera = PinholeCamera {
            width: 20,
            height: 10,
            focal: [20.0, 20.0],
            center: [10.0, 5.0],
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        };
        let mut tape = Tape::new(Device::Cpu);
        let vars = splats.leaves(&mut tape);
        let settings = RasterSettings { sh_degree: 0, ..RasterSettings::default() };
        let rendered = render(&mut tape, &vars, None, &camera, &settings).unwrap();
        let seed = (0..600).map(|at| at as f32 / 600.0).collect();
        let gradients = tape.backward(&[(rendered.color, Tensor::from_vec([10, 20, 3], seed))]);
        let [in_view, opacity] = [1.0, 0.5].map(|value| tape.constant(Tensor::full([count, 1], value)));
        let parents = ParentVars { in_view, opacity };
        let rows = rows.map(|rows| Some(Arc::new(rows.to_vec())));
        let rows = rows.map(|row_of_splat| SplatRows { population: "points", count, row_of_splat, parents });
        let watched = || RenderRecord {
            population: "points".into(),
            rendered: rendered.clone(),
            size_px: [20.0, 10.0],
            count,
            rows: rows.clone(),
        };
        let renders = (0..times).map(|_| watched()).collect();
        (tape, renders, gradients)
    }

    #[test]
    fn splats_default_to_the_rows_in_order() {
        let (tape, renders, gradients) = step(None, 2, 1);
        let screens = ScreenStats::by_population(&renders, &tape, &gradients);
        let (screen, gradient) = (screens[0].on_host(), gradients.get(renders[0].rendered.means2d).unwrap());
        assert_eq!((screens.len(), screens[0].rows(), &screen.visible), (1, 2, &vec![true, false]));
        assert_eq!(screen.gradient_ndc[0], [10.0 * gradient.row(0)[0], 5.0 * gradient.row(0)[1]]);
        assert!(screen.gradient_ndc[0].iter().all(|value| *value != 0.0) && screen.gradient_ndc[1] == [0.0; 2]);
        assert!(screen.radius_px[0] > 3.0 && screen.radius_px[1] == 0.0);
        assert!(screens[0].parents().is_empty());
    }

    #[test]
    fn splats_are_added_to_their_rows() {
        let (tape, renders, gradients) = step(Some(&[2, 0]), 3, 2);
        let screens = ScreenStats::by_population(&renders, &tape, &gradients);
        let (screen, one) = (screens[0].on_host(), step(None, 2, 1));
        let single = ScreenStats::by_population(&one.1, &one.0, &one.2).remove(0);
        assert_eq!(screen.visible, [false, false, true]);
        assert_eq!(screen.gradient_ndc[2], single.on_host().gradient_ndc[0].map(|value| 2.0 * value));
        assert_eq!(screen.radius_px[2], single.on_host().radius_px[0]);
        let looks: Vec<[f32; 2]> =
            screens[0].parents().iter().map(|of| [&of.in_view, &of.opacity].map(|x| x.row(2)[0])).collect();
        assert_eq!(looks, [[1.0, 0.5]; 2]);
    }

    #[test]
    fn splats_beyond_the_rows_are_ignored() {
        let (tape, renders, gradients) = step(None, 1, 1);
        let (screens, all) = (ScreenStats::by_population(&renders, &tape, &gradients), step(None, 2, 1));
        let all = ScreenStats::by_population(&all.1, &all.0, &all.2).remove(0);
        assert_eq!((screens[0].rows(), screens[0].on_host().visible.len()), (1, 1));
        assert_eq!(screens[0].on_host().gradient_ndc[0], all.on_host().gradient_ndc[0]);
    }
}
