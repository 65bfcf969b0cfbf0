//! The teacher: visual tokens of an image, modulated by language, that the Gaussians' semantic features follow.
//!
//! A network of central-difference convolutions encodes the image at three levels. Its tokens, and imported visual
//! tokens if a frame has them, attend to the prompts (top-k attention, the modulation X′ = X + Attention(X, text)) and
//! then to each other (the sparse multi-head self-attention of equations 1 and 2, with the output SMSA). The teacher is
//! trained before `fine`, to decode every token to the image content at its place, and then frozen: if it were trained
//! on the semantic losses, their optimum would be zero everywhere.

mod network;
mod reconstruction;

use shaders::arrays::rows::{concat_columns, normalize};
use shaders::networks::attention::{TopKAttention, top_k_attention};
use shaders::networks::linear::Activation;
use shaders::pointwise::{add, scale};
use shaders::tape::{Real, Tape, Tensor, Var};

use super::settings::TeacherSettings;
use super::tokens::TokenGrid;
use crate::bases::layers::{FirstWeights, apply_layer, apply_matrix, insert_layer, insert_matrix};
use crate::data::Streams;
use crate::model::{ModelState, Variables};
use network::Network;

/// Prefix of the teacher's tensors.
pub(crate) const TEACHER: &str = "teacher";
/// Embeddings of the prompts, [P, E]; never trained.
pub(crate) const TEXT: &str = "teacher.prompts";
/// Lower bound of the norm when features are normalised.
const MIN_NORM: f64 = 1e-6;
/// Mean and standard deviation of the three colour channels.
const COLOR_STATISTICS: usize = 6;

/// The teacher's layers. Optional ones are detected by their tensors in the model.
pub(crate) struct Teacher<'a> {
    settings: &'a TeacherSettings,
}

/// The teacher's output for one image.
pub(crate) struct TeacherOutput {
    /// [tokens, features]: SMSA, of unit length.
    pub features: Var,
    /// [tokens, tokens]: attention of every token to every other token, averaged over the heads.
    pub probabilities: Var,
}

impl<'a> Teacher<'a> {
    pub(crate) fn new(settings: &'a TeacherSettings) -> Self {
        Self { settings }
    }

    /// Adds the teacher's tensors: for visual tokens of `token_width` if frames have any, and for prompts [P, E] if the
    /// effect `language` is on.
    pub(crate) fn insert<T: Real>(
        &self,
        state: &mut ModelState<T>,
        token_width: Option<usize>,
        prompts: Option<Tensor<T>>,
        random: Streams,
    ) {
        let TeacherSettings { width, features, decoder_width, .. } = *self.settings;
        let network = Network::new(self.settings);
        network.insert(state, random);
        let mut layer = |name: &str, inputs: usize, outputs: usize| {
            insert_layer(state, &format!("{TEACHER}.{name}"), inputs, outputs, FirstWeights::Xavier, random);
        };
        layer("visual", network.outputs(), width);
        if let Some(token_width) = token_width {
            layer("tokens", token_width, width);
        }
        layer("decoder.0", features, decoder_width);
        layer("decoder.1", decoder_width, COLOR_STATISTICS + token_width.unwrap_or(0));
        if let Some(prompts) = &prompts {
            layer("text", prompts.row_len(), width);
        }
        let mut matrix = |name: &str, outputs: usize| {
            insert_matrix(state, &format!("{TEACHER}.{name}"), width, outputs, random);
        };
        for part in ["query", "key", "value"] {
            matrix(&format!("attention.{part}"), width);
            if prompts.is_some() {
                matrix(&format!("modulation.{part}"), width);
            }
        }
        matrix("attention.output", features);
        if let Some(prompts) = prompts {
            state.insert(TEXT, prompts);
        }
    }

    /// Encodes an image [H, W, 3], with the frame's visual tokens [tokens, F], of unit length, if it has any.
    pub(crate) fn observe<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        grid: TokenGrid,
        image: Var,
        visual_tokens: Option<Var>,
    ) -> TeacherOutput {
        let levels = Network::new(self.settings).levels(tape, model, grid, image);
        let joined = concat_columns(tape, &levels);
        let mut tokens = apply_layer(tape, model, "teacher.visual", joined, Activation::Identity);
        if let (Some(visual_tokens), true) = (visual_tokens, Self::reads_visual_tokens(model)) {
            // Values of order 1, like the network's outputs.
            let length = (tape.value(visual_tokens).row_len() as f64).sqrt();
            let visual_tokens = scale(tape, visual_tokens, length);
            let projected = apply_layer(tape, model, "teacher.tokens", visual_tokens, Activation::Identity);
            tokens = add(tape, tokens, projected);
        }
        if let Some(prompts) = model.find(TEXT) {
            let text = apply_layer(tape, model, "teacher.text", prompts, Activation::Identity);
            let modulation = self.attend(tape, model, "modulation", [tokens, text], self.settings.text_top_k);
            tokens = add(tape, tokens, modulation.mixed);
        }
        let attention = self.attend(tape, model, "attention", [tokens, tokens], self.settings.top_k);
        let features = apply_matrix(tape, model, "teacher.attention.output", attention.mixed);
        // Unit length: otherwise the teacher's arbitrary scale would weight every loss that follows it.
        let features = normalize(tape, features, MIN_NORM);
        TeacherOutput { features, probabilities: attention.probabilities }
    }

    /// Decodes the directions of semantic features [M, features] to [M, 6 + F]: mean and standard deviation of the
    /// colours, and a visual token.
    fn decode<T: Real>(tape: &mut Tape<T>, model: &Variables, features: Var) -> Var {
        let directions = normalize(tape, features, MIN_NORM);
        let hidden = apply_layer(tape, model, "teacher.decoder.0", directions, Activation::Relu);
        apply_layer(tape, model, "teacher.decoder.1", hidden, Activation::Identity)
    }

    /// Whether the model's teacher was trained with visual tokens.
    pub(crate) fn reads_visual_tokens(model: &Variables) -> bool {
        model.find("teacher.tokens.weight").is_some()
    }

    fn attend<T: Real>(
        &self,
        tape: &mut Tape<T>,
        model: &Variables,
        name: &str,
        [from, to]: [Var; 2],
        k: usize,
    ) -> TopKAttention {
        let mut project = |part: &str, x: Var| apply_matrix(tape, model, &format!("{TEACHER}.{name}.{part}"), x);
        let projected = [project("query", from), project("key", to), project("value", to)];
        let valid = vec![true; tape.value(to).rows()];
        top_k_attention(tape, projected, &valid, self.settings.heads, k)
    }
}
