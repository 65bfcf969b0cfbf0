//! L4DGS: language-guided 4D Gaussian splatting. The Gaussians of the hexplane base carry semantic features that follow
//! a frozen teacher of visual tokens and language. Features and depth are regularised at one instant and between two,
//! weighted by the teacher's attention.

mod birth;
mod lesson;
mod losses;
mod settings;
mod teacher;
#[cfg(test)]
mod tests;
mod tokens;

use anyhow::ensure;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::MethodFolder;
use crate::bases::gaussians::GAUSSIANS;
use crate::bases::hexplane::field::{SPATIAL_SMOOTHNESS, TEMPORAL_SMOOTHNESS, TIME_TO_ONE};
use crate::bases::hexplane::{COARSE, FINE, HexplaneGaussians, HexplaneSettings, MOTION, shared_coarse};
use crate::bases::layers::normal;
use crate::bases::static_mask::{self, SKIP_STILL};
use crate::data::{SceneFacts, Streams, Supplements};
use crate::effects::{Effect, Loss, Need, SEED_FROM_MASKS};
use crate::method::{Base, Language, Method, SILHOUETTE, SharedPhase, Start, Step, StepHook};
use crate::model::{ModelState, Variables, belongs};
use crate::schedule::{LogLinear, Phase, stretch};
use crate::shared::Shared;
use settings::L4dgsSettings;
use teacher::{TEACHER, TEXT, Teacher};

/// Semantic features [N, features] of the Gaussians.
const SEMANTICS: &str = "gaussians.semantics";
/// Standard deviation of the initial semantic features.
const FIRST_SEMANTICS: f64 = 0.01;

/// The effect of prompts on the teacher.
const LANGUAGE: &str = "language";
/// The teacher's loss.
const RECONSTRUCTION: &str = "reconstruction";
/// The reason why `static_depth` is kept even if leaving it out changes nothing.
const DEPTH: &str = "equation 4 of the paper; it is for surfaces that few views see, and where many do, leaving it out changed \
                     nothing (`effects = [\"-static-depth\"]` switches it off)";
/// The reason why `dynamic_depth` is kept even if it is inert.
const DEPTH_CHANGES: &str =
    "equation 8 of the paper; it vanishes where depth hardly changes from one frame to the next";

/// The reason why `attention-focus` is on even if it is inert.
const FOCUS: &str = "w of the paper's equations 3 to 8, which serves the answers to prompts and not PSNR; answers without it \
                     were equally good where that was measured, and `effects = [\"-attention-focus\"]` switches it off";

/// L4DGS: 4DGaussians with semantic features that follow a frozen, language-guided teacher.
pub(crate) struct L4dgs;

impl MethodFolder for L4dgs {
    const NAME: &'static str = "l4dgs";
    // Losses and seeds read maps of the images' full size.
    const RENDERS_AT_ANY_SIZE: bool = false;
    const KERNELS: &'static [&'static str] = &["networks/convolution", "networks/group_norm", "networks/pooling"];
    const LOSSES: &'static [Loss] = &[
        SPATIAL_SMOOTHNESS,
        TEMPORAL_SMOOTHNESS,
        TIME_TO_ONE,
        Loss::always(RECONSTRUCTION),
        Loss::of("dynamic-semantics", "dynamic_semantics"),
        Loss::of("static-semantics", "static_semantics"),
        Loss::of("perceptual-semantics", "perceptual_semantics"),
        Loss::of("dynamic-depth", "dynamic_depth").stays(DEPTH_CHANGES),
        Loss::of("static-depth", "static_depth").stays(DEPTH),
        SILHOUETTE,
    ];
    type Settings = L4dgsSettings;

    fn shared_defaults() -> Shared {
        HexplaneSettings::shared_defaults()
    }

    fn effects() -> Vec<Effect> {
        const CHANGE: &[Need] = &[Need::Effect(MOTION.name), Need::LayersIfWired];
        vec![
            MOTION,
            SKIP_STILL,
            SEED_FROM_MASKS,
            Effect::new(
                "dynamic-semantics",
                "semantic features change as the teacher's tokens do (equations 6, 7)",
                CHANGE,
            ),
            Effect::new("static-semantics", "semantic features follow the teacher's tokens (equation 3)", &[]),
            Effect::new(
                "perceptual-semantics",
                "the teacher's tokens of renders follow those of frames (equation 3 on colours)",
                &[],
            )
            .off_by_default(),
            Effect::new("dynamic-depth", "depth changes little between frames (equation 8)", CHANGE),
            Effect::new(
                "static-depth",
                "depth follows imported depth (equation 4)",
                &[Need::Depth, Need::LayersIfWired],
            ),
            Effect::new("attention-focus", "tokens are weighted by the attention that they receive", &[]).stays(FOCUS),
            Effect::new(LANGUAGE, "prompts modulate the teacher's tokens", &[Need::Features]),
        ]
    }

    fn shared_phases(shared: &Shared, settings: &L4dgsSettings) -> Vec<SharedPhase> {
        let teacher = &settings.teacher;
        let coarse = shared_coarse(shared);
        let taught = SharedPhase {
            phase: TEACHER,
            settings: serde_json::json!({ "teacher": teacher }),
            iterations: coarse.iterations.clone().into_iter().chain([(TEACHER, teacher.iterations)]).collect(),
            effects: &[LANGUAGE],
            losses: &[RECONSTRUCTION],
            ..coarse.clone()
        };
        let taught = EffectsOn::new(shared).teacher.then_some(taught);
        [coarse].into_iter().chain(taught).collect()
    }

    fn idle_loss(settings: &L4dgsSettings, time_count: usize) -> Option<(Loss, String)> {
        settings.hexplane.idle_loss(time_count)
    }

    #[cfg(test)]
    fn tiny_settings() -> L4dgsSettings {
        L4dgsSettings::tiny()
    }

    fn build<T: Real>(shared: &Shared, settings: L4dgsSettings) -> Box<dyn Method<T>> {
        let base = HexplaneGaussians::new(shared, settings.hexplane.clone());
        Box::new(LanguageGuided { base, on: EffectsOn::new(shared), shared: shared.clone(), settings })
    }
}

struct LanguageGuided {
    base: HexplaneGaussians,
    on: EffectsOn,
    shared: Shared,
    settings: L4dgsSettings,
}

/// The active effects.
#[derive(Clone, Copy, Debug)]
struct EffectsOn {
    dynamic_semantics: bool,
    static_semantics: bool,
    perceptual_semantics: bool,
    dynamic_depth: bool,
    static_depth: bool,
    attention_focus: bool,
    language: bool,
    /// Whether any loss reads the teacher's features or attention, or the training ends with the teacher.
    teacher: bool,
}

impl EffectsOn {
    fn new(shared: &Shared) -> Self {
        let on = |name: &str| shared.effects.has(name);
        // Losses on changes need motion.
        let moves = on("motion");
        let effects = Self {
            dynamic_semantics: moves && on("dynamic-semantics"),
            static_semantics: on("static-semantics"),
            perceptual_semantics: on("perceptual-semantics"),
            dynamic_depth: moves && on("dynamic-depth"),
            static_depth: on("static-depth"),
            attention_focus: on("attention-focus"),
            language: on(LANGUAGE),
            teacher: false,
        };
        let attends = effects.attention_focus && effects.depth();
        let teacher = effects.semantics() || effects.perceptual_semantics || attends;
        Self { teacher: teacher || shared.stop_after.as_deref() == Some(TEACHER), ..effects }
    }

    fn semantics(&self) -> bool {
        self.dynamic_semantics || self.static_semantics
    }

    fn depth(&self) -> bool {
        self.dynamic_depth || self.static_depth
    }
}

impl LanguageGuided {
    fn teacher(&self) -> Teacher<'_> {
        Teacher::new(&self.settings.teacher)
    }

    /// Current share of the semantic losses' weight at an iteration of `fine`, in [0, 1].
    fn ramp(&self, iteration: u64) -> f64 {
        let [from, until] = self.settings.ramp.map(|at| stretch(at, self.shared.schedule_scale));
        if iteration >= until {
            return 1.0;
        }
        iteration.saturating_sub(from) as f64 / (until - from) as f64
    }

    /// Adds the teacher for the visual tokens and prompts of the features.
    fn insert_teacher<T: Real>(&self, state: &mut ModelState<T>, start: &Start<'_>, random: Streams) {
        let features = start.supplements.features.as_ref();
        let visual_tokens = features.and_then(|features| features.visual.iter().flatten().next());
        let token_width = visual_tokens.map(|tokens| tokens.shape()[2]);
        let prompts = self.prompts(start.supplements).map(|(_, embeddings)| embeddings);
        self.teacher().insert(state, token_width, prompts, random);
    }

    /// The imported prompts and their embeddings [P, E]; `None` if no effect uses language, and for features without text,
    /// e.g. of DINOv2.
    fn prompts<T: Real>(&self, supplements: &Supplements) -> Option<(Vec<String>, Tensor<T>)> {
        if !self.on.language || !self.on.teacher {
            return None;
        }
        let features = supplements.features.as_ref().filter(|features| !features.prompts.is_empty())?;
        Some((features.prompts.clone(), features.text.cast()))
    }

    /// Refuses a teacher, on the port `start`, of other prompts than those of this training.
    fn check_prompts<T: Real>(&self, state: &ModelState<T>, supplements: &Supplements) -> anyhow::Result<()> {
        let ours = self.prompts::<T>(supplements).map(|(_, embeddings)| embeddings);
        let theirs = state.names().any(|name| name == TEXT).then(|| state.get(TEXT)).transpose()?;
        ensure!(ours.as_ref() == theirs, "the teacher on `start` was trained with other prompts");
        Ok(())
    }

    fn insert_semantics<T: Real>(&self, state: &mut ModelState<T>, random: Streams) -> anyhow::Result<()> {
        let shape = [state.get(&format!("{GAUSSIANS}.positions"))?.rows(), self.settings.teacher.features];
        state.insert(SEMANTICS, normal(&shape, FIRST_SEMANTICS, &mut random.tensor(SEMANTICS)));
        Ok(())
    }
}

impl<T: Real> Method<T> for LanguageGuided {
    fn base(&self) -> &dyn Base<T> {
        &self.base
    }

    /// The base's phases, with the phase `teacher` between them if any loss reads the teacher.
    fn phases(&self) -> Vec<Phase> {
        let iterations = self.settings.teacher.iterations;
        let teacher = self.on.teacher.then_some(Phase { name: TEACHER, iterations });
        let phase = |name| Some(self.shared.phase(name));
        [phase(COARSE), teacher, phase(FINE)].into_iter().flatten().collect()
    }

    fn enter_phase(
        &self,
        phase: &str,
        state: ModelState<T>,
        start: &Start<'_>,
        random: Streams,
    ) -> anyhow::Result<ModelState<T>> {
        let mut state = self.base.enter_phase(phase, state, start, random)?;
        if phase == TEACHER {
            self.insert_teacher(&mut state, start, random);
        }
        if phase == FINE && self.on.teacher {
            self.check_prompts(&state, start.supplements)?;
        }
        if phase == FINE && self.on.semantics() {
            self.insert_semantics(&mut state, random)?;
            self.insert_seed_semantics(&mut state, start)?;
        }
        Ok(state)
    }

    /// `teacher` trains only the teacher, which is frozen afterwards. Prompt embeddings are never trained.
    fn learning_rate(&self, phase: &str, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
        match (phase == TEACHER, belongs(tensor, TEACHER)) {
            (true, true) => (tensor != TEXT).then(|| LogLinear::constant(self.settings.teacher.rate)),
            (false, false) if tensor == SEMANTICS => Some(LogLinear::constant(self.settings.semantic_rate)),
            (false, false) => Method::<T>::base(self).learning_rate(phase, tensor, scene),
            _ => None,
        }
    }

    fn losses(&self, step: &mut Step<'_, T>) -> anyhow::Result<()> {
        if step.phase == TEACHER {
            self.teacher_losses(step);
            return Ok(());
        }
        self.image_losses(step)?;
        static_mask::count_skipped(step);
        self.base.regularize(step);
        Ok(())
    }

    fn hooks(&self, phase: &str, scene: &SceneFacts) -> Vec<Box<dyn StepHook>> {
        if phase == TEACHER { Vec::new() } else { Method::<T>::base(self).hooks(phase, scene) }
    }

    fn language(&self) -> Option<&dyn Language<T>> {
        Some(self)
    }
}

impl<T: Real> Language<T> for LanguageGuided {
    fn semantics(&self, model: &Variables) -> Option<Var> {
        model.find(SEMANTICS)
    }

    fn prompts(&self, model: &Variables) -> Option<Var> {
        model.find(TEXT)
    }

    fn prompt_names(&self, supplements: &Supplements) -> Vec<String> {
        self.prompts::<T>(supplements).map_or_else(Vec::new, |(names, _)| names)
    }

    fn meaning(&self, tape: &mut Tape<T>, model: &Variables, features: Var) -> Option<Var> {
        Teacher::meaning(tape, model, features)
    }
}
