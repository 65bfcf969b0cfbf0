//! Particles, i.e. the moving anchors, and their motion (KineticGS equations 10 and 11).

use std::sync::Arc;

use shaders::arrays::rows::{gather, scale_rows, segment_sum};
use shaders::pointwise::add;
use shaders::tape::{Real, Tape, Var};

use super::activation::Windows;
use super::population::Population;
use crate::bases::anchors::{AnchorChange, AnchorDeformation, Anchors};
use crate::bases::gates::straight_through;
use crate::data::SceneFacts;
use crate::model::Variables;

/// Parameters of particle motion.
pub(crate) struct ParticleMotion {
    /// The deformation field of the particles.
    pub deformation: AnchorDeformation,
    /// Positions of particles move while their window is above this threshold (θ_g).
    pub gate_threshold: f64,
    /// Whether positions fade in and out with the window like all other attributes, instead of jumping at its borders.
    pub soft_location: bool,
}

/// The particles of a step, as far as they do not depend on time.
pub(crate) struct Particles<'s, T: Real> {
    /// The rows of the particles among the anchors.
    pub population: Arc<Population<T>>,
    /// Canonical positions [P, 3], world.
    pub positions: Var,
    /// Activation windows; `None` if the particles are always active.
    pub windows: Option<Windows>,
    /// The scene that the deformation field belongs to.
    pub scene: &'s SceneFacts,
}

/// All anchors at one time.
pub(crate) struct Moved {
    /// The anchors with their moved particles.
    pub anchors: Anchors,
    /// [P, 3]: displacements of the particles before gating; `None` if there are no particles.
    pub displacements: Option<Var>,
}

impl ParticleMotion {
    /// The particles of the model's population, with windows if `activation` is on.
    pub(crate) fn particles<'s, T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        population: Arc<Population<T>>,
        activation: bool,
        scene: &'s SceneFacts,
    ) -> Particles<'s, T> {
        let positions = gather(tape, model.get("anchors.positions"), &population.rows);
        let windows = (activation && !population.rows.is_empty()).then(|| {
            let inside = self.deformation.inside(tape, model, positions);
            Windows::of(tape, model, inside)
        });
        Particles { population, positions, windows, scene }
    }

    /// The anchors at a time in [0, 1].
    ///
    /// The field is evaluated for every particle, because with a `gate_threshold` above 0, a closed gate passes a gradient to
    /// its window (see [`straight_through`]). With 0, no gate closes.
    pub(crate) fn at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        particles: &Particles<'_, T>,
        time: f64,
    ) -> Moved {
        let canonical = Anchors::stored(model);
        let rows = &particles.population.rows;
        if rows.is_empty() {
            return Moved { anchors: canonical, displacements: None };
        }
        let change = self.deformation.at(tape, model, particles.scene, particles.positions, time);
        let window = particles.windows.map(|windows| windows.at(tape, time));
        let gated = self.through_gates(tape, change, window);
        let mut moved = |attribute: Var, change: Var| {
            let change = segment_sum(tape, change, rows);
            add(tape, attribute, change)
        };
        let anchors = Anchors {
            positions: moved(canonical.positions, gated.positions),
            features: moved(canonical.features, gated.features),
            offsets: moved(canonical.offsets, gated.offsets),
            log_scales: moved(canonical.log_scales, gated.log_scales),
        };
        Moved { anchors, displacements: Some(change.positions) }
    }

    /// [P, 3]: positions of the particles at a time.
    pub(crate) fn positions_at<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        particles: &Particles<'_, T>,
        time: f64,
    ) -> Var {
        let Particles { positions, windows, scene, .. } = *particles;
        let mut displacements = self.deformation.displacements(tape, model, scene, positions, time);
        if let Some(windows) = windows {
            let window = windows.at(tape, time);
            if let Some(gate) = self.location_gate(tape, window) {
                displacements = scale_rows(tape, displacements, gate);
            }
        }
        add(tape, positions, displacements)
    }

    /// Multiplies changes by the gates of their particles. Positions jump unless `soft_location`, all else changes in
    /// proportion to the window [P, 1].
    fn through_gates<T: Real>(&self, tape: &mut Tape<T>, change: AnchorChange, window: Option<Var>) -> AnchorChange {
        let Some(window) = window else { return change };
        let location_gate = self.location_gate(tape, window);
        AnchorChange {
            positions: location_gate.map_or(change.positions, |gate| scale_rows(tape, change.positions, gate)),
            features: scale_rows(tape, change.features, window),
            offsets: scale_rows(tape, change.offsets, window),
            log_scales: scale_rows(tape, change.log_scales, window),
        }
    }

    /// The factor of displacements [P, 1]; `None` if it is 1 for every window, i.e. does not depend on the windows.
    fn location_gate<T: Real>(&self, tape: &mut Tape<T>, window: Var) -> Option<Var> {
        match self.gate_threshold {
            _ if self.soft_location => Some(window),
            0.0 => None,
            threshold => Some(straight_through(tape, window, threshold)),
        }
    }
}
