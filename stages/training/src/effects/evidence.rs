//! Evidence for the needs of effects, from the static facts of a scene.

use engine::Facts;
use scene::facts;

use super::Need;

/// The port of the capture.
pub(crate) const CAPTURE: &str = "capture";
/// The port of depth, flow, normals and velocity.
pub(crate) const PRIORS: &str = "priors";
/// The port of tokens and embeddings.
pub(crate) const FEATURES: &str = "features";
/// The port of particles.
pub(crate) const PARTICLES: &str = "particles";
/// The port of moving parts.
pub(crate) const LAYERS: &str = "layers";
/// The port of the static video.
pub(crate) const BACKGROUND: &str = "background";

/// The optional inputs that effects read.
pub(crate) const SUPPLEMENTS: [&str; 5] = [PRIORS, FEATURES, PARTICLES, LAYERS, BACKGROUND];

/// Whether a need is met, with the reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Evidence {
    /// The need is met.
    Met(String),
    /// Unknown until the data is read; counts as met.
    Unknown(String),
    /// The scene does not justify the effect, which could still be simulated.
    Idle(String),
    /// An input of the effect is missing.
    Missing(String),
}

impl Need {
    /// The port whose facts decide the need; `None` for a need of another effect.
    pub(crate) fn port(self) -> Option<&'static str> {
        match self {
            Self::Times(_) | Self::Motion | Self::ViewDependence => Some(CAPTURE),
            Self::Depth | Self::Flow | Self::Velocity => Some(PRIORS),
            Self::Features => Some(FEATURES),
            Self::Particles => Some(PARTICLES),
            Self::Layers | Self::LayersAtStart | Self::LayersIfWired => Some(LAYERS),
            Self::Background => Some(BACKGROUND),
            Self::NoMaps | Self::Effect(_) => None,
        }
    }

    /// Whether an effect with this need may be off because of it.
    pub(super) fn decides(self) -> bool {
        self != Self::LayersIfWired
    }

    /// Whether an effect with this need compares maps of the images' full size with renders.
    pub(super) fn reads_maps(self) -> bool {
        matches!(self, Self::Depth | Self::Flow | Self::Velocity | Self::Features | Self::Layers | Self::Background)
    }

    /// The evidence for the need in `facts_on`, the facts of the artifact on a port (`None` for a port that is not
    /// wired). A need that concerns other effects counts as met here.
    pub(super) fn evidence<'a>(self, facts_on: impl Fn(&str) -> Option<&'a Facts>) -> Evidence {
        let port = self.port().unwrap_or(CAPTURE);
        let known = facts_on(port);
        let flag = |name: &str| known.and_then(|known| known.flag(name));
        match self {
            Self::Times(needed) => times(known.and_then(|known| known.count(facts::TIMES)), needed),
            Self::Motion => scene_has(flag(facts::MOVING), "motion", "something moves", "nothing moves"),
            Self::ViewDependence => scene_has(
                flag(facts::VIEW_DEPENDENT),
                "view dependence",
                "colours depend on the view",
                "colours do not depend on the view",
            ),
            Self::NoMaps | Self::Effect(_) => Evidence::Met(String::new()),
            _ if known.is_none() => Evidence::Missing(format!("nothing is wired to `{port}`")),
            Self::Depth => input_has(flag(facts::DEPTH), port, "depth"),
            Self::Flow => input_has(flag(facts::FLOW), port, "flow"),
            Self::Velocity => input_has(flag(facts::VELOCITY), port, "velocity"),
            Self::Features
            | Self::Particles
            | Self::Layers
            | Self::LayersAtStart
            | Self::LayersIfWired
            | Self::Background => Evidence::Met(format!("`{port}` is wired")),
        }
    }
}

fn times(known: Option<u64>, needed: usize) -> Evidence {
    match known {
        None => Evidence::Unknown("number of times not known before import".into()),
        Some(times) if times >= needed as u64 => Evidence::Met(format!("{times} times")),
        Some(1) => Evidence::Idle(format!("1 time where {needed} are needed")),
        Some(times) => Evidence::Idle(format!("{times} times where {needed} are needed")),
    }
}

fn scene_has(known: Option<bool>, what: &str, yes: &str, no: &str) -> Evidence {
    match known {
        None => Evidence::Unknown(format!("{what} not known before import")),
        Some(true) => Evidence::Met(yes.into()),
        Some(false) => Evidence::Idle(no.into()),
    }
}

fn input_has(known: Option<bool>, port: &str, what: &str) -> Evidence {
    match known {
        None => Evidence::Unknown(format!("{what} on `{port}` not known before import")),
        Some(true) => Evidence::Met(format!("`{port}` has {what}")),
        Some(false) => Evidence::Missing(format!("`{port}` has no {what}")),
    }
}
