//! The methods: one folder each, one line each in [`registry`]. No method imports another.

mod deformable3dgs;
mod deformable4dgs;
mod kineticgs;
mod l4dgs;
mod mcgs;
mod modecgs;
mod phys4dgs;
mod realtime4dgs;
mod scgs;
mod static3dgs;
#[cfg(test)]
mod tests;
mod vcgs;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use shaders::tape::Real;

use crate::coarse::CoarseSharing;
use crate::effects::{Effect, VIEW_DEPENDENT_COLOR};
use crate::method::Method;
use crate::params::{Shared, TrainingParams};

/// Every method, in the order of the tables.
pub fn registry() -> Vec<Registration> {
    vec![
        Registration::of::<static3dgs::Static3dgs>(), //
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
}

/// What a method's folder provides.
pub trait MethodFolder: 'static {
    /// The name in recipes and tables, equal to the folder's.
    const NAME: &'static str;
    /// One line: what it is and whose.
    const ABOUT: &'static str;
    /// The table that only this method understands.
    type Settings: Serialize + DeserializeOwned + Default;

    /// The method's own defaults of what all methods understand.
    fn shared_defaults() -> Shared;

    /// What the method can simulate or leave out, in the order of its README. View-dependent colour is added where the
    /// method's defaults have spherical harmonics.
    fn effects() -> Vec<Effect> {
        Vec::new()
    }

    /// The first phase, if it is one that other methods begin with as well: then one job trains it for all of them.
    fn coarse(_shared: &Shared, _settings: &Self::Settings) -> Option<CoarseSharing> {
        None
    }

    /// Why these settings cannot work, if so.
    fn check(_settings: &Self::Settings) -> Result<(), String> {
        Ok(())
    }

    /// Settings so small that every gradient can be checked by differences.
    #[cfg(test)]
    fn tiny_settings() -> Self::Settings {
        Self::Settings::default()
    }

    /// The method in one precision.
    fn build<T: Real>(shared: &Shared, settings: Self::Settings) -> Box<dyn Method<T>>;
}

/// What a method shares of its first phase, from what all methods understand and its own table.
type Coarse = fn(&Shared, &Value) -> anyhow::Result<Option<CoarseSharing>>;

/// Makes a method from what all methods understand and its own table.
type Build<T> = fn(&Shared, &Value) -> anyhow::Result<Box<dyn Method<T>>>;

/// One method, its types erased.
pub struct Registration {
    /// The name in recipes and tables.
    pub name: &'static str,
    /// One line: what it is and whose.
    pub about: &'static str,
    /// The method's own defaults of what all methods understand.
    pub shared_defaults: fn() -> Shared,
    own_effects: fn() -> Vec<Effect>,
    /// Checks the method's table and fills in its defaults.
    pub canonical_settings: fn(Value) -> anyhow::Result<Value>,
    coarse: Coarse,
    #[cfg(test)]
    tiny_settings: fn() -> Value,
    build_f32: Build<f32>,
    build_f64: Build<f64>,
}

impl Registration {
    fn of<M: MethodFolder>() -> Self {
        Self {
            name: M::NAME,
            about: M::ABOUT,
            shared_defaults: M::shared_defaults,
            own_effects: M::effects,
            canonical_settings: |given| Ok(serde_json::to_value(read_settings::<M>(&given)?)?),
            coarse: |shared, given| Ok(M::coarse(shared, &read_settings::<M>(given)?)),
            #[cfg(test)]
            tiny_settings: || serde_json::to_value(M::tiny_settings()).expect("settings serialise"),
            build_f32: |shared, given| Ok(M::build(shared, read_settings::<M>(given)?)),
            build_f64: |shared, given| Ok(M::build(shared, read_settings::<M>(given)?)),
        }
    }

    /// What the method can simulate or leave out.
    pub fn effects(&self) -> Vec<Effect> {
        let shared = self.has_harmonics().then_some(VIEW_DEPENDENT_COLOR);
        (self.own_effects)().into_iter().chain(shared).collect()
    }

    /// The first phase, if other methods begin with it as well.
    pub fn coarse(&self, params: &TrainingParams) -> anyhow::Result<Option<CoarseSharing>> {
        (self.coarse)(&params.shared, &params.settings)
    }

    /// Whether the method's colours are spherical harmonics.
    pub fn has_harmonics(&self) -> bool {
        (self.shared_defaults)().harmonics.degree > 0
    }

    /// Settings so small that every gradient can be checked by differences.
    #[cfg(test)]
    pub fn tiny(&self) -> Value {
        (self.tiny_settings)()
    }

    /// The method as it trains and renders.
    pub fn build_f32(&self, params: &TrainingParams) -> anyhow::Result<Box<dyn Method<f32>>> {
        (self.build_f32)(&params.shared, &params.settings)
    }

    /// The method as its gradients are checked.
    pub fn build_f64(&self, params: &TrainingParams) -> anyhow::Result<Box<dyn Method<f64>>> {
        (self.build_f64)(&params.shared, &params.settings)
    }
}

fn read_settings<M: MethodFolder>(given: &Value) -> anyhow::Result<M::Settings> {
    let settings = serde_json::from_value(given.clone())?;
    M::check(&settings).map_err(anyhow::Error::msg)?;
    Ok(settings)
}

/// The method of that name; the error lists the registered ones, in serde's words for an unknown name, of which the error
/// of a recipe makes a suggestion.
pub fn find(name: &str) -> Result<Registration, String> {
    let known = || registry().iter().map(|entry| format!("`{}`", entry.name)).collect::<Vec<_>>().join(", ");
    registry().into_iter().find(|entry| entry.name == name).ok_or_else(|| {
        format!("unknown variant `{name}`, expected one of {}", known()) //
    })
}

/// The folders of all other methods: an edit there cannot change what this one trains.
pub fn unused_sources(name: &str) -> Vec<String> {
    registry().iter().filter(|entry| entry.name != name).map(|entry| format!("src/methods/{}", entry.name)).collect()
}
