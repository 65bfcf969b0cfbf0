//! The harmonics in use: constant and higher coefficients, which are stored apart because their step sizes differ.

use shaders::tape::{Op, Real, Tape, Tensor, Var};

/// [N, 1, 3] and [N, R, 3] to [N, (degree + 1)², 3]: the constant coefficient followed by the first higher ones.
pub fn active_harmonics<T: Real>(tape: &mut Tape<T>, sh_dc: Var, sh_rest: Var, degree: usize) -> Var {
    let rest = (degree + 1).pow(2) - 1;
    let stored = tape.value(sh_rest).shape()[1];
    assert!(rest <= stored, "degree {degree} needs {rest} higher harmonics, the model stores {stored}");
    tape.apply_one(ActiveHarmonics { rest }, &[sh_dc, sh_rest])
}

struct ActiveHarmonics {
    rest: usize,
}

impl<T: Real> Op<T> for ActiveHarmonics {
    fn name(&self) -> &'static str {
        "active_harmonics"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [dc, rest] = inputs else { unreachable!("two inputs") };
        let active = 3 * self.rest;
        let mut joined = Vec::with_capacity(dc.rows() * (3 + active));
        for row in 0..dc.rows() {
            joined.extend_from_slice(dc.row(row));
            joined.extend_from_slice(&rest.row(row)[..active]);
        }
        vec![Tensor::from_vec([dc.rows(), 1 + self.rest, 3], joined)]
    }

    fn backward(
        &mut self,
        inputs: &[&Tensor<T>],
        _outputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
        _needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let Some(gradient) = output_grads[0] else { return vec![None, None] };
        let [dc, rest] = inputs else { unreachable!("two inputs") };
        let stored = rest.row_len();
        let mut to_dc = Vec::with_capacity(dc.len());
        let mut to_rest = Vec::with_capacity(rest.len());
        for row in 0..dc.rows() {
            let (first, higher) = gradient.row(row).split_at(3);
            to_dc.extend_from_slice(first);
            to_rest.extend_from_slice(higher);
            to_rest.resize((row + 1) * stored, T::ZERO);
        }
        vec![Some(Tensor::from_vec(dc.shape().to_vec(), to_dc)), Some(Tensor::from_vec(rest.shape().to_vec(), to_rest))]
    }
}

/// [N, 3·K] to [N, (degree + 1)², 3]: the first coefficients of rows that hold K of them.
pub fn leading_harmonics<T: Real>(tape: &mut Tape<T>, rows: Var, degree: usize) -> Var {
    tape.apply_one(LeadingHarmonics { count: (degree + 1).pow(2) }, &[rows])
}

struct LeadingHarmonics {
    count: usize,
}

impl<T: Real> Op<T> for LeadingHarmonics {
    fn name(&self) -> &'static str {
        "leading_harmonics"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let rows = inputs[0];
        let leading = (0..rows.rows()).flat_map(|row| &rows.row(row)[..3 * self.count]).copied().collect();
        vec![Tensor::from_vec([rows.rows(), self.count, 3], leading)]
    }

    fn backward(
        &mut self,
        inputs: &[&Tensor<T>],
        _outputs: &[&Tensor<T>],
        output_grads: &[Option<&Tensor<T>>],
        _needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let Some(gradient) = output_grads[0] else { return vec![None] };
        let stored = inputs[0].row_len();
        let mut to_rows = Vec::with_capacity(inputs[0].len());
        for row in 0..gradient.rows() {
            to_rows.extend_from_slice(gradient.row(row));
            to_rows.resize((row + 1) * stored, T::ZERO);
        }
        vec![Some(Tensor::from_vec(inputs[0].shape(), to_rows))]
    }
}
