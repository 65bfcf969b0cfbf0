//! The methods: one folder and one line in [`registry`] each. No method imports another.

mod deformable3dgs;
mod deformable4dgs;
mod kineticgs;
mod l4dgs;
mod mcgs;
mod modecgs;
mod phys4dgs;
mod realtime4dgs;
#[cfg(test)]
mod scale_tests;
mod scgs;
mod static3dgs;
#[cfg(test)]
mod tests;
mod vcgs;

use std::sync::LazyLock;

use anyhow::ensure;
use engine::UnusedSources;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use shaders::tape::Real;

use crate::check::{Checks, Table};
use crate::effects::{
    COARSE_TO_FINE, Effect, Loss, NOTHING_LEFT_OUT, TEMPORAL_PRUNING, VIEW_CONSISTENT_DENSITY, VIEW_DEPENDENT_COLOR,
};
use crate::method::{Method, SharedPhase};
use crate::shared::{Shared, merge};

/// Every method, in the order of the tables.
static METHODS: LazyLock<Vec<Registration>> = LazyLock::new(|| {
    vec![
        Registration::of::<static3dgs::Static3dgs>(),
        Registration::of::<deformable3dgs::Deformable3dgs>(),
        Registration::of::<deformable4dgs::Deformable4dgs>(),
        Registration::of::<l4dgs::L4dgs>(),
        Registration::of::<realtime4dgs::Realtime4dgs>(),
        Registration::of::<phys4dgs::Phys4dgs>(),
        Registration::of::<scgs::Scgs>(),
        Registration::of::<mcgs::Mcgs>(),
        Registration::of::<vcgs::Vcgs>(),
        Registration::of::<modecgs::Modecgs>(),
        Registration::of::<kineticgs::Kineticgs>(),
    ]
});

/// The names of all methods, in the order of the tables.
static NAMES: LazyLock<Vec<&'static str>> = LazyLock::new(|| METHODS.iter().map(|method| method.name).collect());

/// Every registered method, in the order of the tables.
pub(crate) fn registry() -> &'static [Registration] {
    &METHODS
}

/// The entry of a method's folder.
pub(crate) trait MethodFolder: 'static {
    /// The name in recipes and tables, equal to the folder's.
    const NAME: &'static str;
    /// The kernel folders below `shaders/src` that only this method uses, e.g. `losses/histogram`. Editing them does
    /// not rerun other methods. A workspace test derives them from the sources.
    const KERNELS: &'static [&'static str] = &[];
    /// The losses besides the photometric one.
    const LOSSES: &'static [Loss] = &[];
    /// Whether a step can render its views at any size, i.e. offers the effect `coarse-to-fine`.
    const RENDERS_AT_ANY_SIZE: bool = true;
    /// Whether density control adds and removes the Gaussians of the population `gaussians` one by one.
    const GROWS_GAUSSIANS: bool = true;
    /// The method's own table of parameters.
    type Settings: Serialize + DeserializeOwned + Default + Table;

    /// The method's defaults for the tables of all methods.
    fn shared_defaults() -> Shared;

    /// The method's effects, in the order of its README. View-dependent colour is added for methods whose default
    /// colours are spherical harmonics.
    fn effects() -> Vec<Effect> {
        Vec::new()
    }

    /// The phases at whose end a model can be saved for several trainings, in their order.
    fn shared_phases(_shared: &Shared, _settings: &Self::Settings) -> Vec<SharedPhase> {
        Vec::new()
    }

    /// The inputs that trainings with these settings cannot do without.
    fn required_inputs(_settings: &Self::Settings) -> Vec<RequiredInput> {
        Vec::new()
    }

    /// A loss that cannot act in a scene with this number of training times, with the reason.
    fn idle_loss(_settings: &Self::Settings, _time_count: usize) -> Option<(Loss, String)> {
        None
    }

    /// Small settings, for gradient checks by central differences.
    #[cfg(test)]
    fn tiny_settings() -> Self::Settings {
        Self::Settings::default()
    }

    /// Builds the method in one precision.
    fn build<T: Real>(shared: &Shared, settings: Self::Settings) -> Box<dyn Method<T>>;
}

/// An input that a training cannot do without.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RequiredInput {
    /// What the method reads, e.g. `depth`.
    pub what: &'static str,
    /// The port that has it.
    pub port: &'static str,
    /// The fact that is false for an artifact on the port without it.
    pub fact: &'static str,
    /// The effect that reads it; `None` for trainings with any effects.
    pub effect: Option<&'static str>,
    /// What to do if the port does not have it.
    pub hint: &'static str,
}

/// The shared phases of a method, from the tables of all methods and its own table.
type SharedPhases = fn(&Shared, &Value) -> anyhow::Result<Vec<SharedPhase>>;

/// Builds a method from the tables of all methods and its own table.
type Build<T> = fn(&Shared, &Value) -> anyhow::Result<Box<dyn Method<T>>>;

/// A registered method with its types erased.
pub(crate) struct Registration {
    /// The name in recipes and tables.
    pub name: &'static str,
    kernels: &'static [&'static str],
    /// The losses besides the photometric one.
    pub losses: &'static [Loss],
    /// The method's defaults for the tables of all methods.
    pub shared_defaults: fn() -> Shared,
    renders_at_any_size: bool,
    grows_gaussians: bool,
    own_effects: fn() -> Vec<Effect>,
    /// Fills in the defaults of the method's table and checks its values.
    pub canonical_settings: fn(&Value) -> serde_json::Result<(Value, Checks)>,
    shared_phases: SharedPhases,
    required_inputs: fn(&Value) -> Vec<RequiredInput>,
    idle_loss: fn(&Value, usize) -> Option<(Loss, String)>,
    #[cfg(test)]
    tiny_settings: fn() -> Value,
    build_f32: Build<f32>,
    #[cfg(test)]
    build_f64: Build<f64>,
}

impl Registration {
    fn of<M: MethodFolder>() -> Self {
        Self {
            name: M::NAME,
            kernels: M::KERNELS,
            losses: M::LOSSES,
            shared_defaults: M::shared_defaults,
            renders_at_any_size: M::RENDERS_AT_ANY_SIZE,
            grows_gaussians: M::GROWS_GAUSSIANS,
            own_effects: M::effects,
            canonical_settings: |given| {
                let settings = read_settings::<M>(given)?;
                Ok((serde_json::to_value(&settings)?, settings.check()))
            },
            shared_phases: |shared, given| Ok(M::shared_phases(shared, &read_settings::<M>(given)?)),
            required_inputs: |given| {
                read_settings::<M>(given).map_or_else(|_| Vec::new(), |settings| M::required_inputs(&settings))
            },
            idle_loss: |given, time_count| M::idle_loss(&read_settings::<M>(given).ok()?, time_count),
            #[cfg(test)]
            tiny_settings: || serde_json::to_value(M::tiny_settings()).expect("settings serialise"),
            build_f32: build::<M, f32>,
            #[cfg(test)]
            build_f64: build::<M, f64>,
        }
    }

    /// The method's effects. Those that save time come last, because others decide whether they can act.
    pub(crate) fn effects(&self) -> Vec<Effect> {
        let color = self.has_harmonics().then_some(VIEW_DEPENDENT_COLOR);
        let resolution = self.renders_at_any_size.then_some(COARSE_TO_FINE);
        let own = (self.own_effects)();
        let moves = own.iter().any(|effect| effect.name == "motion");
        let pruning = (moves && self.grows_gaussians).then_some(TEMPORAL_PRUNING);
        let density = self.grows_gaussians.then_some(VIEW_CONSISTENT_DENSITY);
        own.into_iter().chain(color).chain(resolution).chain(pruning).chain(density).collect()
    }

    /// The phases at whose end a model can be saved for several trainings, in their order.
    pub(crate) fn shared_phases(&self, shared: &Shared, settings: &Value) -> anyhow::Result<Vec<SharedPhase>> {
        (self.shared_phases)(shared, settings)
    }

    /// The inputs that trainings with these settings cannot do without.
    pub(crate) fn required_inputs(&self, settings: &Value) -> Vec<RequiredInput> {
        (self.required_inputs)(settings)
    }

    /// A loss that cannot act in a scene with this number of training times, with the reason.
    pub(crate) fn idle_loss(&self, settings: &Value, time_count: usize) -> Option<(Loss, String)> {
        (self.idle_loss)(settings, time_count)
    }

    /// Whether the method's colours are spherical harmonics by default.
    pub(crate) fn has_harmonics(&self) -> bool {
        (self.shared_defaults)().harmonics.degree > 0
    }

    /// Small settings, for gradient checks by central differences.
    #[cfg(test)]
    pub(crate) fn tiny(&self) -> Value {
        (self.tiny_settings)()
    }

    /// Builds the method for training and rendering.
    pub(crate) fn build_f32(&self, shared: &Shared, settings: &Value) -> anyhow::Result<Box<dyn Method<f32>>> {
        (self.build_f32)(shared, settings)
    }

    /// Builds the method in f64 for gradient checks.
    #[cfg(test)]
    pub(crate) fn build_f64(&self, shared: &Shared, settings: &Value) -> anyhow::Result<Box<dyn Method<f64>>> {
        (self.build_f64)(shared, settings)
    }
}

/// The settings of a method's table: tables merge over the method's defaults, at any depth.
fn read_settings<M: MethodFolder>(given: &Value) -> serde_json::Result<M::Settings> {
    let defaults = serde_json::to_value(M::Settings::default())?;
    serde_json::from_value(merge(defaults, given.clone()))
}

/// Builds a method, unless its table has problems.
fn build<M: MethodFolder, T: Real>(shared: &Shared, given: &Value) -> anyhow::Result<Box<dyn Method<T>>> {
    let settings = read_settings::<M>(given)?;
    let problems = Checks::default().table(M::NAME, &settings).problems;
    let problems: Vec<String> = problems.iter().map(|problem| format!("{} {}", problem.key, problem.message)).collect();
    ensure!(problems.is_empty(), problems.join("; "));
    Ok(M::build(shared, settings))
}

/// The error for a method name that is not registered.
#[derive(Debug, thiserror::Error)]
#[error("unknown method `{got}`; known methods: {}", known.join(", "))]
pub(crate) struct UnknownName {
    /// The unknown name.
    pub got: String,
    /// All registered names.
    pub known: &'static [&'static str],
}

/// The method with this name.
pub(crate) fn find(name: &str) -> Result<&'static Registration, UnknownName> {
    let found = METHODS.iter().find(|method| method.name == name);
    found.ok_or_else(|| UnknownName { got: name.into(), known: &NAMES })
}

/// The names of all methods, in the order of the tables.
pub(crate) fn names() -> &'static [&'static str] {
    &NAMES
}

/// What a training can leave out: nothing, or an effect or a loss of any method.
pub(crate) fn parts() -> Vec<String> {
    let own_name = |loss: &&Loss| !loss.is_named_like_its_effect();
    let losses = METHODS.iter().flat_map(|method| method.losses.iter().filter(own_name).map(|loss| loss.name));
    let effects = METHODS.iter().flat_map(|method| method.effects().into_iter().map(|effect| effect.name));
    let mut parts: Vec<String> = Vec::new();
    for part in [NOTHING_LEFT_OUT].into_iter().chain(effects).chain(losses) {
        if !parts.iter().any(|known| known == part) {
            parts.push(part.into());
        }
    }
    parts
}

/// The folders and kernels of all other methods. Editing them cannot change the result of this method.
pub(crate) fn unused_sources(name: &str) -> UnusedSources {
    let others = || METHODS.iter().filter(|other| other.name != name);
    let folders = others().map(|other| format!("src/methods/{}", other.name)).collect();
    let kernels = others().flat_map(|other| other.kernels).map(|kernel| format!("src/{kernel}")).collect();
    [("training".to_owned(), folders), ("shaders".to_owned(), kernels)].into()
}
