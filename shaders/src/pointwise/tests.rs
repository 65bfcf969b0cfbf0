use std::path::{Path, PathBuf};

use super::*;
use crate::check::conformance::run;
use crate::check::{self, agree, conformance, gradients};
use crate::gpu::layout_tests::validate;
use crate::gpu::parts::tests::assert_equal_in_parts;
use crate::gpu::tests::{bits, test_gpu};
use crate::tape::{Device, Tape, Tensor, Var};

/// The expressions of modules that only some methods use.
const FURTHER: [&[&Expression]; 0] = [];

/// Every expression of this crate.
fn all() -> impl Iterator<Item = &'static &'static Expression> {
    conformance::EXPRESSIONS.into_iter().chain(FURTHER).flatten()
}

/// Number of modules below a folder, apart from tests, that define pointwise expressions.
fn defining_modules(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let count = |path: PathBuf| match path.file_name().and_then(|name| name.to_str()) {
        _ if path.is_dir() => defining_modules(&path),
        Some(name) if name.ends_with(".rs") && !name.ends_with("tests.rs") => {
            let text = std::fs::read_to_string(&path).unwrap();
            usize::from(text.lines().any(|line| line == "pointwise! {"))
        }
        _ => 0,
    };
    entries.map(count).sum()
}

#[test]
fn every_module_with_expressions_is_listed() {
    let modules = defining_modules(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    let listed = conformance::EXPRESSIONS.len() + FURTHER.len();
    assert_eq!(listed, modules, "add `EXPRESSIONS` of a new module to FURTHER, so that these tests cover it");
}

/// Inputs in [−3, 3] and constants in [−1, 1] for any expression.
fn arguments(expression: &Expression, len: usize) -> (Vec<Tensor<f64>>, Vec<f64>) {
    let input = |seed| Tensor::from_vec([len], check::noise(len, seed).iter().map(|x| 3.0 * x).collect());
    ((0..expression.inputs as u64).map(input).collect(), check::noise(expression.constants, 99))
}

#[test]
fn gradients_equal_central_differences() {
    for expression in all() {
        let (inputs, constants) = arguments(expression, 31);
        let result = gradients(|tape, vars| expression.apply(tape, vars, &constants), &inputs, check::TOLERANCE);
        result.unwrap_or_else(|mismatch| panic!("{}: {mismatch}", expression.name));
    }
}

#[test]
fn f32_agrees_with_f64() {
    for expression in all() {
        let (inputs, constants) = arguments(expression, 20_000);
        let mut tapes = (Tape::<f32>::new(Device::Cpu), Tape::<f64>::new(Device::Cpu));
        let vars32: Vec<Var> = inputs.iter().map(|input| tapes.0.leaf(input.cast())).collect();
        let vars64: Vec<Var> = inputs.iter().map(|input| tapes.1.leaf(input.clone())).collect();
        let y32 = expression.apply(&mut tapes.0, &vars32, &constants);
        let y64 = expression.apply(&mut tapes.1, &vars64, &constants);
        agree(tapes.0.value(y32), tapes.1.value(y64), 1e-6).unwrap();
        let g32 = tapes.0.backward(&[(y32, Tensor::full([20_000], 1.0))]);
        let g64 = tapes.1.backward(&[(y64, Tensor::full([20_000], 1.0))]);
        for (&var32, &var64) in vars32.iter().zip(&vars64) {
            agree(g32.get(var32).unwrap(), g64.get(var64).unwrap(), 1e-6).unwrap();
        }
    }
}

#[test]
fn sigmoid_is_stable_at_the_extremes() {
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let x = tape.leaf(Tensor::from_vec([4], vec![-1e30, -88.0, 0.0, 1e30]));
    let y = sigmoid(&mut tape, x);
    let values = tape.value(y).as_slice().to_vec();
    assert!(values[0] == 0.0 && values[1] > 0.0 && values[2] == 0.5 && values[3] == 1.0, "{values:?}");
    assert!(tape.backward(&[(y, Tensor::full([4], 1.0))]).get(x).unwrap().is_finite());
}

#[test]
fn every_kernel_is_valid_wgsl() {
    for expression in all() {
        validate(&expression.value_kernel()).unwrap_or_else(|error| panic!("{}: {error}", expression.name));
        for mask in 1..1 << expression.inputs {
            let needs: Vec<bool> = (0..expression.inputs).map(|input| mask & (1 << input) != 0).collect();
            let kernel = expression.gradient_kernel(&needs);
            validate(&kernel).unwrap_or_else(|error| panic!("{} {needs:?}: {error}", expression.name));
        }
    }
}

#[test]
fn the_wgsl_check_rejects_a_planted_fault() {
    let kernel = EXPRESSIONS[0].value_kernel().replacen("return a", "return 1u + a", 1);
    assert!(validate(&kernel).is_err());
}

#[test]
fn a_term_of_a_sum_passes_its_gradient_on() {
    let passed = |name: &str| {
        let expression = all().find(|expression| expression.name == name).expect("an expression of that name");
        (0..expression.inputs).map(|input| expression.passes_on(input)).collect::<Vec<bool>>()
    };
    assert_eq!(
        (passed("add"), passed("sub"), passed("mul")),
        (vec![true, true], vec![true, false], vec![false, false])
    );
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let [a, b] = [1.0, 2.0].map(|value| tape.leaf(Tensor::scalar(value)));
    let (sum, product) = (add(&mut tape, a, b), mul(&mut tape, a, b));
    let total = add(&mut tape, sum, product);
    let gradients = tape.backward(&[(total, Tensor::scalar(1.0))]);
    assert_eq!([a, b].map(|var| gradients.get(var).unwrap().as_slice()[0]), [3.0, 2.0]);
}

#[test]
fn elements_in_parts_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    for expression in all() {
        let (inputs, constants) = arguments(expression, 300);
        let inputs: Vec<Tensor<f32>> = inputs.iter().map(Tensor::cast).collect();
        let apply = |tape: &mut Tape<f32>, vars: &[Var]| vec![expression.apply(tape, vars, &constants)];
        let split = assert_equal_in_parts(|| bits(&run(Device::Gpu(gpu), &inputs, apply)));
        let has_gradient_kernel = (0..expression.inputs).any(|input| !expression.passes_on(input));
        // An adapter that allows few arrays cannot bind two parts of each array of a gradient.
        let all = 1 + usize::from(has_gradient_kernel);
        let fewest = if gpu.arrays_per_kernel() >= 16 { all } else { 1 };
        assert!((fewest..=all).contains(&split), "{}: {split}", expression.name);
    }
}
