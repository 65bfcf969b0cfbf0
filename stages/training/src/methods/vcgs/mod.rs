//! View-plane constrained Gaussian splatting for one moving camera: a static layer, and 4D surfels on the moving pixels
//! that move perpendicular to the viewing direction.

mod layers;
mod pruning;
mod settings;
mod splats;
mod surfels;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use scene::cloud::PointCloud;
use shaders::pointwise::mul;
use shaders::rasteriser::SplatVars;
use shaders::rasteriser::projection::joined;
use shaders::rasteriser::slicing4d::SlicedVars;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::{MethodFolder, RequiredInput};
use crate::bases::gaussians::{self, AdaptiveDensity, insert_gaussians};
use crate::bases::{primitives4d, seeds};
use crate::data::{SceneFacts, Streams};
use crate::effects::{Effect, Loss};
use crate::method::{Base, Method, Moment, Observed, SILHOUETTE, Start, Step, StepHook};
use crate::model::{ModelState, Variables};
use crate::schedule::{LogLinear, Phase, STATIC};
use crate::shared::{Harmonics, Seeds, Shared};
use layers::{BACKGROUND, FOREGROUND};
use pruning::SurfelPruning;
use settings::{Settings, StaticLayer, Switches};
use splats::{moving, static_layer};

/// The phase that trains the moving layer on the frozen static layer.
const DYNAMIC: &str = "dynamic";

/// VC-GS: a static layer, and 4D surfels that move in the view plane.
pub(crate) struct Vcgs;

impl MethodFolder for Vcgs {
    const NAME: &'static str = "vcgs";
    // Layers have their own schedules of pruning.
    const GROWS_GAUSSIANS: bool = false;
    // Losses and seeds read maps of the images' full size.
    const RENDERS_AT_ANY_SIZE: bool = false;
    const LOSSES: &'static [Loss] = &[SILHOUETTE];
    type Settings = Settings;

    fn shared_defaults() -> Shared {
        Shared {
            iterations: BTreeMap::from([(STATIC.into(), 2000), (DYNAMIC.into(), 3000)]),
            harmonics: Harmonics { degree: 0, ..Harmonics::default() },
            // Training does not move surfels out of the static layer.
            seeds: Seeds { relative_depth: 0.8, ..Seeds::default() },
            ..Shared::default()
        }
    }

    fn effects() -> Vec<Effect> {
        settings::effects()
    }

    // Without depth, only a static layer of Gaussians is left to train.
    fn required_inputs(settings: &Settings) -> Vec<RequiredInput> {
        match settings.background {
            StaticLayer::Surfels => vec![layers::DEPTH, layers::INPAINTED_DEPTH],
            StaticLayer::Gaussians => Vec::new(),
        }
    }

    #[cfg(test)]
    fn tiny_settings() -> Settings {
        Settings { pixel_stride: 3, ..Settings::default() }
    }

    fn build<T: Real>(shared: &Shared, settings: Settings) -> Box<dyn Method<T>> {
        Box::new(ViewPlaneGaussians::new(shared, settings))
    }
}

struct ViewPlaneGaussians {
    shared: Shared,
    settings: Settings,
    switches: Switches,
}

impl ViewPlaneGaussians {
    fn new(shared: &Shared, settings: Settings) -> Self {
        let switches = Switches::new(&shared.effects);
        Self { shared: shared.clone(), settings, switches }
    }

    /// Whether there is a static layer. Without a split, all surfels form one layer: moving with motion, otherwise
    /// static.
    fn has_background(&self) -> bool {
        self.switches.layer_split || !self.switches.motion
    }

    /// Adds the layer that a phase trains.
    fn insert_layer<T: Real>(&self, phase: &str, state: &mut ModelState<T>, start: &Start<'_>) -> anyhow::Result<()> {
        if phase == STATIC && self.has_gaussians() {
            let points = start.initial_points(&self.shared)?;
            insert_gaussians(state, BACKGROUND, &points, 0, start.scene());
            return Ok(());
        }
        if phase == STATIC {
            let surfels = layers::background_surfels(start, &self.settings, &self.switches)?;
            layers::insert_background(state, &surfels);
        } else if self.switches.seeds {
            layers::insert_seeds(state, &seeds::from_masks(start, &self.shared.seeds)?, self.shared.seeds.opacity)?;
        } else {
            let surfels = layers::foreground_surfels(start, &self.settings, &self.switches)?;
            let scene = start.scene();
            layers::insert_foreground(state, &surfels, scene.training_interval(), scene.unit_world);
        }
        Ok(())
    }

    /// Whether the static layer is trained and densified like 3D Gaussian splatting.
    fn has_gaussians(&self) -> bool {
        self.settings.background == StaticLayer::Gaussians
    }

    /// The layers present in a phase, joined with the moving one first.
    fn layers<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        moment: &Moment<'_>,
    ) -> (SplatVars, Option<SlicedVars>) {
        if moment.phase == STATIC {
            return (static_layer(tape, model), None);
        }
        let (moving, sliced) = moving(tape, model, moment, &self.settings, &self.switches);
        let splats = if self.has_background() {
            let static_layer = static_layer(tape, model);
            joined(tape, &moving, &static_layer)
        } else {
            moving
        };
        (splats, Some(sliced))
    }

    /// The photometric loss of the static layer, on the pixels that show only this layer.
    fn static_losses<T: Real>(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        let start = Start { dataset: step.dataset, supplements: step.supplements };
        for view in step.views {
            step.clock.enter("motion");
            let splats = static_layer(step.tape, step.model);
            let rendered = step.render(&splats, None, view, Observed::All(BACKGROUND))?;
            let loaded = step.dataset.training_view(view.index);
            let target = match self.switches.inpainting {
                true => pixels_as_tensor(layers::filled_view(&start, loaded)?.image.as_raw(), &view.image),
                false => view.image.clone(),
            };
            let mut compared = [rendered.color, step.tape.constant(target)];
            if let Some(is_static) = layers::static_pixels(&start, loaded, &self.switches)? {
                let hidden = is_static.iter().filter(|&&on| !on).count();
                step.count_skipped("pixels without static layer", hidden, is_static.len());
                let weight = |&on: &bool| [T::from_f64(f64::from(u8::from(on))); 3];
                let weights = || Tensor::from_vec(view.image.shape(), is_static.iter().flat_map(weight).collect());
                let weights = step.constants.get(step.tape.device(), "static pixels", view.index, weights);
                let weights = step.tape.constant(weights);
                compared = compared.map(|image| mul(step.tape, image, weights));
            }
            let [color, target] = compared;
            match self.switches.inpainting {
                // The inpainted pixels show the static layer, also where something moves in the view.
                true => step.photometric_to(1.0, color, target),
                false => step.photometric_of(1.0, color, target, view),
            }
        }
        Ok(())
    }
}

impl<T: Real> Method<T> for ViewPlaneGaussians {
    fn base(&self) -> &dyn Base<T> {
        self
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        if step.phase == STATIC {
            return self.static_losses(step);
        }
        for view in step.views {
            step.clock.enter("motion");
            let moment = step.moment(view);
            let (splats, sliced) = self.layers(step.tape, step.model, &moment);
            let sliced = sliced.expect("the phase has a moving layer");
            primitives4d::count_skipped(step, "surfels of other times", &sliced);
            let moving = step.tape.value(sliced.present).len();
            let has_silhouette = self.switches.seeds && step.has_silhouette(view);
            let layers = has_silhouette.then(|| moving_rows(step.tape, moving, &splats));
            step.compare_subject(&splats, layers, view, Observed::First(FOREGROUND, moving), 1.0)?;
        }
        Ok(())
    }
}

impl<T: Real> Base<T> for ViewPlaneGaussians {
    fn phases(&self) -> Vec<Phase> {
        let [background, moving] = [STATIC, DYNAMIC].map(|name| self.shared.phase(name));
        let background = self.has_background().then_some(background);
        background.into_iter().chain(self.switches.motion.then_some(moving)).collect()
    }

    fn initialize(&self, start: &Start<'_>, _points: &PointCloud, _random: Streams) -> anyhow::Result<ModelState<T>> {
        let mut state = ModelState::new();
        self.insert_layer(if self.has_background() { STATIC } else { DYNAMIC }, &mut state, start)?;
        Ok(state)
    }

    fn enter_phase(
        &self,
        phase: &str,
        mut state: ModelState<T>,
        start: &Start<'_>,
        _random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        if phase == DYNAMIC && self.has_background() {
            self.insert_layer(DYNAMIC, &mut state, start)?;
        }
        Ok(state)
    }

    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        if phase == STATIC && self.has_gaussians() {
            return gaussians::learning_rate(&self.shared.learning_rates, BACKGROUND, tensor, scene);
        }
        let layer = if phase == STATIC { BACKGROUND } else { FOREGROUND };
        let rates = &self.shared.learning_rates;
        match tensor.strip_prefix(layer)?.strip_prefix('.')? {
            "opacity_logits" => Some(LogLinear::constant(rates.opacity)),
            "log_scales" | "log_scales_time" => Some(LogLinear::constant(rates.scale)),
            "rotations" | "rotations_left" | "rotations_right" => Some(LogLinear::constant(rates.rotation)),
            // Positions, times, thicknesses and colours keep their initial values from the pixels.
            _ => None,
        }
    }

    fn splats(&self, tape: &mut Tape<T>, model: &Variables, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        Ok(self.layers(tape, model, moment).0)
    }

    fn hooks(&self, phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        let Shared { density, schedule_scale, .. } = &self.shared;
        if phase == STATIC && self.has_gaussians() {
            let white = scene.background == [1.0; 3];
            return vec![Box::new(AdaptiveDensity::new(BACKGROUND, density, *schedule_scale, white))];
        }
        let layer = if phase == STATIC { BACKGROUND } else { FOREGROUND };
        vec![Box::new(SurfelPruning::new(layer, &self.settings.pruning, *schedule_scale))]
    }
}

/// [N, 1]: 1 for the first `moving` splats, the moving layer, and 0 for the static layer.
fn moving_rows<T: Real>(tape: &mut Tape<T>, moving: usize, splats: &SplatVars) -> Var {
    let count = tape.value(splats.positions).rows();
    let flag = |row: usize| if row < moving { T::ONE } else { T::ZERO };
    tape.constant(Tensor::from_vec([count, 1], (0..count).map(flag).collect()))
}

/// 8-bit values as a tensor in [0, 1] with the shape of `like`.
fn pixels_as_tensor<T: Real>(pixels: &[u8], like: &Tensor<T>) -> Tensor<T> {
    let values = pixels.iter().map(|&value| T::from_f64(f64::from(value) / 255.0)).collect();
    Tensor::from_vec(like.shape(), values)
}
