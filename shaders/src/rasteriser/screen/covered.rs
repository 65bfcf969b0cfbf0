use scene::LabelMap;

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::rasteriser::binning::Lists;
use crate::rasteriser::render::Rendered;
use crate::tape::{Real, Tape, Tensor};

const COVERED: Kernel = Kernel { name: "covered centres", text: include_str!("covered.wgsl") };

uniforms! {
    struct MaskBlock as "Mask" {
        count: u32,
        width: u32,
        height: u32,
    }
}

/// 1 for every splat of a render that is visible and whose centre lies in a pixel with a label, otherwise 0: `[N]`.
pub fn covered<T: Real>(tape: &Tape<T>, rendered: &Rendered, labels: &LabelMap) -> Tensor<T> {
    let means_px = tape.value(rendered.means2d);
    match rendered.lists() {
        Lists::Gpu(lists) => covered_on_gpu(lists.rank_of_splat.gpu(), means_px, &lists.rank_of_splat, labels),
        Lists::Host(_) => covered_on_host(means_px, &rendered.visible(), labels),
    }
}

fn covered_on_host<T: Real>(means_px: &Tensor<T>, visible: &[bool], labels: &LabelMap) -> Tensor<T> {
    let [width, height] = [labels.width, labels.height];
    let has_label = |mean: &[T; 2]| {
        let [x, y] = mean.map(T::to_f64);
        let is_within = x >= 0.0 && y >= 0.0 && x < f64::from(width) && y < f64::from(height);
        is_within && labels.labels[y as usize * width as usize + x as usize] != 0
    };
    let splats = means_px.as_slice().as_chunks::<2>().0.iter().zip(visible);
    let flags = splats.map(|(mean, &visible)| if visible && has_label(mean) { T::ONE } else { T::ZERO });
    Tensor::from_vec([visible.len()], flags.collect())
}

fn covered_on_gpu<T: Real>(gpu: Gpu, means_px: &Tensor<T>, rank_of_splat: &GpuArray, labels: &LabelMap) -> Tensor<T> {
    // One bit per pixel.
    let word =
        |labels: &[u8]| labels.iter().enumerate().fold(0, |word, (at, &label)| word | u32::from(label != 0) << at);
    let words: Vec<u32> = labels.labels.chunks(32).map(word).collect();
    let (mask, count) = (GpuArray::upload(gpu, &words), rank_of_splat.len());
    let covered = GpuArray::new(gpu, count);
    let block = MaskBlock { count: count as u32, width: labels.width, height: labels.height };
    let read = [means_px.on_gpu(gpu), rank_of_splat, &mask].map(Binding::Read);
    let arrays = [&read[..], &[Binding::Write(&covered)]].concat();
    COVERED.launch(gpu, &[], &block, &arrays, Groups::Over(count));
    Tensor::from_gpu([count], covered)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::conformance::Disagreement;
    use crate::check::{agree, noise};
    use crate::gpu::fault_tests::assert_noticed;
    use crate::gpu::layout_tests::assert_valid;
    use crate::gpu::tests::test_gpu;
    use crate::rasteriser::render::render;
    use crate::rasteriser::render::scene_tests::{camera, cast, splats};
    use crate::rasteriser::settings::RasterSettings;
    use crate::tape::Device;

    /// Labels in blots, of a width that is no multiple of a word.
    fn labels() -> LabelMap {
        let label = |value: &f64| if *value > 0.2 { 3 } else { 0 };
        LabelMap { width: 45, height: 30, labels: noise(45 * 30, 4).iter().map(label).collect() }
    }

    #[test]
    fn what_is_hidden_outside_or_without_a_label_is_not_covered() {
        let labels = LabelMap { width: 2, height: 1, labels: vec![0, 5] };
        let means = vec![1.5, 0.5, 1.0, 0.0, 0.9, 0.5, 2.0, 0.5, 1.5, -0.1, 1.5, 1.0, f64::NAN, 0.5, 1.5, 0.5];
        let visible = [true, true, true, true, true, true, true, false];
        let found = covered_on_host(&Tensor::from_vec([8, 2], means), &visible, &labels);
        assert_eq!(found.as_slice(), [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    /// Compares the devices on a render of `count` splats, some of them invisible.
    fn compare(gpu: Gpu, count: usize) -> Result<usize, Disagreement> {
        let mut tape = Tape::new(Device::Gpu(gpu));
        let vars = cast::<f32>(&splats(count, -2.5, 3)).constants(&mut tape);
        let rendered = render(&mut tape, &vars, None, &camera(45, 30), &RasterSettings::default()).unwrap();
        let found = covered(&tape, &rendered, &labels());
        let expected = covered_on_host(tape.value(rendered.means2d), &rendered.visible(), &labels());
        let covered = expected.as_slice().iter().filter(|&&flag| flag > 0.0).count();
        let what = format!("the covered of {count} splats");
        agree(&found, &expected, 0.0).map(|()| covered).map_err(|mismatch| Disagreement { what, mismatch })
    }

    #[test]
    fn a_gpu_finds_the_same() {
        assert_valid::<MaskBlock>(&COVERED, &[]);
        let Some(gpu) = test_gpu() else { return };
        for count in [0, 1, 300, 2000] {
            let covered = compare(gpu, count).unwrap_or_else(|error| panic!("{error}"));
            assert!(count < 300 || 0 < covered && covered < count / 2, "{covered} of {count}");
        }
        let faults =
            [("== NOWHERE", "!= NOWHERE"), ("at % 32u", "at % 31u"), ("pixel.y * mask.width", "pixel.y * 46u")];
        assert_noticed(&faults.map(|(right, wrong)| (COVERED.name, right, wrong)), || compare(gpu, 2000));
    }
}
