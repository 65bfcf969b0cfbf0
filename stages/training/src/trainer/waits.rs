//! A training does not wait for its GPU: not in any step of any method.

use shaders::check::test_gpu;
use shaders::gpu::readbacks_of_this_thread;

use super::poison::{Scene, all_effects};
use super::*;
use crate::methods::registry;

/// Steps of each phase: the very first of a training is watched.
const STEPS: u64 = 6;

/// By phase: steps that nobody looked at, and readbacks in them.
fn readbacks_ahead(trainer: &mut Trainer) -> BTreeMap<&'static str, [u64; 2]> {
    let mut found: BTreeMap<&'static str, [u64; 2]> = BTreeMap::new();
    while !trainer.is_done() {
        let (phase, ahead, before) =
            (trainer.phases[trainer.phase].name, trainer.steps_ahead(), readbacks_of_this_thread());
        trainer.advance().unwrap_or_else(|error| panic!("{}: {error:#}", trainer.params.method));
        let [steps, readbacks] = found.entry(phase).or_default();
        if trainer.steps_ahead() == ahead + 1 {
            *steps += 1;
            *readbacks += readbacks_of_this_thread() - before;
        }
    }
    found
}

#[test]
fn no_step_of_any_method_waits_for_a_gpu() {
    let Some(gpu) = test_gpu() else { return };
    let scene = Scene::new();
    let mut complaints = Vec::new();
    for entry in registry() {
        let mut params = all_effects(entry.name);
        params.shared.iterations.values_mut().for_each(|steps| *steps = STEPS);
        // Statistics are kept from the first step on; nobody judges by them.
        params.shared.density.from = 0;
        let trainer = Trainer::new(&scene.dataset, &scene.supplements, &params).unwrap();
        for (phase, [steps, readbacks]) in readbacks_ahead(&mut trainer.on(Device::Gpu(gpu))) {
            if steps < STEPS - 3 || readbacks > 0 {
                complaints.push(format!("{} in {phase}: {readbacks} readbacks in {steps} steps", entry.name));
            }
        }
    }
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}
