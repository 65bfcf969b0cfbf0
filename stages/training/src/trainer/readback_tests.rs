//! Speculative steps of every method run without readbacks.

use shaders::check::test_gpu;
use shaders::gpu::readbacks_of_this_thread;

use std::collections::BTreeMap;

use super::poison_tests::{Scene, all_effects};
use super::*;
use crate::effects::Effects;
use crate::methods::registry;

/// Steps of each phase; the very first one of a training is checked.
const STEPS: u64 = 6;
/// Steps in which `l4dgs` measures the units of its losses.
const MEASURING_STEPS: u64 = 8;

/// Number of speculative steps and of readbacks in them, by phase, without the steps that measure the unit of a loss.
fn speculative_readbacks(trainer: &mut Trainer) -> BTreeMap<&'static str, [u64; 2]> {
    let mut found: BTreeMap<&'static str, [u64; 2]> = BTreeMap::new();
    while !trainer.is_done() {
        let (phase, pending, before) = (trainer.phase_name(), trainer.pending_steps(), readbacks_of_this_thread());
        let units = trainer.state.units.clone();
        trainer.advance().unwrap_or_else(|error| panic!("{}: {error:#}", trainer.setup.params.method));
        let [steps, readbacks] = found.entry(phase).or_default();
        if trainer.pending_steps() == pending + 1 && trainer.state.units == units {
            *steps += 1;
            *readbacks += readbacks_of_this_thread() - before;
        }
    }
    found
}

#[test]
fn speculative_steps_of_every_method_read_nothing_back() {
    let Some(gpu) = test_gpu() else { return };
    let scene = Scene::new();
    let mut complaints = Vec::new();
    // Without inpainting, as in the recipes for videos, the static layer of `vcgs` is compared with other images.
    let mut not_inpainted = all_effects("vcgs");
    if let Effects::Named(names) = &mut not_inpainted.shared.effects {
        names.retain(|name| name != "inpainting");
    }
    for mut params in registry().iter().map(|entry| all_effects(entry.name)).chain([not_inpainted]) {
        let method = params.method.clone();
        params.shared.iterations.values_mut().for_each(|steps| *steps = STEPS);
        if method == "l4dgs" {
            params.shared.iterations.insert("fine".into(), MEASURING_STEPS + STEPS);
        }
        // Statistics are collected from the first step on, but no hook reads them within these steps.
        params.shared.density.from = 0;
        let trainer = Trainer::new(&scene.dataset, &scene.supplements, &params).unwrap();
        for (phase, [steps, readbacks]) in speculative_readbacks(&mut trainer.on(Device::Gpu(gpu))) {
            if steps < STEPS - 3 || readbacks > 0 {
                complaints.push(format!("{method} in {phase}: {readbacks} readbacks in {steps} steps"));
            }
        }
    }
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}
