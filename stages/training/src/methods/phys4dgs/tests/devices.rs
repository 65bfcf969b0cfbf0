//! A GPU, which nobody waits for, compares what the CPU compares.

use scene::LabelMap;
use shaders::check::test_gpu;
use shaders::tape::Device;

use super::{Observation, PHYSICS, World};
use crate::methods::phys4dgs::settings::Phys4dgsSettings;

/// How far a loss may be from that of the other device, relative to itself. f32 keeps few digits of second differences of
/// positions, and of third ones of so small motions nothing but their rounding errors.
fn allowed_error(loss: &str) -> f64 {
    match loss {
        "jerk" => f64::INFINITY,
        "temporal" | "acceleration" => 0.05,
        _ => 1e-3,
    }
}

/// What a step in f32 comes to on both devices.
fn on_both_devices(world: &World, effects: &[&str], settings: &Phys4dgsSettings) -> Option<[Observation; 2]> {
    let params = world.phys4dgs(&[&["motion"], effects].concat(), settings);
    let method = crate::methods::find("phys4dgs").unwrap().build_f32(&params.shared, &params.settings).unwrap();
    Some([Device::Cpu, Device::Gpu(test_gpu()?)].map(|device| world.step_on(device, &*method, &params, 3)))
}

#[test]
fn a_gpu_compares_the_same_gaussians() {
    let (world, mut settings) = (World::new(), Phys4dgsSettings::tiny());
    for share in [1.0, 0.4] {
        settings.sample_share = share;
        let Some([expected, found]) = on_both_devices(&world, &PHYSICS, &settings) else { return };
        assert_eq!(found.physics(), expected.physics());
        for (name, loss) in &expected.losses {
            let error = (found.losses[name] - loss).abs();
            assert!(error <= allowed_error(name) * loss, "{name}: {} instead of {loss}", found.losses[name]);
        }
        let background = "physical losses of Gaussians in the background";
        assert_eq!(found.skipped[background], expected.skipped[background]);
        let still = "physical losses of Gaussians that stand still";
        assert_eq!(found.skipped[still][0], expected.skipped[still][0]);
    }
}

#[test]
fn where_nothing_is_compared_a_gpu_has_losses_of_zero() {
    let (mut world, mut settings) = (World::new(), Phys4dgsSettings::tiny());
    let is_nothing = |world: &World, settings: &Phys4dgsSettings| {
        let found = on_both_devices(world, &PHYSICS, settings);
        found.is_none_or(|[_, found]| found.physics().iter().all(|name| found.losses[name] == 0.0))
    };
    assert!(test_gpu().is_none() || !is_nothing(&world, &settings));
    let index = world.dataset.train[3].index;
    let moving = world.supplements.moving[index].replace(LabelMap { width: 16, height: 16, labels: vec![0; 256] });
    assert!(is_nothing(&world, &settings));
    world.supplements.moving[index] = moving;
    settings.field.zero_heads = true;
    assert!(is_nothing(&world, &settings));
}
