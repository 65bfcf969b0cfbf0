use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

const HEADS: usize = 2;

/// Queries, keys and values of noise.
fn arguments(queries: usize, keys: usize, depth: usize) -> [Tensor<f64>; 3] {
    let tensor = |rows: usize, seed| {
        let width = HEADS * depth;
        Tensor::from_vec([rows, width], noise(rows * width, seed).iter().map(|value| 2.0 * value).collect())
    };
    [tensor(queries, 1), tensor(keys, 2), tensor(keys, 3)]
}

/// Both outputs and the three gradients for upstream gradients of noise.
fn run<T: Real>(arguments: &[Tensor<f64>; 3], valid: &[bool], k: usize) -> Vec<Tensor<T>> {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let vars = arguments.each_ref().map(|tensor| tape.leaf(tensor.cast()));
    let attention = top_k_attention(&mut tape, vars, valid, HEADS, k);
    let outputs = [attention.mixed, attention.probabilities].map(|var| (var, tape.value(var).clone()));
    let seed = |tensor: &Tensor<T>, seed| Tensor::from_vec(tensor.shape(), noise(tensor.len(), seed)).cast();
    let seeds = [(outputs[0].0, seed(&outputs[0].1, 4)), (outputs[1].0, seed(&outputs[1].1, 5))];
    let gradients = tape.backward(&seeds);
    let zeros = |var| Tensor::zeros(tape.value(var).shape());
    let of_inputs = vars.map(|var| gradients.get(var).cloned().unwrap_or_else(|| zeros(var)));
    outputs.into_iter().map(|(_, value)| value).chain(of_inputs).collect()
}

/// The attention of one query and head, computed plainly: probability of every key.
fn plain_probabilities([query, key, _]: &[Tensor<f64>; 3], valid: &[bool], at: [usize; 2], k: usize) -> Vec<f64> {
    let depth = query.row_len() / HEADS;
    let columns = at[1] * depth..(at[1] + 1) * depth;
    let product = |row: usize| -> f64 {
        let products = query.row(at[0])[columns.clone()].iter().zip(&key.row(row)[columns.clone()]).map(|(q, k)| q * k);
        products.sum::<f64>() / (depth as f64).sqrt()
    };
    let mut order: Vec<usize> = (0..key.rows()).filter(|&row| valid[row]).collect();
    order.sort_by(|&a, &b| product(b).total_cmp(&product(a)));
    let mut probabilities = vec![0.0; key.rows()];
    order.iter().take(k).for_each(|&row| probabilities[row] = product(row).exp());
    let sum: f64 = probabilities.iter().sum();
    probabilities.iter().map(|value| value / sum).collect()
}

#[test]
fn gradients_equal_central_differences() {
    let some = [true, false, true, true, true, false];
    for (valid, k) in [([true; 6], 3), ([true; 6], 6), (some, 2), (some, 100)] {
        let mixed = |tape: &mut Tape<f64>, vars: &[Var]| {
            top_k_attention(tape, [vars[0], vars[1], vars[2]], &valid, HEADS, k).mixed
        };
        gradients(mixed, &arguments(4, 6, 3), TOLERANCE).unwrap();
        let probabilities = |tape: &mut Tape<f64>, vars: &[Var]| {
            top_k_attention(tape, [vars[0], vars[1], vars[2]], &valid, HEADS, k).probabilities
        };
        gradients(probabilities, &arguments(4, 6, 3), TOLERANCE).unwrap();
    }
}

/// The kept probabilities and the values that they mix, against those computed plainly.
fn check_kept(arguments: &[Tensor<f64>; 3], valid: &[bool], k: usize) {
    let found = run::<f64>(arguments, valid, k);
    let (keys, depth) = (valid.len(), arguments[0].row_len() / HEADS);
    for query in 0..arguments[0].rows() {
        let heads = [0, 1].map(|head| plain_probabilities(arguments, valid, [query, head], k));
        let mean: Vec<f64> = heads[0].iter().zip(&heads[1]).map(|(a, b)| 0.5 * (a + b)).collect();
        let row = Tensor::from_vec([keys], found[1].row(query).to_vec());
        agree(&row, &Tensor::from_vec([keys], mean), 1e-12).unwrap();
        for (head, probabilities) in heads.iter().enumerate() {
            let values = (0..depth).map(|column| {
                (0..keys).map(|key| probabilities[key] * arguments[2].row(key)[head * depth + column]).sum::<f64>()
            });
            let expected = Tensor::from_vec([depth], values.collect());
            let mixed = found[0].row(query)[head * depth..][..depth].to_vec();
            agree(&Tensor::from_vec([depth], mixed), &expected, 1e-12).unwrap();
        }
    }
}

#[test]
fn only_the_best_valid_keys_count() {
    check_kept(&arguments(5, 9, 4), &[true, true, false, true, true, true, false, true, true], 4);
    let valid: Vec<bool> = (0..300).map(|key| key % 7 != 3).collect();
    check_kept(&arguments(5, 300, 4), &valid, 32);
}

#[test]
fn many_equal_scores_keep_the_earlier_keys() {
    // Products of quarters are exact. Among 300, there are many equal ones.
    let mut coarse = arguments(5, 300, 4);
    coarse.iter_mut().for_each(|tensor| tensor.make_mut().iter_mut().for_each(|value| *value = value.round() / 4.0));
    check_kept(&coarse, &[true; 300], 32);
}

#[test]
fn a_key_that_is_no_number_reaches_the_output() {
    let mut broken = arguments(2, 300, 4);
    broken[1].make_mut()[100] = f64::NAN;
    assert!(run::<f32>(&broken, &[true; 300], 32)[0].as_slice().iter().any(|value| value.is_nan()));
    broken[1].make_mut().fill(f64::NAN);
    assert!(run::<f32>(&broken, &[true; 300], 32)[0].as_slice().iter().all(|value| value.is_nan()));
}

#[test]
fn one_key_more_is_noticed() {
    let (arguments, valid) = (arguments(5, 9, 4), [true; 9]);
    let (found, faulty) = (run::<f64>(&arguments, &valid, 4), run::<f64>(&arguments, &valid, 5));
    assert!(agree(&faulty[0], &found[0], 1e-6).is_err() && agree(&faulty[2], &found[2], 1e-6).is_err());
}

#[test]
fn without_valid_keys_everything_is_zero() {
    for tensor in run::<f32>(&arguments(3, 4, 2), &[false; 4], 2) {
        assert!(tensor.as_slice().iter().all(|&value| value == 0.0), "{tensor:?}");
    }
}

#[test]
fn of_equal_scores_the_earlier_key_is_kept() {
    let equal = [Tensor::full([1, 4], 1.0), Tensor::full([5, 4], 0.5), Tensor::full([5, 4], 1.0)];
    assert_eq!(run::<f32>(&equal, &[false, true, true, true, true], 2)[1].as_slice(), [0.0, 0.5, 0.5, 0.0, 0.0]);
}

#[test]
fn large_scores_do_not_overflow() {
    let mut large = arguments(4, 6, 3);
    large[0].make_mut().iter_mut().for_each(|value| *value *= 1e4);
    let found = run::<f32>(&large, &[true; 6], 3);
    assert!(found.iter().all(Tensor::is_finite));
    assert!((0..4).all(|row| (found[1].row(row).iter().sum::<f32>() - 1.0).abs() <= 1e-6));
}

#[test]
fn f32_agrees_with_f64_whatever_the_number_of_threads() {
    let (arguments, valid) = (arguments(60, 50, 16), [true; 50]);
    let exact = run::<f64>(&arguments, &valid, 50);
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run::<f32>(&arguments, &valid, 50))
    };
    let one = run_with(1);
    one.iter().zip(&exact).for_each(|(fast, exact)| agree(fast, exact, 1e-5).unwrap());
    assert!([2, 3].iter().all(|&threads| run_with(threads) == one));
}
