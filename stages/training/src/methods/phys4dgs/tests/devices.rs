//! A GPU evaluates the same physical losses as the CPU, without synchronization.

use scene::LabelMap;
use shaders::check::test_gpu;
use shaders::tape::Device;

use super::{Observation, PHYSICS, World};
use crate::methods::phys4dgs::settings::Phys4dgsSettings;

/// Largest relative difference of a loss between the devices. In f32, second differences of positions keep few digits,
/// and third differences of motion this small are pure rounding error.
fn allowed_error(loss: &str) -> f64 {
    match loss {
        "jerk" => f64::INFINITY,
        "temporal" | "acceleration" => 0.05,
        _ => 1e-3,
    }
}

/// The results of one f32 step on the CPU and on the GPU.
fn on_both_devices(world: &World, effects: &[&str], settings: &Phys4dgsSettings) -> Option<[Observation; 2]> {
    let params = world.phys4dgs(&[&["motion"], effects].concat(), settings);
    let method = crate::methods::find("phys4dgs").unwrap().build_f32(&params.shared, &params.settings).unwrap();
    Some([Device::Cpu, Device::Gpu(test_gpu()?)].map(|device| world.step_on(device, &*method, &params, 3)))
}

#[test]
fn gpu_losses_and_counts_agree_with_the_cpu() {
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
        // Observations may set still Gaussians in motion, so only a step without them skips these.
        let Some([expected, found]) = on_both_devices(&world, &["velocity", "foreground"], &settings) else { return };
        let still = "physical losses of static Gaussians";
        assert_eq!(found.skipped[still][0], expected.skipped[still][0]);
    }
}

#[test]
fn gpu_losses_without_moving_gaussians_are_zero() {
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
    world.supplements.priors.clear(); // An observation would start motion.
    settings.field.zero_heads = true;
    assert!(is_nothing(&world, &settings));
}
