//! Safetensors files with one f32 tensor.

use std::path::Path;

use anyhow::{Context as _, ensure};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

/// Reads the shape and the row-major values of the only tensor in a file.
pub(crate) fn read(path: &Path) -> anyhow::Result<(Vec<usize>, Vec<f32>)> {
    let bytes = fs_err::read(path)?;
    parse(&bytes).with_context(|| format!("not a readable tensor file: {}", path.display()))
}

/// Decodes the only tensor of a file.
fn parse(bytes: &[u8]) -> anyhow::Result<(Vec<usize>, Vec<f32>)> {
    let file = SafeTensors::deserialize(bytes)?;
    let tensors = file.tensors();
    let [(_, tensor)] = tensors.as_slice() else {
        anyhow::bail!("{} tensors instead of one", tensors.len());
    };
    ensure!(tensor.dtype() == Dtype::F32, "{:?} values instead of f32", tensor.dtype());
    Ok((tensor.shape().to_vec(), bytemuck::pod_collect_to_vec(tensor.data())))
}

/// Writes one tensor with a name; equal values give equal bytes.
pub(crate) fn write(path: &Path, name: &str, shape: &[usize], values: &[f32]) -> anyhow::Result<()> {
    let view = TensorView::new(Dtype::F32, shape.to_vec(), bytemuck::cast_slice(values))?;
    let bytes = safetensors::serialize([(name, view)], None)?;
    Ok(fs_err::write(path, bytes)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_tensor_files_never_panic() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        write(&path, "tokens", &[2, 3, 4], &[0.5; 24]).unwrap();
        let refused = support::mangle::refused(&path, 400, |path| read(path).map(drop));
        assert!(refused >= 150, "only {refused} of 400 damaged files were refused");
    }
}
