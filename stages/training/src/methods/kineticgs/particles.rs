//! Particles: the anchors that move, and their motion (KineticGS equations 10 and 11).

use shaders::pointwise::add;
use shaders::rows::{RowIndex, gather, scale_rows, segment_sum};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::activation::Windows;
use crate::bases::anchors::{AnchorChange, AnchorDeformation, Anchors};
use crate::bases::gates::straight_through;
use crate::state::Variables;

/// [N, 1]: 1 for particles, 0 for anchors that stand still; absent where all are particles.
pub const DYNAMIC: &str = "anchors.dynamic";

/// How particles move.
pub struct ParticleMotion {
    /// The field that moves them.
    pub deformation: AnchorDeformation,
    /// A particle is active where its window is above this (θ_g).
    pub gate_threshold: f64,
    /// Whether positions fade in and out with the window, as all else does, instead of jumping at its borders.
    pub soft_location: bool,
}

/// The particles of a step: what does not depend on the time.
pub struct Particles {
    /// Which of the N anchors the P particles are.
    pub rows: RowIndex,
    /// [P, 3] canonical, world.
    pub positions: Var,
    /// When they move; `None`: always.
    pub windows: Option<Windows>,
}

/// All anchors at one time.
pub struct Moved {
    /// With the particles where they are.
    pub anchors: Anchors,
    /// The A of P particles that are active.
    pub active: Vec<u32>,
    /// [A, 3] how far the field would move them, before gating; `None` where nothing is active.
    pub displacements: Option<Var>,
}

impl Particles {
    /// [P, 3] canonical positions, world.
    pub fn canonical<T: Real>(&self, tape: &Tape<T>) -> Vec<[f32; 3]> {
        let rows = tape.value(self.positions).as_slice().as_chunks::<3>().0;
        rows.iter().map(|row| row.map(|axis| axis.to_f64() as f32)).collect()
    }
}

impl ParticleMotion {
    /// The particles among the anchors, and their windows if `activation` is on.
    pub fn particles<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, activation: bool) -> Particles {
        let all = model.get("anchors.positions");
        let count = tape.value(all).rows();
        let rows: Vec<u32> = match model.find(DYNAMIC) {
            None => (0..count as u32).collect(),
            Some(dynamic) => {
                let flags = tape.value(dynamic).as_slice();
                (0..count as u32).filter(|&row| flags[row as usize] > T::from_f64(0.5)).collect()
            }
        };
        let rows = RowIndex::new(rows, count);
        let positions = gather(tape, all, &rows);
        let windows = (activation && !rows.is_empty()).then(|| {
            let inside = self.deformation.inside(tape, model, positions);
            Windows::of(tape, model, inside)
        });
        Particles { rows, positions, windows }
    }

    /// The anchors at a time in [0, 1].
    ///
    /// Particles outside their windows are where and what they are canonically, take no part in the field's evaluation and
    /// pass no gradient; their windows move with those of their neighbours, by regularisation and coherence.
    pub fn at<T: Real>(&self, tape: &mut Tape<T>, model: &Variables, particles: &Particles, time: f64) -> Moved {
        let canonical = Anchors::stored(model);
        let gates = particles.windows.map(|windows| windows.at(tape, time));
        let active = self.active(tape, gates, particles.rows.len());
        if active.is_empty() {
            return Moved { anchors: canonical, active, displacements: None };
        }
        let among_particles = RowIndex::new(active.clone(), particles.rows.len());
        let row_of_active = active.iter().map(|&particle| particles.rows.row_of_item()[particle as usize]).collect();
        let among_anchors = RowIndex::new(row_of_active, particles.rows.rows());
        let positions = gather(tape, particles.positions, &among_particles);
        let change = self.deformation.at(tape, model, positions, time);
        let gates = gates.map(|gates| gather(tape, gates, &among_particles));
        let gated = self.through_gates(tape, change, gates);
        let mut moved = |attribute: Var, change: Var| {
            let change = segment_sum(tape, change, &among_anchors);
            add(tape, attribute, change)
        };
        let anchors = Anchors {
            positions: moved(canonical.positions, gated.positions),
            features: moved(canonical.features, gated.features),
            offsets: moved(canonical.offsets, gated.offsets),
            log_scales: moved(canonical.log_scales, gated.log_scales),
        };
        Moved { anchors, active, displacements: Some(change.positions) }
    }

    /// [M, 3] where some particles are at a time; those that are not active are left out of `chosen`.
    pub fn positions_at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        particles: &Particles,
        chosen: &mut Vec<u32>,
        time: f64,
    ) -> Option<Var> {
        let gates = particles.windows.map(|windows| windows.at(tape, time));
        if let Some(gates) = gates {
            let gates = tape.value(gates).as_slice();
            chosen.retain(|&particle| self.is_active(gates[particle as usize]));
        }
        if chosen.is_empty() {
            return None;
        }
        let index = RowIndex::new(chosen.clone(), particles.rows.len());
        let canonical = gather(tape, particles.positions, &index);
        let displacements = self.deformation.displacements(tape, model, canonical, time);
        let displacements = match gates {
            None => displacements,
            Some(gates) => {
                let gates = gather(tape, gates, &index);
                let gate = self.location_gate(tape, gates);
                scale_rows(tape, displacements, gate)
            }
        };
        Some(add(tape, canonical, displacements))
    }

    /// Changes times the gates of their particles: positions move at once, all else in proportion.
    fn through_gates<T: Real>(&self, tape: &mut Tape<T>, change: AnchorChange, gates: Option<Var>) -> AnchorChange {
        let Some(gates) = gates else { return change };
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

    fn active<T: Real>(&self, tape: &Tape<T>, gates: Option<Var>, count: usize) -> Vec<u32> {
        let Some(gates) = gates else { return (0..count as u32).collect() };
        let gates: &Tensor<T> = tape.value(gates);
        (0..count as u32).filter(|&particle| self.is_active(gates.as_slice()[particle as usize])).collect()
    }

    /// Written so that a NaN is active, and found.
    fn is_active<T: Real>(&self, gate: T) -> bool {
        !(gate.to_f64() <= self.gate_threshold)
    }
}
