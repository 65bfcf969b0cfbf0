//! Trainable gates that are either open or closed.

use shaders::pointwise;
use shaders::pointwise::add;
use shaders::tape::{Real, Tape, Var};

pointwise! {
    /// y = (1 if x > threshold, otherwise 0) − x; NaN for a NaN.
    fn to_step(x) with(threshold) -> y {
        return select(0.0, 1.0, x > threshold) - x;
    }
    gradients(dy) {
        x: { return -dy; }
    }
}

/// 1 where x > `threshold`, otherwise 0, with the gradient of x: the straight-through estimator (Bengio, Léonard and
/// Courville 2013). Any shape.
pub(crate) fn straight_through<T: Real>(tape: &mut Tape<T>, x: Var, threshold: f64) -> Var {
    let to_step = to_step(tape, x, threshold);
    let to_step = tape.detach(to_step);
    add(tape, x, to_step)
}

#[cfg(test)]
mod tests {
    use shaders::check::{TOLERANCE, gradients, test_gpu};
    use shaders::tape::{Device, Tensor};

    use super::*;

    #[test]
    fn the_step_from_a_value_has_the_gradient_of_central_differences() {
        let x = Tensor::from_vec([4], vec![-1.0, 0.2, 0.4, 3.0]);
        gradients(|tape, vars| to_step(tape, vars[0], 0.3), &[x], TOLERANCE).unwrap();
    }

    #[test]
    fn a_gate_is_open_or_closed_and_passes_the_gradient_either_way() {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let x = tape.leaf(Tensor::from_vec([4], vec![0.0, 0.01, 0.02, 0.7]));
        let gate = straight_through(&mut tape, x, 0.01);
        assert_eq!(tape.value(gate).as_slice(), [0.0, 0.0, 1.0, 1.0]);
        let weights = Tensor::from_vec([4], vec![1.0, 2.0, 3.0, 4.0]);
        assert_eq!(tape.backward(&[(gate, weights.clone())]).take(x).unwrap(), weights);
    }

    #[test]
    fn a_gate_of_nan_is_nan_on_every_device() {
        for device in [Some(Device::Cpu), test_gpu().map(Device::Gpu)].into_iter().flatten() {
            let mut tape = Tape::<f32>::new(device);
            let x = tape.leaf(Tensor::from_vec([3], vec![f32::NAN, 0.1, 0.7]));
            let gate = straight_through(&mut tape, x, 0.5);
            let values = tape.value(gate).as_slice();
            assert!(values[0].is_nan() && values[1..] == [0.0, 1.0], "{values:?}");
        }
    }
}
