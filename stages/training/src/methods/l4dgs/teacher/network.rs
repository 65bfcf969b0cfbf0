//! Three levels of central-difference convolutions (Yu et al. 2020) with dilations 1, 2 and 4, each at half the size of
//! the previous one: convolution, group normalisation, ReLU.

use shaders::networks::convolution::{Sampling, central_difference, convolution};
use shaders::networks::group_norm::group_norm;
use shaders::networks::pooling::average_pool;
use shaders::pointwise::relu;
use shaders::tape::{Real, Tape, Tensor, Var};

use super::super::settings::TeacherSettings;
use super::super::tokens::TokenGrid;
use crate::bases::layers::uniform;
use crate::data::Streams;
use crate::model::{ModelState, Variables};

/// Side length of the kernels.
const KERNEL: usize = 3;
/// Groups of the normalisation, if they divide the channels.
const GROUPS: usize = 8;

/// The convolution levels of the teacher.
pub(crate) struct Network<'a> {
    settings: &'a TeacherSettings,
}

impl<'a> Network<'a> {
    pub(crate) fn new(settings: &'a TeacherSettings) -> Self {
        Self { settings }
    }

    /// Total number of channels of all levels.
    pub(crate) fn outputs(&self) -> usize {
        self.settings.channels.iter().sum()
    }

    /// Adds `teacher.level_{0,1,2}.weight`, `.scale` and `.shift`; weights are initialised for ReLUs (He et al. 2015).
    pub(crate) fn insert<T: Real>(&self, state: &mut ModelState<T>, random: Streams) {
        let mut inputs = 3;
        for (level, &outputs) in self.settings.channels.iter().enumerate() {
            let bound = (6.0 / (KERNEL * KERNEL * inputs) as f64).sqrt();
            let weight = name(level, "weight");
            let first = uniform(&[outputs, KERNEL, KERNEL, inputs], -bound, bound, &mut random.tensor(&weight));
            state.insert(weight, first);
            state.insert(name(level, "scale"), Tensor::full([outputs], T::ONE));
            state.insert(name(level, "shift"), Tensor::zeros([outputs]));
            inputs = outputs;
        }
    }

    /// The output of every level as tokens [tokens, channels], for an image [H, W, 3].
    pub(crate) fn levels<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        grid: TokenGrid,
        image: Var,
    ) -> Vec<Var> {
        let mut x = grid.cell_image(tape, image);
        let mut levels = Vec::new();
        for (level, &channels) in self.settings.channels.iter().enumerate() {
            if level > 0 {
                let &[height, width, _] = tape.value(x).shape() else { unreachable!("an image") };
                x = average_pool(tape, x, height / 2, width / 2);
            }
            let weight = central_difference(tape, model.get(&name(level, "weight")), self.settings.theta);
            // No bias: the normalisation would cancel it.
            let no_bias = tape.constant(Tensor::zeros([channels]));
            x = convolution(tape, x, weight, no_bias, Sampling::same_size(KERNEL, 1 << level));
            let (scale, shift) = (model.get(&name(level, "scale")), model.get(&name(level, "shift")));
            x = group_norm(tape, x, scale, shift, groups(channels));
            x = relu(tape, x);
            levels.push(grid.pool(tape, x));
        }
        levels
    }
}

fn name(level: usize, part: &str) -> String {
    format!("teacher.level_{level}.{part}")
}

/// The largest number of groups up to [`GROUPS`] that divides the channels.
fn groups(channels: usize) -> usize {
    (1..=GROUPS).rev().find(|groups| channels.is_multiple_of(*groups)).unwrap_or(1)
}
