//! Files as OpenCV's `FileStorage` writes them.

use glam::{DMat3, DVec3};

/// The first lines, with a list of names.
pub(super) fn header(names: &[String]) -> String {
    let listed: String = names.iter().map(|name| format!("   - \"{name}\"\n")).collect();
    format!("%YAML:1.0\n---\nnames:\n{listed}")
}

/// A 3×3 matrix.
pub(super) fn matrix(key: &str, value: DMat3) -> String {
    entry(key, [3, 3], &value.transpose().to_cols_array())
}

/// A 3×1 matrix.
pub(super) fn vector(key: &str, value: DVec3) -> String {
    entry(key, [3, 1], &value.to_array())
}

/// A matrix of any shape, in row-major order; three numbers per line, as OpenCV breaks them.
pub(super) fn entry(key: &str, [rows, cols]: [usize; 2], values: &[f64]) -> String {
    let lines: Vec<String> = values
        .chunks(3)
        .map(|line| line.iter().map(|value| format!("{value:.16e}")).collect::<Vec<_>>().join(", "))
        .collect();
    let data = lines.join(",\n       ");
    format!("{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n")
}
