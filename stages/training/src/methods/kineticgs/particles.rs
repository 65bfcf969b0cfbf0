//! Particles, i.e. the moving anchors, and their motion (KineticGS equations 10 and 11).
//!
//! A mask on the tape, 1 or 0 each, marks the active particles. The CPU reads it and evaluates the field for the active
//! ones only. A GPU evaluates the field for all particles and multiplies by the mask, because reading it back would
//! stall.

use std::sync::Arc;

use shaders::arrays::rows::{RowIndex, gather, scale_rows, segment_sum};
use shaders::pointwise;
use shaders::pointwise::{add, mul};
use shaders::tape::{Device, Real, Tape, Var};

use super::activation::Windows;
use super::population::Population;
use crate::bases::anchors::{AnchorChange, AnchorDeformation, Anchors};
use crate::bases::gates::straight_through;
use crate::model::Variables;

pointwise! {
    /// 1 where a gate is above the threshold, otherwise 0; a NaN is propagated.
    fn is_open(gate) with(threshold) -> y {
        return select(select(gate, 0.0, gate <= threshold), 1.0, gate > threshold);
    }
    gradients(dy) {
        gate: { return 0.0 * dy; }
    }
}

/// Parameters of particle motion.
pub(crate) struct ParticleMotion {
    /// The deformation field of the particles.
    pub deformation: AnchorDeformation,
    /// Particles are active while their window is above this threshold (θ_g).
    pub gate_threshold: f64,
    /// Whether positions fade in and out with the window like all other attributes, instead of jumping at its borders.
    pub soft_location: bool,
}

/// The particles of a step, as far as they do not depend on time.
pub(crate) struct Particles<T: Real> {
    /// The rows of the particles among the anchors.
    pub population: Arc<Population<T>>,
    /// Canonical positions [P, 3], world.
    pub positions: Var,
    /// Activation windows; `None` if the particles are always active.
    pub windows: Option<Windows>,
    /// The unit in which the deformation field counts displacements ([`SceneFacts::unit_world`]).
    pub unit_world: f64,
}

/// The gates of P particles at one time.
#[derive(Clone, Copy)]
pub(crate) struct Gates {
    /// [P, 1]: the window where it is open, otherwise 0 without a gradient.
    soft: Var,
    /// [P, 1]: 1 where the window is open, otherwise 0; a NaN is propagated. It has no gradient.
    pub active: Var,
}

/// All anchors at one time.
pub(crate) struct Moved {
    /// The anchors with their moved particles.
    pub anchors: Anchors,
    /// [P, 1]: 1 for active particles, otherwise 0; `None` if all are active.
    pub active: Option<Var>,
    /// [P, 3]: displacements of active particles before gating; unspecified for the others. `None` if the host knows
    /// that no particle is active.
    pub displacements: Option<Var>,
}

/// The subset of P particles that is evaluated.
pub(crate) struct Chosen {
    /// Rows of the subset; `None` for all particles.
    some: Option<RowIndex>,
}

impl Chosen {
    /// Selects particles with a nonzero mask [P, 1] if it is on the host; all particles if it is on a GPU or `None`.
    pub(crate) fn by<T: Real>(tape: &Tape<T>, mask: Option<Var>) -> Self {
        let Some(mask) = mask.filter(|_| tape.device() == Device::Cpu) else { return Self { some: None } };
        let mask = tape.value(mask).as_slice();
        let kept: Vec<u32> = (0..mask.len() as u32).filter(|&particle| mask[particle as usize] != T::ZERO).collect();
        Self { some: (kept.len() < mask.len()).then(|| RowIndex::new(kept, mask.len())) }
    }

    /// Whether the subset is empty.
    pub(crate) fn is_empty(&self) -> bool {
        self.some.as_ref().is_some_and(RowIndex::is_empty)
    }

    /// Gathers the subset's rows of x [P, …]: [M, …].
    pub(crate) fn gather<T: Real>(&self, tape: &mut Tape<T>, x: Var) -> Var {
        self.some.as_ref().map_or(x, |some| gather(tape, x, some))
    }

    /// Scatters x [M, …] to all particles, with zeros elsewhere: [P, …].
    fn scatter<T: Real>(&self, tape: &mut Tape<T>, x: Var) -> Var {
        self.some.as_ref().map_or(x, |some| segment_sum(tape, x, some))
    }

    /// The anchor rows of the subset, given those of all particles.
    fn among(&self, anchors: &RowIndex) -> RowIndex {
        let Some(some) = &self.some else { return anchors.clone() };
        let rows = some.row_of_item().iter().map(|&particle| anchors.row_of_item()[particle as usize]);
        RowIndex::new(rows.collect(), anchors.rows())
    }
}

impl ParticleMotion {
    /// The particles of the model's population, with windows if `activation` is on.
    pub(crate) fn particles<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        population: Arc<Population<T>>,
        activation: bool,
        unit_world: f64,
    ) -> Particles<T> {
        let positions = gather(tape, model.get("anchors.positions"), &population.rows);
        let windows = (activation && !population.rows.is_empty()).then(|| {
            let inside = self.deformation.inside(tape, model, positions);
            Windows::of(tape, model, inside)
        });
        Particles { population, positions, windows, unit_world }
    }

    /// The anchors at a time in [0, 1].
    ///
    /// Particles outside their windows keep their canonical state and pass no gradient. Their windows still change
    /// through those of their neighbours, by regularisation and coherence.
    pub(crate) fn at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        particles: &Particles<T>,
        time: f64,
    ) -> Moved {
        let canonical = Anchors::stored(model);
        let gates = self.gates(tape, particles, time);
        let active = gates.map(|gates| gates.active);
        let chosen = Chosen::by(tape, active);
        let anchors = &particles.population.rows;
        if anchors.is_empty() || chosen.is_empty() {
            return Moved { anchors: canonical, active, displacements: None };
        }
        let positions = chosen.gather(tape, particles.positions);
        let change = self.deformation.at(tape, model, positions, time, particles.unit_world);
        let gated = self.through_gates(tape, change, gates, &chosen);
        let rows = chosen.among(anchors);
        let mut moved = |attribute: Var, change: Var| {
            let change = segment_sum(tape, change, &rows);
            add(tape, attribute, change)
        };
        let anchors = Anchors {
            positions: moved(canonical.positions, gated.positions),
            features: moved(canonical.features, gated.features),
            offsets: moved(canonical.offsets, gated.offsets),
            log_scales: moved(canonical.log_scales, gated.log_scales),
        };
        Moved { anchors, active, displacements: Some(chosen.scatter(tape, change.positions)) }
    }

    /// The gates of all particles at a time; `None` if they have no windows.
    pub(crate) fn gates<T: Real>(&self, tape: &mut Tape<T>, particles: &Particles<T>, time: f64) -> Option<Gates> {
        let window = particles.windows?.at(tape, time);
        let active = is_open(tape, window, self.gate_threshold);
        let active = tape.detach(active);
        Some(Gates { soft: mul(tape, window, active), active })
    }

    /// [M, 3]: positions of the chosen particles at a time with these gates.
    pub(crate) fn positions_at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        particles: &Particles<T>,
        (chosen, gates): (&Chosen, Option<Gates>),
        time: f64,
    ) -> Var {
        let canonical = chosen.gather(tape, particles.positions);
        let mut displacements = self.deformation.displacements(tape, model, canonical, time, particles.unit_world);
        if let Some(gates) = gates {
            let gates = chosen.gather(tape, gates.soft);
            let gate = self.location_gate(tape, gates);
            displacements = scale_rows(tape, displacements, gate);
        }
        add(tape, canonical, displacements)
    }

    /// Multiplies changes by the gates of their particles. Positions jump unless `soft_location`, all else changes in
    /// proportion.
    fn through_gates<T: Real>(
        &self,
        tape: &mut Tape<T>,
        change: AnchorChange,
        gates: Option<Gates>,
        chosen: &Chosen,
    ) -> AnchorChange {
        let Some(gates) = gates else { return change };
        let gates = chosen.gather(tape, gates.soft);
        let location_gate = self.location_gate(tape, gates);
        AnchorChange {
            positions: scale_rows(tape, change.positions, location_gate),
            features: scale_rows(tape, change.features, gates),
            offsets: scale_rows(tape, change.offsets, gates),
            log_scales: scale_rows(tape, change.log_scales, gates),
        }
    }

    fn location_gate<T: Real>(&self, tape: &mut Tape<T>, gates: Var) -> Var {
        if self.soft_location { gates } else { straight_through(tape, gates, self.gate_threshold) }
    }
}
