//! Gates that are either open or closed, and learn all the same.

use shaders::pointwise::add;
use shaders::tape::{Real, Tape, Tensor, Var};

/// 1 where x > `threshold`, else 0, with the gradient of x itself: the straight-through estimator (Bengio, Léonard and
/// Courville 2013). Any shape.
pub fn straight_through<T: Real>(tape: &mut Tape<T>, x: Var, threshold: f64) -> Var {
    let threshold = T::from_f64(threshold);
    let value = tape.value(x);
    let to_step = |&x: &T| if x > threshold { T::ONE - x } else { -x };
    let to_step = Tensor::from_vec(value.shape(), value.as_slice().iter().map(to_step).collect());
    let to_step = tape.detach_value(to_step);
    add(tape, x, to_step)
}

#[cfg(test)]
mod tests {
    use shaders::tape::Device;

    use super::*;

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
    fn a_value_that_is_no_number_shows() {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let x = tape.leaf(Tensor::scalar(f32::NAN));
        let gate = straight_through(&mut tape, x, 0.5);
        assert!(tape.value(gate).as_slice()[0].is_nan());
    }
}
