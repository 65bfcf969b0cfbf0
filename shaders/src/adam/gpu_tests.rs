//! A GPU updates as the CPU does.

use super::*;
use crate::check::conformance::Disagreement;
use crate::check::{agree, noise};
use crate::gpu::Gpu;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::parts::tests::assert_equal_in_parts;
use crate::gpu::tests::{bits, test_gpu};
use crate::tape::Device;

fn tensor(rows: usize, seed: u64) -> Tensor<f32> {
    Tensor::from_vec([rows, 3], noise(3 * rows, seed)).cast()
}

/// Some updates, with row operations and writes of the host between them.
fn train(device: Device, rows: usize) -> Group {
    let mut group = Group::new("trained", tensor(rows, 1));
    let step = |group: &mut Group, seed| {
        let gradient = tensor(group.rows(), seed);
        if let Device::Gpu(gpu) = device {
            gradient.on_gpu(gpu);
        }
        Adam::default().step(&mut [Update { group, gradient: Some(&gradient), learning_rate: 0.01 }]);
    };
    (0..5).for_each(|seed| step(&mut group, seed));
    group.keep_rows(&(0..rows).map(|row| row % 3 != 0).collect::<Vec<_>>());
    group.append_rows(&[0.5; 6]);
    (5..8).for_each(|seed| step(&mut group, seed));
    group.values_mut().iter_mut().step_by(2).for_each(|value| *value = 0.25);
    step(&mut group, 8);
    group.reset_moments();
    step(&mut group, 9);
    group
}

fn compare_training(gpu: Gpu, rows: usize) -> Result<usize, Disagreement> {
    let (found, expected) = (train(Device::Gpu(gpu), rows), train(Device::Cpu, rows));
    assert_eq!((found.step(), expected.step()), (10, 10));
    assert!(found.tensor().gpu() == Some(gpu), "the last update was the GPU's");
    for (found, expected) in found.tensors().into_iter().zip(expected.tensors()) {
        let disagreement = |mismatch| Disagreement { what: format!("adam of {rows} rows"), mismatch };
        agree(found, expected, 1e-5).map_err(disagreement)?;
    }
    Ok(3)
}

#[test]
fn a_gpu_updates_as_the_cpu_does_whatever_the_host_edits() {
    let Some(gpu) = test_gpu() else { return };
    for rows in [0, 1, 86, 5000] {
        compare_training(gpu, rows).unwrap();
    }
}

#[test]
fn a_gpu_that_updates_otherwise_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("adam", "(gradient * gradient)", "gradient"),
        ("adam", "adam.beta1 * first_moments", "adam.beta2 * first_moments"),
        ("adam", "256u * step", "0u * step"),
        ("adam", "sqrt(second) *", "sqrt(second) +"),
    ];
    assert_noticed(&faults, || compare_training(gpu, 200));
}

#[test]
fn shared_tensors_keep_their_values() {
    let Some(gpu) = test_gpu() else { return };
    let mut group = Group::new("shared", tensor(50, 1));
    let before = group.tensor().clone();
    let gradient = tensor(50, 2);
    gradient.on_gpu(gpu);
    Adam::default().step(&mut [Update { group: &mut group, gradient: Some(&gradient), learning_rate: 0.1 }]);
    assert!(before == tensor(50, 1) && *group.tensor() != before);
}

/// Many groups at once, the last without a gradient; returns them after one step.
fn step_of_many(step: impl FnOnce(&mut [Update])) -> Vec<Group> {
    let mut groups: Vec<Group> = (0..20).map(|at| Group::new("one of many", tensor(7 * at, at as u64))).collect();
    let gradients: Vec<Tensor<f32>> = groups.iter().map(|group| tensor(group.rows(), 99)).collect();
    let update = |(at, group)| Update { group, gradient: gradients.get(at).filter(|_| at < 19), learning_rate: 0.01 };
    let mut updates: Vec<Update> = groups.iter_mut().enumerate().map(update).collect();
    step(&mut updates);
    drop(updates);
    groups
}

#[test]
fn a_gpu_returns_the_largest_magnitudes_of_every_group() {
    let Some(gpu) = test_gpu() else { return };
    let compare = || {
        let mut magnitudes = Tensor::zeros([0]);
        let found = step_of_many(|updates| magnitudes = Adam::default().step_on(gpu, updates));
        let expected = step_of_many(|updates| Adam::default().step(updates));
        let mut figures = Vec::new();
        for (found, expected) in found.iter().zip(&expected) {
            let disagreement = |mismatch| Disagreement { what: "one of many groups".into(), mismatch };
            agree(found.tensor(), expected.tensor(), 1e-5).map_err(disagreement)?;
            let gradient = tensor(found.rows(), 99);
            figures.extend(crate::arrays::magnitude::largest_magnitudes(&[&gradient, found.tensor()]));
        }
        figures.truncate(2 * 19);
        let disagreement = |mismatch| Disagreement { what: "the largest magnitudes".into(), mismatch };
        agree(&magnitudes, &Tensor::from_vec([19, 2], figures), 0.0).map_err(disagreement)?;
        Ok(20)
    };
    let faults = [("& 0x7fffffffu", ""), ("adam.maxima + local", "local"), ("max(found, ", "(")];
    assert_noticed(&faults.map(|(right, wrong)| ("adam", right, wrong)), compare);
    crate::gpu::grouped::tests::with_arrays(16, || compare().map(drop).unwrap_or_else(|error| panic!("{error}")));
}

#[test]
fn an_update_in_parts_gives_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let result = || {
        let mut magnitudes = Tensor::zeros([0]);
        let groups = step_of_many(|updates| magnitudes = Adam::default().step_on(gpu, updates));
        let tensors = groups.iter().flat_map(Group::tensors).chain([&magnitudes]);
        bits(&tensors.map(|tensor| (String::new(), tensor.clone())).collect::<Vec<_>>())
    };
    assert!(assert_equal_in_parts(result) == 0, "each part is an item of its own");
}
