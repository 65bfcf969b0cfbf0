//! Effects: what costs time beyond a static Gaussian scene, and whether a scene calls for it.
//!
//! A method declares its effects ([`crate::methods::MethodFolder::effects`]). A recipe says `effects = "auto"`, or names
//! some, or changes the automatic choice with `+name` and `-name`. What is off is not read, not allocated, not computed.

mod choice;
mod evidence;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use serde_json::Value;

pub use choice::{Choice, KnownInputs, known_inputs, outcomes};
pub use evidence::{BACKGROUND, CAPTURE, FEATURES, LAYERS, PARTICLES, PRIORS};

/// Colours that depend on the viewpoint: spherical harmonics beyond the constant one. Every method that has any in its
/// defaults has this effect; where it is off, the degree is 0 and nothing is allocated for it.
pub const VIEW_DEPENDENT_COLOR: Effect = Effect {
    name: "view-dependent-color",
    about: "spherical harmonics of degree 1 and more",
    needs: &[Need::ViewDependence],
    by_default: true,
};

/// Something that a method can simulate or leave out.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// As `flow`; the name in recipes and tables.
    pub name: &'static str,
    /// One line: what it does to the model.
    pub about: &'static str,
    /// What a scene must have so that the effect is worth its time; all of it.
    pub needs: &'static [Need],
    /// Whether `"auto"` switches it on where its needs are met.
    pub by_default: bool,
}

/// Evidence that an effect asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// At least so many different training times.
    Times(usize),
    /// Something moves.
    Motion,
    /// Colours depend on the viewpoint.
    ViewDependence,
    /// Depth maps on the port `priors`.
    Depth,
    /// Optical flow on the port `priors`.
    Flow,
    /// Surface normals on the port `priors`.
    Normals,
    /// The seen surface's 3D velocity on the port `priors`.
    Velocity,
    /// Tokens and embeddings on the port `features`.
    Features,
    /// Particles on the port `particles`.
    Particles,
    /// Moving parts on the port `layers`.
    Layers,
    /// A filled static video on the port `background`.
    Background,
    /// Another effect of the method that is on; it must stand before this one in the method's list.
    Effect(&'static str),
}

/// What a recipe says about effects, or what that came to.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Effects {
    /// Not resolved: every effect whose needs are met.
    #[default]
    #[serde(serialize_with = "write_auto")]
    Auto,
    /// These and no others; or, where all begin with `+` or `-`, changes of the automatic choice.
    Named(BTreeSet<String>),
}

impl Effects {
    /// The same choice, as far as it is about these effects.
    pub fn among(&self, effects: &[Effect]) -> Self {
        let Self::Named(names) = self else { return Self::Auto };
        let is_change = |name: &String| name.starts_with(['+', '-']);
        let is_kept = |name: &&String| effects.iter().any(|effect| effect.name == name.trim_start_matches(['+', '-']));
        let kept: BTreeSet<String> = names.iter().filter(is_kept).cloned().collect();
        if kept.is_empty() && names.iter().any(is_change) { Self::Auto } else { Self::Named(kept) }
    }

    /// Whether an effect is on. Before resolution everything is.
    pub fn has(&self, name: &str) -> bool {
        match self {
            Self::Auto => true,
            Self::Named(names) => names.contains(name),
        }
    }
}

/// The word for [`Effects::Auto`].
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
