//! What the renders of a step say about the Gaussians of a population.

use std::cell::OnceCell;

use shaders::rasteriser::screen::{self, PopulationRender};
use shaders::tape::{Gradients, Tape, Tensor};

use crate::step::{OwnerVars, WatchedRender};

/// The renders of one step that show a population; whoever looks at the figures of single Gaussians waits for them.
pub struct Screen<'a> {
    /// As `gaussians`.
    pub population: &'a str,
    renders: Vec<&'a WatchedRender>,
    /// Where they were computed.
    step: Option<(&'a Tape<f32>, &'a Gradients<f32>)>,
    on_host: OnceCell<ScreenGradients>,
    owners: Vec<Owners>,
}

/// What a render says about the N owners of a population: the values of [`OwnerVars`].
#[derive(Clone, Debug)]
pub struct Owners {
    /// [N, 1].
    pub in_view: Tensor<f32>,
    /// [N, 1].
    pub opacity: Tensor<f32>,
}

/// What one step's renders say about the Gaussians of a population.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScreenGradients {
    /// [N, 2] gradient of the loss by the projected mean, normalised device coordinates, summed over the renders.
    pub gradient_ndc: Vec<[f32; 2]>,
    /// [N] whether any render saw the Gaussian.
    pub visible: Vec<bool>,
    /// [N] largest radius in pixels.
    pub radius_px: Vec<f32>,
}

impl<'a> Screen<'a> {
    /// The renders by population, in the order in which populations were rendered first.
    pub(crate) fn all(renders: &'a [WatchedRender], tape: &'a Tape<f32>, gradients: &'a Gradients<f32>) -> Vec<Self> {
        let mut screens: Vec<Self> = Vec::new();
        for render in renders {
            match screens.iter_mut().find(|screen| screen.population == render.population) {
                Some(screen) => screen.renders.push(render),
                None => screens.push(Self {
                    population: &render.population,
                    renders: vec![render],
                    step: Some((tape, gradients)),
                    on_host: OnceCell::new(),
                    owners: Vec::new(),
                }),
            }
        }
        for screen in &mut screens {
            screen.owners = screen.renders.iter().filter_map(|render| render.owners(tape)).collect();
        }
        screens
    }

    /// Figures that are known already.
    #[cfg(test)]
    pub(crate) fn of(population: &'a str, figures: ScreenGradients) -> Self {
        Self { population, renders: Vec::new(), step: None, on_host: figures.into(), owners: Vec::new() }
    }

    /// The same with what a render says about the owners of the rows.
    #[cfg(test)]
    pub(crate) fn owned_by(self, owners: Owners) -> Self {
        Self { owners: vec![owners], ..self }
    }

    /// What every render says about the owners of the rows, if something owns them.
    pub fn owners(&self) -> &[Owners] {
        &self.owners
    }

    /// The figures of every Gaussian; read back from a GPU.
    pub fn on_host(&self) -> &ScreenGradients {
        self.on_host.get_or_init(|| {
            let mut figures = ScreenGradients::default();
            if let Some((tape, gradients)) = self.step {
                self.renders.iter().for_each(|render| figures.add(render, tape, gradients));
            }
            figures
        })
    }

    /// Statistics of every Gaussian ([`screen::observe`]) with this step, added up on the GPU that rendered; `None` if
    /// none did.
    pub fn observe_on_gpu(&self, statistics: &Tensor<f32>) -> Option<Tensor<f32>> {
        let (tape, gradients) = self.step?;
        let of_render = |render: &&'a WatchedRender| PopulationRender {
            rendered: &render.rendered,
            size_px: render.size_px,
            row_of_splat: render.row_of_splat(),
        };
        let renders: Vec<PopulationRender> = self.renders.iter().map(of_render).collect();
        screen::observe(tape, gradients, &renders, statistics)
    }

    /// The number of Gaussians.
    pub fn rows(&self) -> usize {
        self.renders.first().map_or_else(|| self.on_host().visible.len(), |render| render.count)
    }
}

impl WatchedRender {
    /// The rows that the first splats are; `None`: all in order.
    fn row_of_splat(&self) -> Option<&[u32]> {
        Some(self.rows.as_ref()?.row_of_splat.as_ref()?.as_slice())
    }

    fn owners(&self, tape: &Tape<f32>) -> Option<Owners> {
        let OwnerVars { in_view, opacity } = self.rows.as_ref()?.owners;
        let value = |var| tape.value(var).clone();
        Some(Owners { in_view: value(in_view), opacity: value(opacity) })
    }
}

impl ScreenGradients {
    /// Adds one render: gradients are summed, visibility joined, the larger radius kept. A pixel is 2 / size of the
    /// normalised device coordinates.
    fn add(&mut self, render: &WatchedRender, tape: &Tape<f32>, gradients: &Gradients<f32>) {
        let count = render.count;
        self.gradient_ndc.resize(count, [0.0; 2]);
        self.visible.resize(count, false);
        self.radius_px.resize(count, 0.0);
        let [half_width, half_height] = render.size_px.map(|size| 0.5 * size);
        let (visible, radius_px) = (render.rendered.visible(), render.rendered.radii_px(tape));
        let gradient_px = gradients.get(render.rendered.means2d);
        for splat in (0..visible.len()).filter(|&splat| visible[splat]) {
            let first = (splat < count).then_some(splat);
            let Some(at) = render.row_of_splat().map_or(first, |rows| rows.get(splat).map(|&row| row as usize)) else {
                continue;
            };
            self.visible[at] = true;
            self.radius_px[at] = self.radius_px[at].max(radius_px[splat]);
            let Some(gradient) = gradient_px else { continue };
            let row = gradient.row(splat);
            self.gradient_ndc[at][0] += (f64::from(row[0]) * half_width) as f32;
            self.gradient_ndc[at][1] += (f64::from(row[1]) * half_height) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use shaders::geometry::camera::PinholeCamera;
    use shaders::rasteriser::{RasterSettings, SplatTensors, render};
    use shaders::tape::Device;

    use super::*;
    use crate::step::SplatRows;

    /// Two splats in an image of 20 × 10 pixels, of which only the first is visible; with the gradient of the sum of
    /// its colours. They are these of so many rows, each of an owner of its own; or all rows.
    fn step(rows: Option<&[u32]>, count: usize, times: usize) -> (Tape<f32>, Vec<WatchedRender>, Gradients<f32>) {
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
        let owners = OwnerVars { in_view, opacity };
        let rows = rows.map(|rows| Some(Arc::new(rows.to_vec())));
        let rows = rows.map(|row_of_splat| SplatRows { population: "points", count, row_of_splat, owners });
        let watched = || WatchedRender {
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
    fn splats_that_are_the_rows_count_in_order() {
        let (tape, renders, gradients) = step(None, 2, 1);
        let screens = Screen::all(&renders, &tape, &gradients);
        let (screen, gradient) = (screens[0].on_host(), gradients.get(renders[0].rendered.means2d).unwrap());
        assert_eq!((screens.len(), screens[0].rows(), &screen.visible), (1, 2, &vec![true, false]));
        assert_eq!(screen.gradient_ndc[0], [10.0 * gradient.row(0)[0], 5.0 * gradient.row(0)[1]]);
        assert!(screen.gradient_ndc[0].iter().all(|value| *value != 0.0) && screen.gradient_ndc[1] == [0.0; 2]);
        assert!(screen.radius_px[0] > 3.0 && screen.radius_px[1] == 0.0);
        assert!(screens[0].owners().is_empty());
    }

    #[test]
    fn splats_count_for_the_rows_that_they_are() {
        let (tape, renders, gradients) = step(Some(&[2, 0]), 3, 2);
        let screens = Screen::all(&renders, &tape, &gradients);
        let (screen, one) = (screens[0].on_host(), step(None, 2, 1));
        let single = Screen::all(&one.1, &one.0, &one.2).remove(0);
        assert_eq!(screen.visible, [false, false, true]);
        assert_eq!(screen.gradient_ndc[2], single.on_host().gradient_ndc[0].map(|value| 2.0 * value));
        assert_eq!(screen.radius_px[2], single.on_host().radius_px[0]);
        let looks: Vec<[f32; 2]> =
            screens[0].owners().iter().map(|of| [&of.in_view, &of.opacity].map(|x| x.row(2)[0])).collect();
        assert_eq!(looks, [[1.0, 0.5]; 2]);
    }

    #[test]
    fn splats_behind_the_rows_count_for_none() {
        let (tape, renders, gradients) = step(None, 1, 1);
        let (screens, all) = (Screen::all(&renders, &tape, &gradients), step(None, 2, 1));
        let all = Screen::all(&all.1, &all.0, &all.2).remove(0);
        assert_eq!((screens[0].rows(), screens[0].on_host().visible.len()), (1, 1));
        assert_eq!(screens[0].on_host().gradient_ndc[0], all.on_host().gradient_ndc[0]);
    }
}
