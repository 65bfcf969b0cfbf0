use super::*;

/// y = a·b, element by element.
struct Product;

impl Op<f64> for Product {
    fn name(&self) -> &'static str {
        "product"
    }

    fn forward(&mut self, inputs: &[&Tensor<f64>]) -> Vec<Tensor<f64>> {
        vec![elementwise(inputs[0], inputs[1])]
    }

    fn backward(&mut self, pass: Backward<f64>) -> Vec<Option<Tensor<f64>>> {
        let Backward { inputs, needs, .. } = pass;
        let dy = pass.dy();
        (0..2).map(|i| needs[i].then(|| elementwise(dy, inputs[1 - i]))).collect()
    }
}

fn elementwise(a: &Tensor<f64>, b: &Tensor<f64>) -> Tensor<f64> {
    Tensor::from_vec(a.shape(), a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| a * b).collect())
}

fn vector(values: &[f64]) -> Tensor<f64> {
    Tensor::from_vec([values.len()], values.to_vec())
}

#[test]
fn a_value_used_twice_accumulates_its_gradient() {
    let mut tape = Tape::new(Device::Cpu);
    let x = tape.leaf(vector(&[2.0, -3.0]));
    let square = tape.apply_one(Product, &[x, x]);
    let cube = tape.apply_one(Product, &[square, x]);
    let gradients = tape.backward(&[(cube, vector(&[1.0, 1.0])), (x, vector(&[100.0, 0.0]))]);
    assert_eq!(gradients.get(x).unwrap(), &vector(&[112.0, 27.0]));
    assert_eq!(gradients.get(square).unwrap(), &vector(&[2.0, -3.0]), "intermediate gradients are kept");
}

#[test]
fn constants_get_no_gradient_and_cost_no_backward() {
    let mut tape = Tape::new(Device::Cpu);
    let (x, c) = (tape.leaf(vector(&[2.0])), tape.constant(vector(&[5.0])));
    let constant = tape.apply_one(Product, &[c, c]);
    let unused = tape.apply_one(Product, &[x, x]);
    let y = tape.apply_one(Product, &[x, constant]);
    let mut gradients = tape.backward(&[(y, vector(&[1.0]))]);
    assert_eq!(gradients.take(x).unwrap(), vector(&[25.0]));
    assert!(gradients.get(c).is_none() && gradients.get(constant).is_none() && gradients.get(unused).is_none());
    let cost = tape.profile().ops["product"];
    assert_eq!((cost.forward.calls, cost.backward.calls), (3, 1), "only y's backward ran");
}

/// x·detach(x) at `x`, with its gradient.
fn half_detached_square(tape: &mut Tape<f64>, x: f64) -> (f64, f64) {
    let x = tape.leaf(vector(&[x]));
    let frozen = tape.detach(x);
    let y = tape.apply_one(Product, &[x, frozen]);
    let gradient = tape.backward(&[(y, vector(&[1.0]))]).take(x).unwrap();
    (tape.value(y).as_slice()[0], gradient.as_slice()[0])
}

#[test]
fn differences_on_replaying_tapes_hold_constant_what_was_cut_off() {
    let mut tape = Tape::new(Device::Cpu);
    let (_, gradient) = half_detached_square(&mut tape, 3.0);
    assert_eq!(gradient, 3.0);
    let replayed = |x| half_detached_square(&mut Tape::replaying(Device::Cpu, tape.detached()), x).0;
    assert_eq!(replayed(3.5) - replayed(2.5), gradient);
    // Without it, the difference is that of x².
    let plain = |x| half_detached_square(&mut Tape::new(Device::Cpu), x).0;
    assert_eq!(plain(3.5) - plain(2.5), 6.0);
}

#[test]
#[should_panic(expected = "as many values")]
fn a_replaying_tape_refuses_another_computation() {
    half_detached_square(&mut Tape::replaying(Device::Cpu, &[]), 1.0);
}

#[test]
fn profiles_of_several_tapes_add_up() {
    let mut total = Profile::default();
    for _ in 0..3 {
        let mut tape = Tape::new(Device::Cpu);
        let x = tape.leaf(vector(&[1.0]));
        tape.apply(Product, &[x, x]);
        total.merge(tape.profile());
    }
    assert_eq!(total.ops["product"].forward.calls, 3);
    assert!(total.ops["product"].forward.secs >= 0.0);
}

#[test]
fn the_first_operation_with_a_nan_is_named() {
    let mut tape = Tape::new(Device::Cpu);
    let x = tape.leaf(vector(&[1.0, f64::INFINITY]));
    let zero = tape.constant(vector(&[1.0, 0.0]));
    let fine = tape.leaf(vector(&[1.0, 1.0]));
    tape.apply(Product, &[fine, fine]);
    assert_eq!(tape.first_non_finite_op(), None);
    tape.apply(Product, &[x, zero]);
    assert_eq!(tape.first_non_finite_op(), Some("product"));
}

#[test]
#[should_panic(expected = "differ in shape")]
fn a_seed_of_the_wrong_shape_is_refused() {
    let mut tape = Tape::new(Device::Cpu);
    let x = tape.leaf(vector(&[1.0, 2.0]));
    tape.backward(&[(x, vector(&[1.0]))]);
}

#[test]
fn writing_to_a_shared_tensor_leaves_the_other_unchanged() {
    let original = vector(&[1.0, 2.0]);
    let mut copy = original.clone();
    copy.make_mut()[0] = 9.0;
    assert_eq!((original, copy), (vector(&[1.0, 2.0]), vector(&[9.0, 2.0])));
}

#[test]
fn chunked_sums_do_not_depend_on_the_number_of_threads() {
    let term = |i: usize| 1.0 / (1.0 + i as f64).powf(1.3);
    let sum_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| chunks::sum(100_000, term)).to_bits()
    };
    let expected: f64 = (0..100_000).map(term).sum();
    assert!((f64::from_bits(sum_with(1)) - expected).abs() < 1e-12);
    assert!([2, 3, 8].iter().all(|&threads| sum_with(threads) == sum_with(1)));
}
