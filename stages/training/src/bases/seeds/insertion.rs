//! Adds seeds to the population of Gaussians of a model.

use glam::DVec3;
use scene::PointCloud;
use shaders::tape::{Real, Tensor};

use super::lifetimes::SEED_VELOCITIES;
use super::points::{Seed, from_masks};
use crate::bases::bounds::Bounds;
use crate::bases::gaussians::{GAUSSIANS, insert_gaussians, logit};
use crate::bases::primitives4d::insert_moving;
use crate::data::SceneFacts;
use crate::method::{SEED_LIVES, Start, is_seed};
use crate::model::{ModelState, belongs};
use crate::shared::Shared;

/// Adds the seeds after the Gaussians of a model, if any, with the flag `may_move` [N, 1]. Attributes that only the
/// method knows are 0. A model without Gaussians remains one if there are no seeds, because an empty population cannot be
/// trained.
pub(crate) fn insert<T: Real>(
    state: &mut ModelState<T>,
    shared: &Shared,
    start: &Start<'_>,
    may_move: &str,
) -> anyhow::Result<()> {
    let seeds = from_masks(start, &shared.seeds)?;
    if seeds.is_empty() && state.get("gaussians.positions").is_err() {
        return Ok(());
    }
    let mut added = as_gaussians(&seeds, shared, start.scene());
    let mut insert = |name: &str, of_seed: &dyn Fn(&Seed) -> Vec<f64>, columns: usize| {
        let values = seeds.iter().flat_map(of_seed).map(T::from_f64).collect();
        added.insert(name, Tensor::from_vec([seeds.len(), columns], values));
    };
    insert(SEED_LIVES, &|seed| seed.life.times.to_vec(), 5);
    insert(SEED_VELOCITIES, &|seed| seed.velocities.iter().flat_map(DVec3::to_array).collect(), 6);
    insert(may_move, &|_| vec![1.0], 1);
    append(state, &added)
}

/// Extends the box of the field of this name to the seeds of the model. Outside its box, a field repeats its border
/// values, and the box encloses points of structure from motion, which may have none near the subject.
pub(crate) fn extend_box<T: Real>(state: &mut ModelState<T>, field: &str) -> anyhow::Result<()> {
    let Ok(lives) = state.get(SEED_LIVES) else { return Ok(()) };
    let positions = state.get("gaussians.positions")?;
    let position = |row: usize| [0, 1, 2].map(|axis| positions.row(row)[axis].to_f64() as f32);
    let lives = lives.as_slice().as_chunks::<5>().0;
    let seeds: Vec<[f32; 3]> = (0..lives.len()).filter(|&row| is_seed(&lives[row])).map(position).collect();
    if !seeds.is_empty() {
        Bounds::stored(state, field)?.joined(&Bounds::around(&seeds)).insert(state, field);
    }
    Ok(())
}

/// Adds the seeds after the Gaussians of a model in space and time; a clip has `units_per_clip` units of time.
pub(crate) fn insert_in_space_time<T: Real>(
    state: &mut ModelState<T>,
    shared: &Shared,
    start: &Start<'_>,
    units_per_clip: f64,
) -> anyhow::Result<()> {
    let seeds = from_masks(start, &shared.seeds)?;
    let mut of_space = as_gaussians(&seeds, shared, start.scene());
    let lives: Vec<_> = seeds.iter().map(|seed| seed.in_space_time(units_per_clip, DVec3::ZERO)).collect();
    insert_moving(&mut of_space, GAUSSIANS, &lives);
    let mut added = ModelState::new();
    let kept = of_space.into_iter().filter(|(name, _)| !name.ends_with(".rotations"));
    kept.for_each(|(name, tensor)| added.insert(name, tensor));
    append(state, &added)
}

/// Appends rows to every tensor of the population, which may be empty; rows of a tensor that only one of the two has are 0.
fn append<T: Real>(state: &mut ModelState<T>, added: &ModelState<T>) -> anyhow::Result<()> {
    let before = state.get("gaussians.positions").map_or(0, Tensor::rows);
    let more = added.get("gaussians.positions")?.rows();
    let all = state.names().chain(added.names()).filter(|name| belongs(name, GAUSSIANS));
    let names: std::collections::BTreeSet<String> = all.map(String::from).collect();
    for name in names {
        let row = state.get(&name).or_else(|_| added.get(&name))?.shape()[1..].to_vec();
        let columns: usize = row.iter().product();
        let mut values =
            state.get(&name).map_or_else(|_| vec![T::ZERO; before * columns], |old| old.as_slice().to_vec());
        match added.get(&name) {
            Ok(tensor) => values.extend_from_slice(tensor.as_slice()),
            Err(_) => values.resize((before + more) * columns, T::ZERO),
        }
        state.insert(name, Tensor::from_vec([&[before + more], row.as_slice()].concat(), values));
    }
    Ok(())
}

/// Seeds in the parametrisation of Gaussians: isotropic, of the pixels' colours.
fn as_gaussians<T: Real>(seeds: &[Seed], shared: &Shared, scene: &SceneFacts) -> ModelState<T> {
    let mut state = ModelState::new();
    let points = PointCloud {
        positions: seeds.iter().map(|seed| seed.position.as_vec3().to_array()).collect(),
        colors: seeds.iter().map(|seed| seed.color).collect(),
    };
    insert_gaussians(&mut state, GAUSSIANS, &points, shared.harmonics.degree, scene);
    let scales = seeds.iter().flat_map(|seed| [T::from_f64(seed.scale.ln()); 3]).collect();
    state.insert("gaussians.log_scales", Tensor::from_vec([seeds.len(), 3], scales));
    let opacity = Tensor::full([seeds.len(), 1], T::from_f64(logit(shared.seeds.opacity)));
    state.insert("gaussians.opacity_logits", opacity);
    state
}
