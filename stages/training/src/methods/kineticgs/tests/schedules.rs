//! Neighbours, and how much each loss weighs when.

use super::super::coherence::displacement_incoherence;
use super::super::weights::LossSettings;
use super::*;

#[test]
fn neighbours_that_move_alike_are_coherent() {
    let pairs = [[0, 1], [1, 2], [0, 2]];
    let incoherence = |rows: Vec<f64>, active: Vec<u32>| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let displacements = Some(tape.constant(Tensor::from_vec([active.len(), 3], rows)));
        let empty = tape.constant(Tensor::zeros([0, 3]));
        let anchors = Anchors { positions: empty, features: empty, offsets: empty, log_scales: empty };
        let moved = Moved { anchors, active, displacements };
        displacement_incoherence(&mut tape, &moved, 3, &pairs, 1.0).map(|value| tape.value(value).as_slice()[0])
    };
    assert_eq!(incoherence([0.3, 0.1, 0.0].repeat(3), vec![0, 1, 2]), Some(0.0));
    // Only particles 0 and 2 are active: one pair, opposite motion; 4·0.01 in units of 0.01.
    let opposite = incoherence(vec![0.1, 0.0, 0.0, -0.1, 0.0, 0.0], vec![0, 2]).unwrap();
    assert!((opposite - 4.0).abs() <= 1e-9, "{opposite}");
    assert_eq!(incoherence(vec![0.1, 0.0, 0.0], vec![1]), None);
    // Displacements far below the least unit do not blow up.
    let tiny = incoherence(vec![1e-9, 0.0, 0.0, -1e-9, 0.0, 0.0], vec![0, 2]).unwrap();
    assert!(tiny <= 1e-9, "{tiny}");
}

#[test]
fn both_ways_to_find_neighbours_find_close_ones() {
    let positions: Vec<[f32; 3]> = (0..64).map(|at| [(at % 4) as f32, (at / 4 % 4) as f32, (at / 16) as f32]).collect();
    for neighbors in [coherence::Neighbors::Curve, coherence::Neighbors::Knn] {
        let pairs = neighbors.pairs(&positions, 1.0, &mut generator(4, Stream::Method));
        let distance = |&[first, second]: &[u32; 2]| {
            glam::Vec3::from(positions[first as usize]).distance(glam::Vec3::from(positions[second as usize]))
        };
        assert!(pairs.len() > 64, "{neighbors:?}");
        assert!(pairs.iter().map(distance).sum::<f32>() / (pairs.len() as f32) < 2.0, "{neighbors:?}");
        assert!(pairs.iter().all(|[first, second]| first != second));
    }
    assert!(coherence::Neighbors::Knn.pairs(&[], 1.0, &mut generator(4, Stream::Method)).is_empty());
}

#[test]
fn weights_grow_and_the_flow_ends() {
    let settings = LossSettings::default();
    assert!((settings.at(1000, 1.0).flow - 0.05).abs() <= 1e-12);
    assert!((settings.at(4000, 1.0).flow - 0.1).abs() <= 1e-12);
    assert!((settings.at(7500, 1.0).flow - 0.01).abs() <= 1e-12);
    assert_eq!((settings.at(10_000, 1.0).flow, settings.at(10_000, 1.0).coherence), (0.0, 0.01));
    assert_eq!(settings.at(1000, 0.1).flow, 0.0);
    assert_eq!(LossSettings { ramp: 0, ..settings }.at(1, 1.0).activation, 0.01);
}
