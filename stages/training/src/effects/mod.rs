//! Effects: the parts of a simulation that cost time beyond a static Gaussian scene, and whether a scene justifies the cost.
//!
//! A method declares its effects. A recipe sets `effects = "auto"`, names some, or changes the automatic choice with
//! `+name` and `-name`. An effect that is off reads no inputs, allocates no tensors and runs no operations.

mod choice;
mod evidence;
mod leave_out;
mod speed;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use serde_json::Value;

pub(crate) use choice::{Choice, KnownInputs, known_inputs, outcomes};
pub(crate) use evidence::{BACKGROUND, CAPTURE, FEATURES, LAYERS, PARTICLES, PRIORS};
pub(crate) use leave_out::{Loss, NOTHING_LEFT_OUT};
#[cfg(test)]
pub(crate) use speed::saves_time;
pub(crate) use speed::{COARSE_TO_FINE, TEMPORAL_PRUNING, VIEW_CONSISTENT_DENSITY};

/// View-dependent colours: spherical harmonics above degree 0. Every method with such harmonics in its defaults has
/// this effect; without it the degree is 0 and no coefficients are allocated.
pub(crate) const VIEW_DEPENDENT_COLOR: Effect =
    Effect::new("view-dependent-color", "spherical harmonics of degree 1 and more", &[Need::ViewDependence])
        .stays(REFLECTIONS);
/// Why `view-dependent-color` is on where it is inert.
const REFLECTIONS: &str = "part of 3D Gaussian Splatting and of all methods on it; it serves surfaces that reflect, and \
                           `effects = [\"-view-dependent-color\"]` switches it off";

/// Gaussians of moving subjects, seeded from the subjects' pixels: offered by every method with motion.
pub(crate) const SEED_FROM_MASKS: Effect = Effect::new(
    "seed-from-masks",
    "Gaussians seeded from the masked pixels of every frame, which the static warm-up does not see",
    &[Need::Layers, Need::Depth, Need::Effect("motion")],
)
.off_by_default();

/// An optional part of a method's simulation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Effect {
    /// The name in recipes and tables, e.g. `flow`.
    pub name: &'static str,
    /// One line: its effect on the model.
    pub about: &'static str,
    /// Properties of the scene that justify the cost of the effect; all are required.
    pub needs: &'static [Need],
    /// Whether `"auto"` enables it when its needs are met.
    pub by_default: bool,
    /// The reason why it is on by default even if it is inert; `None` for an effect that has to act.
    pub stays: Option<&'static str>,
}

impl Effect {
    /// An effect that `"auto"` enables when its needs are met.
    pub(crate) const fn new(name: &'static str, about: &'static str, needs: &'static [Need]) -> Self {
        Self { name, about, needs, by_default: true, stays: None }
    }

    /// The effect, off unless a recipe names it.
    pub(crate) const fn off_by_default(self) -> Self {
        Self { by_default: false, ..self }
    }

    /// The effect with the reason why it is on by default even if it is inert.
    pub(crate) const fn stays(self, reason: &'static str) -> Self {
        Self { stays: Some(reason), ..self }
    }
}

/// A property of the scene or its inputs that an effect requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Need {
    /// At least this many distinct training times.
    Times(usize),
    /// Something moves.
    Motion,
    /// Colours depend on the viewpoint.
    ViewDependence,
    /// Depth maps on the port `priors`.
    Depth,
    /// Optical flow on the port `priors`.
    Flow,
    /// 3D velocity of visible surfaces on the port `priors`.
    Velocity,
    /// Tokens and embeddings on the port `features`.
    Features,
    /// Particles on the port `particles`.
    Particles,
    /// Moving parts on the port `layers`.
    Layers,
    /// Moving parts on the port `layers`, which only the start of a phase reads.
    LayersAtStart,
    /// Moving parts on the port `layers`, if something is wired to it: the effect reads them, but does not depend on them.
    LayersIfWired,
    /// A filled static video on the port `background`.
    Background,
    /// No other effect that compares maps of the images' full size with renders.
    NoMaps,
    /// Another effect of the method, which must precede this one in the method's list.
    Effect(&'static str),
}

/// The effects of a recipe, before or after resolution.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub(crate) enum Effects {
    /// Not resolved: every effect whose needs are met.
    #[default]
    #[serde(serialize_with = "write_auto")]
    Auto,
    /// Exactly these; or, if all begin with `+` or `-`, changes of the automatic choice.
    Named(BTreeSet<String>),
}

impl Effects {
    /// The choice restricted to the given effects.
    pub(crate) fn among(&self, effects: &[Effect]) -> Self {
        let Self::Named(names) = self else { return Self::Auto };
        let is_change = |name: &String| name.starts_with(['+', '-']);
        let is_kept = |name: &&String| effects.iter().any(|effect| effect.name == name.trim_start_matches(['+', '-']));
        let kept: BTreeSet<String> = names.iter().filter(is_kept).cloned().collect();
        if kept.is_empty() && names.iter().any(is_change) { Self::Auto } else { Self::Named(kept) }
    }

    /// Whether an effect is on; before resolution, every effect is.
    pub(crate) fn has(&self, name: &str) -> bool {
        match self {
            Self::Auto => true,
            Self::Named(names) => names.contains(name),
        }
    }
}

/// The value of [`Effects::Auto`] in recipes.
const AUTO: &str = "auto";

fn write_auto<S: Serializer>(serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(AUTO)
}

impl<'de> Deserialize<'de> for Effects {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        let names = || BTreeSet::deserialize(&value).ok();
        match value.as_str() {
            Some(AUTO) => Ok(Self::Auto),
            _ => names().map(Self::Named).ok_or_else(|| {
                de::Error::custom(format!("effects must be \"auto\" or a list of names, not {value}")) //
            }),
        }
    }
}
