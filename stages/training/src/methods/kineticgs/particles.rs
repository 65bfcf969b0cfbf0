//! Particles: the anchors that move, and their motion (KineticGS equations 10 and 11).
//!
//! Which of them are active is a mask on the tape, 1 or 0 each. The CPU looks at it and evaluates the field for those alone;
//! a GPU evaluates it for all and lets the mask decide what counts, because the host would have to wait for it.

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
    /// 1 where a gate is above the threshold, else 0; a NaN is kept, and shows.
    fn is_open(gate) with(threshold) -> y {
        return select(select(gate, 0.0, gate <= threshold), 1.0, gate > threshold);
    }
    gradients(dy) {
        gate: { return 0.0 * dy; }
    }
}

/// How particles move.
pub(crate) struct ParticleMotion {
    /// The field that moves them.
    pub deformation: AnchorDeformation,
    /// A particle is active where its window is above this (θ_g).
    pub gate_threshold: f64,
    /// Whether positions fade in and out with the window, as all else does, instead of jumping at its borders.
    pub soft_location: bool,
}

/// The particles of a step: what does not depend on the time.
pub(crate) struct Particles<T: Real> {
    /// Which anchors they are.
    pub population: Arc<Population<T>>,
    /// [P, 3] canonical, world.
    pub positions: Var,
    /// When they move; `None`: always.
    pub windows: Option<Windows>,
}

/// The gates of P particles at one time.
#[derive(Clone, Copy)]
pub(crate) struct Gates {
    /// [P, 1] the window where it is open; 0, without a gradient, where it is not.
    soft: Var,
    /// [P, 1] 1 where it is open, else 0; a NaN is kept, and shows. No gradient flows through it.
    pub active: Var,
}

/// All anchors at one time.
pub(crate) struct Moved {
    /// With the particles where they are.
    pub anchors: Anchors,
    /// [P, 1] 1 for particles that are active, else 0; `None`: all are.
    pub active: Option<Var>,
    /// [P, 3] how far the field would move those that are active, before gating, and anything for others; `None` where the
    /// host knows that nothing is active.
    pub displacements: Option<Var>,
}

/// Which of P particles are computed with.
pub(crate) struct Chosen {
    /// `None`: all.
    some: Option<RowIndex>,
}

impl Chosen {
    /// Those whose mask [P, 1] is not 0, if it is on the host; all where it is on a GPU, or where there is none.
    pub(crate) fn by<T: Real>(tape: &Tape<T>, mask: Option<Var>) -> Self {
        let Some(mask) = mask.filter(|_| tape.device() == Device::Cpu) else { return Self { some: None } };
        let mask = tape.value(mask).as_slice();
        let kept: Vec<u32> = (0..mask.len() as u32).filter(|&particle| mask[particle as usize] != T::ZERO).collect();
        Self { some: (kept.len() < mask.len()).then(|| RowIndex::new(kept, mask.len())) }
    }

    /// Whether nothing is.
    pub(crate) fn is_empty(&self) -> bool {
        self.some.as_ref().is_some_and(RowIndex::is_empty)
    }

    /// Their rows of x [P, …]: [M, …].
    pub(crate) fn gather<T: Real>(&self, tape: &mut Tape<T>, x: Var) -> Var {
        self.some.as_ref().map_or(x, |some| gather(tape, x, some))
    }

    /// x [M, …] among all particles, zeros elsewhere: [P, …].
    fn scatter<T: Real>(&self, tape: &mut Tape<T>, x: Var) -> Var {
        self.some.as_ref().map_or(x, |some| segment_sum(tape, x, some))
    }

    /// Which anchors they are, where the particles are these.
    fn among(&self, anchors: &RowIndex) -> RowIndex {
        let Some(some) = &self.some else { return anchors.clone() };
        let rows = some.row_of_item().iter().map(|&particle| anchors.row_of_item()[particle as usize]);
        RowIndex::new(rows.collect(), anchors.rows())
    }
}

impl ParticleMotion {
    /// The particles of a population, and their windows if `activation` is on.
    pub(crate) fn particles<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        population: Arc<Population<T>>,
        activation: bool,
    ) -> Particles<T> {
        let positions = gather(tape, model.get("anchors.positions"), &population.rows);
        let windows = (activation && !population.rows.is_empty()).then(|| {
            let inside = self.deformation.inside(tape, model, positions);
            Windows::of(tape, model, inside)
        });
        Particles { population, positions, windows }
    }

    /// The anchors at a time in [0, 1].
    ///
    /// Particles outside their windows are where and what they are canonically and pass no gradient; their windows move with
    /// those of their neighbours, by regularisation and coherence.
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
        let change = self.deformation.at(tape, model, positions, time);
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

    /// The gates of all particles at a time; `None` where they have no windows.
    pub(crate) fn gates<T: Real>(&self, tape: &mut Tape<T>, particles: &Particles<T>, time: f64) -> Option<Gates> {
        let window = particles.windows?.at(tape, time);
        let active = is_open(tape, window, self.gate_threshold);
        let active = tape.detach(active);
        Some(Gates { soft: mul(tape, window, active), active })
    }

    /// [M, 3] where chosen particles are at a time at which these are their gates.
    pub(crate) fn positions_at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        particles: &Particles<T>,
        (chosen, gates): (&Chosen, Option<Gates>),
        time: f64,
    ) -> Var {
        let canonical = chosen.gather(tape, particles.positions);
        let mut displacements = self.deformation.displacements(tape, model, canonical, time);
        if let Some(gates) = gates {
            let gates = chosen.gather(tape, gates.soft);
            let gate = self.location_gate(tape, gates);
            displacements = scale_rows(tape, displacements, gate);
        }
        add(tape, canonical, displacements)
    }

    /// Changes times the gates of their particles: positions move at once, all else in proportion.
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
