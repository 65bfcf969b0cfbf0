//! Leaves out one effect or one loss, to measure its contribution.

use std::collections::BTreeSet;

use engine::{Decision, ParamProblem};

use super::{Choice, Effect, Effects, KnownInputs, Need};

/// The value of the parameter `without` for a whole training.
pub(crate) const NOTHING_LEFT_OUT: &str = "nothing";

/// A loss that a method adds to the photometric one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Loss {
    /// The name, e.g. `static_semantics`.
    pub name: &'static str,
    /// The effect that it belongs to; none for a loss that every training of the method has.
    pub effect: Option<&'static str>,
    /// The reason why it is kept even if it is inert; `None` for a loss that has to act.
    pub stays: Option<&'static str>,
}

impl Loss {
    /// A loss of an effect.
    pub(crate) const fn of(effect: &'static str, name: &'static str) -> Self {
        Self { name, effect: Some(effect), stays: None }
    }

    /// A loss of every training.
    pub(crate) const fn always(name: &'static str) -> Self {
        Self { name, effect: None, stays: None }
    }

    /// The loss with the reason why it is kept even if it is inert.
    pub(crate) const fn stays(self, reason: &'static str) -> Self {
        Self { stays: Some(reason), ..self }
    }

    /// Whether its effect has the same name, so leaving out either is the same.
    pub(crate) fn is_named_like_its_effect(&self) -> bool {
        self.effect.is_some_and(|effect| effect.replace('-', "_") == self.name)
    }
}

impl Choice {
    /// Whether a loss acts in a training with this choice.
    pub(crate) fn has_loss(&self, loss: &Loss) -> bool {
        loss.effect.is_none_or(|effect| self.on.contains(effect))
    }

    /// The choice without one of its effects and those that need it.
    pub(crate) fn without(
        self,
        left_out: &str,
        effects: &[Effect],
        known: &KnownInputs<'_>,
    ) -> Result<Self, Vec<ParamProblem>> {
        let mut off = BTreeSet::from([left_out]);
        // Effects come after those that they need.
        for effect in effects {
            let needs_it = |need: &Need| matches!(need, Need::Effect(name) if off.contains(name));
            if effect.needs.iter().any(needs_it) {
                off.insert(effect.name);
            }
        }
        let kept = self.on.iter().filter(|name| !off.contains(name.as_str())).cloned().collect();
        let lesser = Effects::Named(kept).choose(effects, known)?;
        let reason = |decision: Decision| match decision.on && off.contains(decision.effect.as_str()) {
            true if decision.effect == left_out => Decision { on: false, reason: "left out".into(), ..decision },
            true => Decision { on: false, reason: format!("{left_out} is left out"), ..decision },
            false => decision,
        };
        Ok(Self { decisions: self.decisions.into_iter().map(reason).collect(), ..lesser })
    }
}
