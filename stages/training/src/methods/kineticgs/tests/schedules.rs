//! Neighbours of particles, and schedules of the loss weights.

use super::super::coherence::displacement_incoherence;
use super::super::neighbors::{Neighbors, Pairs, Search};
use super::super::weights::LossSettings;
use super::*;
use crate::data::Streams;

#[test]
fn neighbours_with_equal_motion_are_coherent() {
    let pairs = Pairs::new(&[[0, 1], [1, 2], [0, 2]], 3).unwrap();
    let incoherence = |rows: Vec<f64>| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let displacements = tape.constant(Tensor::from_vec([3, 3], rows));
        let value = displacement_incoherence(&mut tape, displacements, &pairs, 1.0);
        tape.value(value).as_slice()[0]
    };
    assert_eq!(incoherence([0.3, 0.1, 0.0].repeat(3)), 0.0);
    // Two in opposite motion and one still: (0.01 + 0.01 + 0.04) / 3 in units of 0.02 / 3.
    let opposite = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, -0.1, 0.0, 0.0];
    let found = incoherence(opposite.to_vec());
    assert!((found - 3.0).abs() <= 1e-9, "{found}");
    // Displacements far below the minimum unit do not blow up.
    let tiny = incoherence(opposite.map(|x| 1e-8 * x).to_vec());
    assert!(tiny <= 1e-9, "{tiny}");
}

#[test]
fn every_neighbour_search_finds_close_pairs() {
    let positions: Vec<[f32; 3]> = (0..64).map(|at| [(at % 4) as f32, (at / 4 % 4) as f32, (at / 16) as f32]).collect();
    for search in [Search::Hilbert, Search::ZOrder, Search::Nearest] {
        let pairs = search.pairs(&positions, 1.0);
        let distance = |&[first, second]: &[u32; 2]| {
            glam::Vec3::from(positions[first as usize]).distance(glam::Vec3::from(positions[second as usize]))
        };
        assert!(pairs.len() > 64, "{search:?}");
        assert!(pairs.iter().map(distance).sum::<f32>() / (pairs.len() as f32) < 2.0, "{search:?}");
        assert!(pairs.iter().all(|[first, second]| first != second));
        assert!(search.pairs(&[], 1.0).is_empty());
    }
    let drawn: BTreeSet<usize> = (0..20)
        .map(|seed| Neighbors::Curve.draw(Streams::new(seed).step("fine", 1).of("neighbors")) as usize)
        .collect();
    assert_eq!(drawn, [Search::Hilbert as usize, Search::ZOrder as usize].into());
    assert_eq!(Neighbors::Knn.draw(Streams::new(0).step("fine", 1).of("neighbors")), Search::Nearest);
}

#[test]
fn weights_grow_and_the_flow_loss_ends() {
    let settings = LossSettings::default();
    for (iteration, share) in [(1000, 0.5), (4000, 1.0), (7500, 0.1)] {
        assert!((settings.at(iteration, 1.0).flow - share * settings.flow).abs() <= 1e-12);
    }
    assert_eq!((settings.at(10_000, 1.0).flow, settings.at(10_000, 1.0).coherence), (0.0, 1e-3));
    assert_eq!(settings.at(1000, 0.1).flow, 0.0);
    assert_eq!(LossSettings { ramp: 0, ..settings }.at(1, 1.0).activation, 1e-4);
}
