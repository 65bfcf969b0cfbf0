use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

/// x [rows, inputs], weight [outputs, inputs], bias [outputs].
fn arguments(rows: usize, inputs: usize, outputs: usize) -> [Tensor<f64>; 3] {
    [
        Tensor::from_vec([rows, inputs], noise(rows * inputs, 1)),
        Tensor::from_vec([outputs, inputs], noise(outputs * inputs, 2)),
        Tensor::from_vec([outputs], noise(outputs, 3)),
    ]
}

/// Output and the three gradients for an upstream gradient of noise.
fn run<T: Real>(arguments: &[Tensor<f64>; 3], activation: Activation) -> Vec<Tensor<T>> {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let vars = arguments.each_ref().map(|tensor| tape.leaf(tensor.cast()));
    let y = linear(&mut tape, vars[0], vars[1], vars[2], activation);
    let value = tape.value(y).clone();
    let seed = Tensor::from_vec(value.shape(), noise(value.len(), 4)).cast();
    let gradients = tape.backward(&[(y, seed)]);
    std::iter::once(value).chain(vars.map(|var| gradients.get(var).unwrap().clone())).collect()
}

#[test]
fn gradients_equal_central_differences() {
    for activation in [Activation::Identity, Activation::Relu] {
        let layer = |tape: &mut Tape<f64>, vars: &[Var]| linear(tape, vars[0], vars[1], vars[2], activation);
        gradients(layer, &arguments(7, 5, 3), TOLERANCE).unwrap();
    }
}

#[test]
fn a_layer_computes_its_equation() {
    let arguments = [
        Tensor::from_vec([1, 2], vec![2.0, 3.0]),
        Tensor::from_vec([2, 2], vec![1.0, 10.0, -1.0, 0.0]),
        Tensor::from_vec([2], vec![0.5, 0.25]),
    ];
    assert_eq!(run::<f32>(&arguments, Activation::Identity)[0].as_slice(), [32.5, -1.75]);
    assert_eq!(run::<f32>(&arguments, Activation::Relu)[0].as_slice(), [32.5, 0.0]);
}

#[test]
fn f32_agrees_with_the_f64_reference() {
    for (rows, inputs, outputs) in [(1300, 64, 33), (5, 3, 1), (1, 1, 7)] {
        let arguments = arguments(rows, inputs, outputs);
        // Identity: a rounding difference around the kink of a ReLU is not an error.
        let (fast, exact) =
            (run::<f32>(&arguments, Activation::Identity), run::<f64>(&arguments, Activation::Identity));
        fast.iter().zip(&exact).for_each(|(fast, exact)| agree(fast, exact, 2e-6).unwrap());
    }
}

#[test]
fn a_planted_fault_is_rejected() {
    let exact = run::<f64>(&arguments(600, 8, 4), Activation::Identity);
    let mut faulty = arguments(600, 8, 4);
    faulty[1].make_mut()[5] += 1e-3;
    assert!(agree(&run::<f32>(&faulty, Activation::Identity)[0], &exact[0], 2e-6).is_err());
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let arguments = arguments(3000, 64, 64);
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run::<f32>(&arguments, Activation::Relu))
    };
    assert!([2, 3, 8].iter().all(|&threads| run_with(threads) == run_with(1)));
}

#[test]
fn a_nan_is_not_hidden_by_the_relu() {
    let mut arguments = arguments(2, 3, 2);
    arguments[0].make_mut()[0] = f64::NAN;
    let results = run::<f32>(&arguments, Activation::Relu);
    assert!(results[0].row(0).iter().all(|y| y.is_nan()) && results[0].row(1).iter().all(|y| y.is_finite()));
}

#[test]
fn no_rows_give_no_output_and_zero_gradients() {
    let results = run::<f32>(&arguments(0, 4, 3), Activation::Relu);
    assert_eq!(results[0].shape(), [0, 3]);
    assert!(results[2..].iter().all(|gradient| gradient.as_slice().iter().all(|&value| value == 0.0)));
}

#[test]
fn rows_without_a_gradient_add_nothing() {
    const ROWS: usize = 1300;
    let [x, weight, bias] = arguments(ROWS, 16, 8);
    let is_live = |row: usize| row.is_multiple_of(3);
    let live_rows = |tensor: &Tensor<f64>| {
        let rows: Vec<f64> = (0..ROWS).filter(|&row| is_live(row)).flat_map(|row| tensor.row(row)).copied().collect();
        Tensor::from_vec([rows.len() / tensor.row_len(), tensor.row_len()], rows)
    };
    let mut dy = Tensor::from_vec([ROWS, 8], noise(ROWS * 8, 4));
    (0..ROWS).filter(|&row| !is_live(row)).for_each(|row| dy.make_mut()[8 * row..8 * (row + 1)].fill(0.0));
    let backward = |x: &Tensor<f64>, dy: &Tensor<f64>| {
        let mut tape = Tape::new(Device::Cpu);
        let vars = [x, &weight, &bias].map(|tensor| tape.leaf(tensor.clone()));
        let y = linear(&mut tape, vars[0], vars[1], vars[2], Activation::Identity);
        let gradients = tape.backward(&[(y, dy.clone())]);
        vars.map(|var| gradients.get(var).unwrap().clone())
    };
    let (all, live) = (backward(&x, &dy), backward(&live_rows(&x), &live_rows(&dy)));
    assert_eq!(live_rows(&all[0]), live[0]);
    assert!((0..ROWS).all(|row| is_live(row) || all[0].row(row) == [0.0; 16]));
    (1..3).for_each(|index| agree(&all[index], &live[index], 1e-13).unwrap());
}

/// Layers that share an input, which has another use; applied at once or one by one.
fn heads<T: Real>(tape: &mut Tape<T>, vars: &[Var], at_once: bool) -> Vec<Var> {
    let (x, pairs) = vars.split_first().unwrap();
    let layers: Vec<Layer> = pairs.chunks(2).map(|pair| Layer { x: *x, weight: pair[0], bias: pair[1] }).collect();
    let mut outputs = match at_once {
        true => linears(tape, &layers, Activation::Relu),
        false => layers.iter().map(|layer| linear(tape, layer.x, layer.weight, layer.bias, Activation::Relu)).collect(),
    };
    outputs.push(crate::pointwise::square(tape, *x));
    outputs
}

#[test]
fn layers_at_once_are_layers_one_by_one_to_the_bit() {
    let sizes = [3, 17, 4];
    let pairs = sizes.iter().flat_map(|&size| [[size, 40], [1, size]]);
    let shapes: Vec<[usize; 2]> = std::iter::once([1300, 40]).chain(pairs).collect();
    let results = |at_once: bool| {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let leaf = |(seed, shape): (usize, &[usize; 2])| {
            tape.leaf(Tensor::from_vec(*shape, noise(shape[0] * shape[1], seed as u64)).cast())
        };
        let vars: Vec<Var> = shapes.iter().enumerate().map(leaf).collect();
        let outputs = heads(&mut tape, &vars, at_once);
        let seed = |&output: &Var| (output, tape.value(output).clone());
        // The second layer has no gradient.
        let seeds: Vec<_> =
            outputs.iter().map(seed).enumerate().filter(|(at, _)| *at != 1).map(|(_, seed)| seed).collect();
        let gradients = tape.backward(&seeds);
        let values: Vec<Tensor<f32>> = outputs.iter().map(|&output| tape.value(output).clone()).collect();
        (values, vars.iter().map(|&var| gradients.get(var).cloned()).collect::<Vec<_>>())
    };
    assert!(results(true) == results(false));
}
