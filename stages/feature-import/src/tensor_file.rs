//! One f32 tensor per safetensors file.

use std::path::Path;

use anyhow::{Context as _, ensure};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

/// The shape and the values, row-major, of the only tensor in the file.
pub fn read(path: &Path) -> anyhow::Result<(Vec<usize>, Vec<f32>)> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read the file: {}", path.display()))?;
    parse(&bytes).with_context(|| format!("not a tensor file: {}", path.display()))
}

fn parse(bytes: &[u8]) -> anyhow::Result<(Vec<usize>, Vec<f32>)> {
    let file = SafeTensors::deserialize(bytes)?;
    let tensors = file.tensors();
    let [(_, tensor)] = tensors.as_slice() else {
        anyhow::bail!("{} tensors where one is expected", tensors.len());
    };
    ensure!(tensor.dtype() == Dtype::F32, "{:?} values where f32 is expected", tensor.dtype());
    Ok((tensor.shape().to_vec(), bytemuck::pod_collect_to_vec(tensor.data())))
}

/// Writes one tensor called `name`; equal values give equal bytes.
pub fn write(path: &Path, name: &str, shape: &[usize], values: &[f32]) -> anyhow::Result<()> {
    let view = TensorView::new(Dtype::F32, shape.to_vec(), bytemuck::cast_slice(values))?;
    let bytes = safetensors::serialize([(name, view)], None)?;
    std::fs::write(path, bytes).with_context(|| format!("cannot write the file: {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_tensor_files_never_panic() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        write(&path, "tokens", &[2, 3, 4], &[0.5; 24]).unwrap();
        let refused = scene::mangle::refused(&path, 400, |path| read(path).map(drop));
        assert!(refused >= 150, "only {refused} of 400 damaged files were refused");
    }
}
