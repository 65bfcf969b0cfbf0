//! Which semantic losses a step evaluates, with their weights.

use shaders::tape::Real;

use super::super::LanguageGuided;
use super::super::settings::L4dgsSettings;
use super::terms::Term;
use crate::bases::hexplane::FINE;
use crate::method::Step;

/// The loss of equation 3, whose unit is also that of changes of features.
const STATIC_SEMANTICS: &str = "static_semantics";
/// The variance of the depths of all cells, which no loss contains. Its unit is that of changes of depth.
pub(crate) const DEPTH_SPREAD: &str = "spread of depth";

/// The semantic losses that a step evaluates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Due {
    pub static_semantics: Option<Term>,
    pub perceptual_semantics: Option<Term>,
    pub static_depth: Option<Term>,
    pub dynamic_semantics: Option<Term>,
    pub dynamic_depth: Option<Term>,
}

impl Due {
    pub(crate) fn semantics(&self) -> bool {
        self.static_semantics.is_some() || self.dynamic_semantics.is_some()
    }

    pub(crate) fn depth(&self) -> bool {
        self.static_depth.is_some() || self.dynamic_depth.is_some()
    }

    pub(crate) fn dynamics(&self) -> bool {
        self.dynamic_semantics.is_some() || self.dynamic_depth.is_some()
    }
}

impl LanguageGuided {
    /// The semantic losses that this step evaluates, if any.
    pub(super) fn due<T: Real>(&self, step: &Step<'_, T>) -> Option<Due> {
        if step.phase != FINE {
            return None;
        }
        let ramp = self.ramp(step.iteration);
        let Self {
            on, settings: L4dgsSettings { shares, angle, change_angle, interval, dynamic_interval, .. }, ..
        } = self;
        let term = |name, unit, is_on: bool, share: f64, angle: f64, interval: u64| {
            let share = share * ramp * interval as f64;
            (is_on && share > 0.0 && step.iteration.is_multiple_of(interval)).then_some(Term {
                name,
                unit,
                share,
                angle,
            })
        };
        let at_once = |name, is_on, share| term(name, name, is_on, share, *angle, *interval);
        let between = |name, unit, is_on, share| {
            term(name, unit, is_on && step.scene.time_count > 1, share, *change_angle, *dynamic_interval)
        };
        let dynamic_semantics =
            between("dynamic_semantics", STATIC_SEMANTICS, on.dynamic_semantics, shares.dynamic_semantics);
        let static_semantics = at_once(STATIC_SEMANTICS, on.static_semantics, shares.static_semantics);
        let needs_unit = dynamic_semantics.is_some() && step.units.unit(STATIC_SEMANTICS).is_none();
        let unit_of_features = Term { name: STATIC_SEMANTICS, unit: STATIC_SEMANTICS, share: 0.0, angle: *angle };
        let due = Due {
            static_semantics: static_semantics.or(needs_unit.then_some(unit_of_features)),
            perceptual_semantics: at_once("perceptual_semantics", on.perceptual_semantics, shares.perceptual_semantics),
            static_depth: at_once("static_depth", on.static_depth, shares.static_depth),
            dynamic_semantics,
            dynamic_depth: between("dynamic_depth", DEPTH_SPREAD, on.dynamic_depth, shares.dynamic_depth),
        };
        (due.semantics() || due.depth() || due.perceptual_semantics.is_some()).then_some(due)
    }
}
