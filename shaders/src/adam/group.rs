use crate::tape::Tensor;

/// A parameter tensor with its Adam moments; density control adds and removes its rows (the first dimension).
///
/// The three tensors stay on the device that updated them last; edits on the host read them back first.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    name: String,
    tensor: Tensor<f32>,
    first_moment: Tensor<f32>,
    second_moment: Tensor<f32>,
    step: u64,
}

/// Everything a [`Group`] consists of, for checkpoints.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupState {
    /// The name of the group.
    pub name: String,
    /// The shape of the values and of both moments.
    pub shape: Vec<usize>,
    /// The values, row-major.
    pub values: Vec<f32>,
    /// The running mean of the gradient, row-major.
    pub first_moment: Vec<f32>,
    /// The running mean of the squared gradient, row-major.
    pub second_moment: Vec<f32>,
    /// The number of updates so far.
    pub step: u64,
}

impl Group {
    /// A group that has not been updated yet.
    pub fn new(name: impl Into<String>, tensor: Tensor<f32>) -> Self {
        let zeros = Tensor::zeros(tensor.shape());
        Self { name: name.into(), tensor, first_moment: zeros.clone(), second_moment: zeros, step: 0 }
    }

    /// The group that [`Group::state`] described. Panics if the lengths do not fit together.
    pub fn from_state(state: GroupState) -> Self {
        let GroupState { name, shape, values, first_moment, second_moment, step } = state;
        assert_eq!(first_moment.len(), values.len(), "adam: first moment of group {name:?}");
        assert_eq!(second_moment.len(), values.len(), "adam: second moment of group {name:?}");
        let [tensor, first_moment, second_moment] =
            [values, first_moment, second_moment].map(|data| Tensor::from_vec(shape.clone(), data));
        Self { name, tensor, first_moment, second_moment, step }
    }

    /// A copy of the values, the moments and the step, for a checkpoint.
    pub fn state(&self) -> GroupState {
        GroupState {
            name: self.name.clone(),
            shape: self.tensor.shape().to_vec(),
            values: self.tensor.as_slice().to_vec(),
            first_moment: self.first_moment.as_slice().to_vec(),
            second_moment: self.second_moment.as_slice().to_vec(),
            step: self.step,
        }
    }

    /// The name of the group.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The values.
    pub fn tensor(&self) -> &Tensor<f32> {
        &self.tensor
    }

    /// Replaces the values and keeps the moments. Panics if the shape differs.
    pub fn set_values(&mut self, tensor: Tensor<f32>) {
        assert_eq!(tensor.shape(), self.tensor.shape(), "another shape");
        self.tensor = tensor;
    }

    /// The values for writing, as for an opacity reset; the moments stay (see [`Group::reset_moments`]).
    pub fn values_mut(&mut self) -> &mut [f32] {
        self.tensor.make_mut()
    }

    /// The first dimension of the values.
    pub fn rows(&self) -> usize {
        self.tensor.rows()
    }

    /// The number of values per row.
    pub fn row_len(&self) -> usize {
        self.tensor.row_len()
    }

    /// Updates so far.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Resets the moments to zero; the step count, and with it the bias correction, continues.
    pub fn reset_moments(&mut self) {
        self.first_moment = Tensor::zeros(self.tensor.shape());
        self.second_moment = self.first_moment.clone();
    }

    /// Drops the rows whose flag is false, with their moments.
    pub fn keep_rows(&mut self, keep: &[bool]) {
        assert_eq!(keep.len(), self.rows(), "adam: one flag per row of group {:?}", self.name);
        let row_len = self.row_len();
        let kept = |data: &[f32]| -> Vec<f32> {
            let rows = data.chunks_exact(row_len).zip(keep).filter(|&(_, &keep)| keep);
            rows.flat_map(|(row, _)| row).copied().collect()
        };
        self.replace_rows(self.tensors().map(|tensor| kept(tensor.as_slice())));
    }

    /// Adds rows with zero moments; `rows` holds a whole number of rows.
    pub fn append_rows(&mut self, rows: &[f32]) {
        assert_eq!(rows.len() % self.row_len(), 0, "adam: incomplete row for group {:?}", self.name);
        let zeros = vec![0.0; rows.len()];
        let [values, first, second] = self.tensors().map(Tensor::as_slice);
        self.replace_rows([[values, rows].concat(), [first, &zeros].concat(), [second, &zeros].concat()]);
    }

    /// Values and moments of another number of rows.
    fn replace_rows(&mut self, data: [Vec<f32>; 3]) {
        let mut shape = self.tensor.shape().to_vec();
        shape[0] = data[0].len() / self.row_len();
        self.replace(data.map(|data| Tensor::from_vec(shape.clone(), data)));
    }

    /// Counts one more update and returns the new count. Without any other change, this is an update with zero gradient
    /// and zero moments.
    pub fn count_step(&mut self) -> u64 {
        self.step += 1;
        self.step
    }

    /// The values and the two moments.
    pub(super) fn tensors(&self) -> [&Tensor<f32>; 3] {
        [&self.tensor, &self.first_moment, &self.second_moment]
    }

    /// Values, first and second moments, mutable on the host.
    pub(super) fn slices_mut(&mut self) -> [&mut [f32]; 3] {
        [&mut self.tensor, &mut self.first_moment, &mut self.second_moment].map(Tensor::make_mut)
    }

    pub(super) fn replace(&mut self, [tensor, first_moment, second_moment]: [Tensor<f32>; 3]) {
        (self.tensor, self.first_moment, self.second_moment) = (tensor, first_moment, second_moment);
    }
}
