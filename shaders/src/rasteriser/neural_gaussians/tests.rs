use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

const ANCHORS: usize = 3;
const K: usize = 4;

/// Positions, scales, offsets, opacities (both signs), shapes and colours of a few anchors.
fn inputs() -> Vec<Tensor<f64>> {
    let tensor = |columns: usize, seed: u64, map: fn(f64) -> f64| {
        Tensor::from_vec([ANCHORS, columns], noise(ANCHORS * columns, seed).into_iter().map(map).collect())
    };
    vec![
        tensor(3, 1, |x| 2.0 * x),
        tensor(6, 2, |x| x - 1.0),
        tensor(3 * K, 3, |x| x),
        tensor(K, 4, |x| 0.9 * x),
        tensor(7 * K, 5, |x| 2.0 * x),
        tensor(3 * K, 6, |x| 0.5 + 0.5 * x),
    ]
}

fn anchor_vars(vars: &[Var]) -> AnchorVars {
    let &[positions, log_scales, offsets, opacities, shapes, colors] = vars else { panic!("six variables") };
    AnchorVars { positions, log_scales, offsets, opacities, shapes, colors }
}

fn spawned<T: Real>(inputs: &[Tensor<f64>]) -> (Vec<Tensor<T>>, Vec<u32>) {
    let mut tape = Tape::new(Device::Cpu);
    let vars: Vec<Var> = inputs.iter().map(|input| tape.constant(input.cast())).collect();
    let NeuralGaussians { positions, log_scales, rotations, opacity_logits, sh, slots } =
        neural_gaussians(&mut tape, &anchor_vars(&vars));
    let values = [positions, log_scales, rotations, opacity_logits, sh].map(|var| tape.value(var).clone()).to_vec();
    (values, slots.expect("the CPU leaves some out").to_vec())
}

/// All Gaussians, as on a GPU.
fn spawn_all(tape: &mut Tape<f64>, vars: &[Var]) -> NeuralGaussians {
    let anchors = anchor_vars(vars);
    let chosen = Chosen::all(tape.value(anchors.opacities));
    spawn(tape, &anchors, chosen)
}

const OUTPUTS: [fn(&NeuralGaussians) -> Var; 5] = [
    |found| found.positions,
    |found| found.log_scales,
    |found| found.rotations,
    |found| found.opacity_logits,
    |found| found.sh,
];

#[test]
fn gradients_equal_central_differences() {
    for output in OUTPUTS {
        let spawn = |tape: &mut Tape<f64>, vars: &[Var]| {
            let found = neural_gaussians(tape, &anchor_vars(vars));
            output(&found)
        };
        gradients(spawn, &inputs(), TOLERANCE).unwrap();
        let all = |tape: &mut Tape<f64>, vars: &[Var]| {
            let found = spawn_all(tape, vars);
            output(&found)
        };
        gradients(all, &inputs(), TOLERANCE).unwrap();
    }
}

#[test]
fn what_is_left_out_is_hidden_where_every_gaussian_has_a_row() {
    let inputs = inputs();
    let (present, slots) = spawned::<f64>(&inputs);
    let mut tape = Tape::new(Device::Cpu);
    let vars: Vec<Var> = inputs.iter().map(|input| tape.constant(input.clone())).collect();
    let all = spawn_all(&mut tape, &vars);
    assert!(all.slots.is_none());
    for (output, present) in OUTPUTS.into_iter().zip(&present) {
        let all = tape.value(output(&all));
        assert_eq!(all.rows(), ANCHORS * K);
        for (gaussian, &slot) in slots.iter().enumerate() {
            assert_eq!(all.row(slot as usize), present.row(gaussian));
        }
    }
    let logits = tape.value(all.opacity_logits).as_slice();
    for slot in (0..ANCHORS * K).filter(|slot| !slots.contains(&(*slot as u32))) {
        assert_eq!(logits[slot], HIDDEN_LOGIT);
    }
}

#[test]
fn gradients_through_all_outputs_at_once_add_up() {
    let total = |inputs: &[Tensor<f64>], outputs: &[fn(&NeuralGaussians) -> Var]| {
        let mut tape = Tape::new(Device::Cpu);
        let vars: Vec<Var> = inputs.iter().map(|input| tape.leaf(input.clone())).collect();
        let found = neural_gaussians(&mut tape, &anchor_vars(&vars));
        let seeds: Vec<_> = outputs
            .iter()
            .map(|output| (output(&found), Tensor::full(tape.value(output(&found)).shape(), 1.0)))
            .collect();
        let mut gradients = tape.backward(&seeds);
        vars.iter().map(|&var| gradients.take(var)).collect::<Vec<_>>()
    };
    let (inputs, mut sums) = (inputs(), vec![0.0; ANCHORS * 6]);
    for output in OUTPUTS {
        if let Some(gradient) = &total(&inputs, &[output])[1] {
            sums.iter_mut().zip(gradient.as_slice()).for_each(|(sum, value)| *sum += value);
        }
    }
    let together = total(&inputs, &OUTPUTS);
    agree(together[1].as_ref().unwrap(), &Tensor::from_vec([ANCHORS, 6], sums), 1e-12).unwrap();
}

#[test]
fn only_positive_opacities_spawn_and_slots_say_which() {
    let inputs = inputs();
    let (outputs, slots) = spawned::<f64>(&inputs);
    let positive: Vec<u32> =
        (0..(ANCHORS * K) as u32).filter(|&slot| inputs[3].as_slice()[slot as usize] > 0.0).collect();
    assert!(!positive.is_empty() && positive.len() < ANCHORS * K, "the test needs both kinds");
    assert_eq!(slots, positive);
    for (gaussian, &slot) in slots.iter().enumerate() {
        let opacity = 1.0 / (1.0 + (-outputs[3].as_slice()[gaussian]).exp());
        assert!((opacity - inputs[3].as_slice()[slot as usize]).abs() <= 1e-12);
        let (anchor, k) = (slot as usize / K, slot as usize % K);
        let x = inputs[0].row(anchor)[0] + inputs[2].row(anchor)[3 * k] * inputs[1].row(anchor)[0].exp();
        assert!((outputs[0].row(gaussian)[0] - x).abs() <= 1e-12);
    }
}

#[test]
fn no_positive_opacity_spawns_nothing_and_a_nan_is_not_dropped() {
    let mut inputs = inputs();
    inputs[3] = Tensor::full([ANCHORS, K], -0.5);
    assert_eq!(spawned::<f32>(&inputs).1.len(), 0);
    inputs[3].make_mut()[5] = f64::NAN;
    let (outputs, slots) = spawned::<f32>(&inputs);
    assert_eq!(slots, [5]);
    assert!(outputs[3].as_slice()[0].is_nan());
}

#[test]
fn extreme_inputs_stay_finite() {
    let mut inputs = inputs();
    inputs[3] = Tensor::full([ANCHORS, K], 1.0);
    inputs[4] = Tensor::full([ANCHORS, 7 * K], -200.0);
    let (outputs, _) = spawned::<f32>(&inputs);
    assert!(outputs.iter().all(Tensor::is_finite));
}

#[test]
fn single_and_double_precision_agree_and_a_planted_fault_is_rejected() {
    let inputs = inputs();
    let ((single, _), (double, _)) = (spawned::<f32>(&inputs), spawned::<f64>(&inputs));
    for (single, double) in single.iter().zip(&double) {
        agree(single, double, 1e-5).unwrap();
    }
    let mut faulty = inputs;
    faulty[1].make_mut()[0] += 1e-2;
    assert!(agree(&spawned::<f64>(&faulty).0[0], &double[0], 1e-5).is_err());
}
