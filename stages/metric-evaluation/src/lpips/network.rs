//! The three image classifiers whose features LPIPS compares, up to the last compared layer.

use std::collections::BTreeMap;

use super::layers::{Activation, Convolution, Window, join, max_pool};
use super::torch_file::Tensor;

/// A classifier trained on ImageNet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Backbone {
    /// AlexNet ("One weird trick", Krizhevsky 2014).
    Alex,
    /// VGG-16 (Simonyan and Zisserman 2015).
    Vgg,
    /// SqueezeNet 1.1 (Iandola et al. 2016).
    Squeeze,
}

/// One layer, with its number in torchvision (`features.N`).
#[derive(Clone, Copy, Debug)]
enum Plan {
    /// A convolution and its ReLU.
    Convolution { number: usize, outputs: usize, window: Window },
    /// SqueezeNet's fire module: 1×1 to `squeezed` channels, then 1×1 and 3×3 to `expanded` channels each.
    Fire { number: usize, squeezed: usize, expanded: usize },
    /// Max pooling.
    Pool(Window),
    /// The features at this point are compared.
    Tap,
}

const fn convolution(number: usize, outputs: usize, size: usize, stride: usize, padding: usize) -> Plan {
    Plan::Convolution { number, outputs, window: Window { size, stride, padding, partial: false } }
}

const fn same3(number: usize, outputs: usize) -> Plan {
    convolution(number, outputs, 3, 1, 1)
}

const fn pool(size: usize, partial: bool) -> Plan {
    Plan::Pool(Window { size, stride: 2, padding: 0, partial })
}

const fn fire(number: usize, squeezed: usize, expanded: usize) -> Plan {
    Plan::Fire { number, squeezed, expanded }
}

const ALEX: &[Plan] = &[
    convolution(0, 64, 11, 4, 2),
    Plan::Tap,
    pool(3, false),
    convolution(3, 192, 5, 1, 2),
    Plan::Tap,
    pool(3, false),
    same3(6, 384),
    Plan::Tap,
    same3(8, 256),
    Plan::Tap,
    same3(10, 256),
    Plan::Tap,
];

const VGG: &[Plan] = &[
    same3(0, 64),
    same3(2, 64),
    Plan::Tap,
    pool(2, false),
    same3(5, 128),
    same3(7, 128),
    Plan::Tap,
    pool(2, false),
    same3(10, 256),
    same3(12, 256),
    same3(14, 256),
    Plan::Tap,
    pool(2, false),
    same3(17, 512),
    same3(19, 512),
    same3(21, 512),
    Plan::Tap,
    pool(2, false),
    same3(24, 512),
    same3(26, 512),
    same3(28, 512),
    Plan::Tap,
];

const SQUEEZE: &[Plan] = &[
    convolution(0, 64, 3, 2, 0),
    Plan::Tap,
    pool(3, true),
    fire(3, 16, 64),
    fire(4, 16, 64),
    Plan::Tap,
    pool(3, true),
    fire(6, 32, 128),
    fire(7, 32, 128),
    Plan::Tap,
    pool(3, true),
    fire(9, 48, 192),
    Plan::Tap,
    fire(10, 48, 192),
    Plan::Tap,
    fire(11, 64, 256),
    Plan::Tap,
    fire(12, 64, 256),
    Plan::Tap,
];

impl Backbone {
    fn plan(self) -> &'static [Plan] {
        match self {
            Self::Alex => ALEX,
            Self::Vgg => VGG,
            Self::Squeeze => SQUEEZE,
        }
    }

    /// Number of channels at each tap.
    pub(crate) fn tap_channels(self) -> Vec<usize> {
        let mut channels = 3;
        let mut taps = Vec::new();
        for plan in self.plan() {
            match *plan {
                Plan::Convolution { outputs, .. } => channels = outputs,
                Plan::Fire { expanded, .. } => channels = 2 * expanded,
                Plan::Pool(_) => (),
                Plan::Tap => taps.push(channels),
            }
        }
        taps
    }

    /// Names and shapes [outputs, inputs, window, window] of all convolutions.
    #[cfg(test)]
    pub(crate) fn convolutions(self) -> Vec<(String, [usize; 4])> {
        let mut channels = 3;
        let mut found = Vec::new();
        for plan in self.plan() {
            match *plan {
                Plan::Convolution { number, outputs, window } => {
                    found.push((format!("features.{number}"), [outputs, channels, window.size, window.size]));
                    channels = outputs;
                }
                Plan::Fire { number, squeezed, expanded } => {
                    for (name, shape) in [
                        ("squeeze", [squeezed, channels, 1, 1]),
                        ("expand1x1", [expanded, squeezed, 1, 1]),
                        ("expand3x3", [expanded, squeezed, 3, 3]),
                    ] {
                        found.push((format!("features.{number}.{name}"), shape));
                    }
                    channels = 2 * expanded;
                }
                Plan::Pool(_) | Plan::Tap => (),
            }
        }
        found
    }

    /// Whether an image of this size is large enough for all layers.
    pub(crate) fn fits(self, width: usize, height: usize) -> bool {
        let side = |input: usize| {
            self.plan().iter().try_fold(input, |side, plan| match plan {
                Plan::Convolution { window, .. } | Plan::Pool(window) => window.outputs(side),
                Plan::Fire { .. } | Plan::Tap => Some(side),
            })
        };
        side(width).is_some() && side(height).is_some()
    }
}

/// A layer with its weights.
enum Layer {
    Convolution(Convolution),
    Fire { squeeze: Convolution, expand1: Convolution, expand3: Convolution },
    Pool(Window),
    Tap,
}

/// The convolutional part of a classifier.
pub(crate) struct Network(Vec<Layer>);

impl Network {
    /// Builds the network from the tensors of a torchvision file (`features.N.weight`, …) without the classifier's head.
    ///
    /// # Errors
    /// The name of a tensor that is missing, has another shape, or is not finite.
    pub(crate) fn new(backbone: Backbone, tensors: &BTreeMap<String, Tensor>) -> Result<Self, String> {
        let mut channels = 3;
        let layer = |plan: &Plan| match *plan {
            Plan::Convolution { number, outputs, window } => {
                let layer = read(tensors, &format!("features.{number}"), window, channels, outputs)?;
                channels = outputs;
                Ok(Layer::Convolution(layer))
            }
            Plan::Fire { number, squeezed, expanded } => {
                let part = |name: &str, size: usize, inputs: usize, outputs: usize| {
                    let window = Window { size, stride: 1, padding: size / 2, partial: false };
                    read(tensors, &format!("features.{number}.{name}"), window, inputs, outputs)
                };
                let squeeze = part("squeeze", 1, channels, squeezed)?;
                let expand1 = part("expand1x1", 1, squeezed, expanded)?;
                let expand3 = part("expand3x3", 3, squeezed, expanded)?;
                channels = 2 * expanded;
                Ok(Layer::Fire { squeeze, expand1, expand3 })
            }
            Plan::Pool(window) => Ok(Layer::Pool(window)),
            Plan::Tap => Ok(Layer::Tap),
        };
        backbone.plan().iter().map(layer).collect::<Result<_, String>>().map(Self)
    }

    /// Passes two images through the network and calls `compare` with both features at every tap. The images advance
    /// together, so that at most two layers of each are in memory.
    pub(crate) fn compare(&self, mut pair: [Activation; 2], mut compare: impl FnMut(&[Activation; 2])) {
        for layer in &self.0 {
            match layer {
                Layer::Convolution(convolution) => pair = pair.map(|x| convolution.forward(&x)),
                Layer::Fire { squeeze, expand1, expand3 } => {
                    pair = pair.map(|x| {
                        let squeezed = squeeze.forward(&x);
                        join(&expand1.forward(&squeezed), &expand3.forward(&squeezed))
                    });
                }
                Layer::Pool(window) => pair = pair.map(|x| max_pool(&x, *window)),
                Layer::Tap => compare(&pair),
            }
        }
    }
}

fn read(
    tensors: &BTreeMap<String, Tensor>,
    name: &str,
    window: Window,
    inputs: usize,
    outputs: usize,
) -> Result<Convolution, String> {
    let weights = tensor(tensors, &format!("{name}.weight"), &[outputs, inputs, window.size, window.size])?;
    let bias = tensor(tensors, &format!("{name}.bias"), &[outputs])?;
    Ok(Convolution::new(window, inputs, weights, bias.to_vec()))
}

/// The values of a tensor, which must be finite and have this shape.
pub(crate) fn tensor<'a>(
    tensors: &'a BTreeMap<String, Tensor>,
    name: &str,
    shape: &[usize],
) -> Result<&'a [f32], String> {
    let found = tensors.get(name).ok_or_else(|| format!("tensor {name} is missing"))?;
    if found.shape != shape {
        return Err(format!("{name} has shape {:?} instead of {shape:?}", found.shape));
    }
    match found.values.iter().position(|value| !value.is_finite()) {
        None => Ok(&found.values),
        Some(at) => Err(format!("{name}[{at}] is {}", found.values[at])),
    }
}
