//! NumPy `.npy` files with arrays of any shape.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use half::f16;

use crate::image_file::read_file;
use crate::{Error, Result};

mod header;

use header::Header;

/// Largest decompressed array: a cloud of 10 million points with 7 doubles each; protects against decompression bombs.
const MAX_MEMBER_BYTES: u64 = 560_000_000;

/// A decoded array.
#[derive(Clone, Debug, PartialEq)]
pub struct NpyArray {
    /// Size of every axis, outermost first.
    pub shape: Vec<usize>,
    /// Values in row-major order, for files in either order.
    pub values: Vec<f64>,
}

/// Reads an array of floats (half, single or double), integers, or booleans (0 and 1).
pub fn read(path: &Path) -> Result<NpyArray> {
    parse(&read_file(path)?, path)
}

/// Reads the array called `name` from an `.npz` archive, like [`read`].
pub fn read_member(path: &Path, name: &str) -> Result<NpyArray> {
    let mut archive = open_archive(path)?;
    let member = archive.by_name(&format!("{name}.npy")).map_err(|error| damaged(&error, path))?;
    if member.size() > MAX_MEMBER_BYTES {
        let message = format!("the array {name} has {} bytes, more than {MAX_MEMBER_BYTES}", member.size());
        return Err(Error::new(message).hint("store fewer frames, or single precision").at(path));
    }
    let mut bytes = Vec::new();
    member.take(MAX_MEMBER_BYTES).read_to_end(&mut bytes).map_err(|error| damaged(&error, path))?;
    parse(&bytes, path)
}

/// The shape of the array called `name` in an `.npz` archive, whose values are not read; `None` if it has no such array.
pub fn member_shape(path: &Path, name: &str) -> Result<Option<Vec<usize>>> {
    let mut archive = open_archive(path)?;
    let name = format!("{name}.npy");
    if archive.index_for_name(&name).is_none() {
        return Ok(None);
    }
    let member = archive.by_name(&name).map_err(|error| damaged(&error, path))?;
    let header = Header::read(BufReader::new(member)).map_err(|error| damaged(&error, path))?;
    Ok(Some(header.shape))
}

fn open_archive(path: &Path) -> Result<zip::ZipArchive<BufReader<File>>> {
    let file = File::open(path).map_err(|error| Error::new(format!("cannot read the file ({error})")).at(path))?;
    zip::ZipArchive::new(BufReader::new(file)).map_err(|error| damaged(&error, path))
}

/// Decodes the bytes of an `.npy` file, like [`read`]; errors name `path`.
pub fn parse(bytes: &[u8], path: &Path) -> Result<NpyArray> {
    let mut data = bytes;
    let Header { descr, is_fortran, shape } = Header::read(&mut data).map_err(|error| damaged(&error, path))?;
    // The shape in the header may be wrong: its product must neither overflow nor cause a huge allocation.
    let count = shape.iter().try_fold(1_usize, |count, side| count.checked_mul(*side));
    let count = count.filter(|count| *count <= data.len());
    let count = count.ok_or_else(|| damaged(&format!("shape {shape:?} in {} bytes", data.len()), path))?;
    let values = numbers(data, &descr, path)?;
    if values.len() < count {
        return Err(damaged(&format!("{} values for shape {shape:?}", values.len()), path));
    }
    let values = if is_fortran { row_major(&shape, &values[..count]) } else { values[..count].to_vec() };
    Ok(NpyArray { shape, values })
}

/// Decodes all values in the order of the file. `descr` is NumPy's name of their type, e.g. `<f4`.
fn numbers(data: &[u8], descr: &str, path: &Path) -> Result<Vec<f64>> {
    /// Values of N bytes each, from their little-endian bytes.
    fn decode<const N: usize>(data: &[u8], is_big: bool, value: fn([u8; N]) -> f64) -> Vec<f64> {
        let little = |bytes: &[u8; N]| {
            let mut bytes = *bytes;
            if is_big {
                bytes.reverse();
            }
            bytes
        };
        data.as_chunks::<N>().0.iter().map(|bytes| value(little(bytes))).collect()
    }
    let is_big = descr.starts_with('>');
    Ok(match descr.trim_start_matches(['<', '>', '|', '=']) {
        "f2" => decode(data, is_big, |bytes| f16::from_le_bytes(bytes).to_f64()),
        "f4" => decode(data, is_big, |bytes| f32::from_le_bytes(bytes).into()),
        "f8" => decode(data, is_big, f64::from_le_bytes),
        "b1" => decode(data, is_big, |[byte]| f64::from(byte != 0)),
        "i1" => decode(data, is_big, |bytes| i8::from_le_bytes(bytes).into()),
        "u1" => decode(data, is_big, |[byte]| byte.into()),
        "i2" => decode(data, is_big, |bytes| i16::from_le_bytes(bytes).into()),
        "u2" => decode(data, is_big, |bytes| u16::from_le_bytes(bytes).into()),
        "i4" => decode(data, is_big, |bytes| i32::from_le_bytes(bytes).into()),
        "u4" => decode(data, is_big, |bytes| u32::from_le_bytes(bytes).into()),
        "u8" => decode(data, is_big, |bytes| u64::from_le_bytes(bytes) as f64),
        "i8" => decode(data, is_big, |bytes| i64::from_le_bytes(bytes) as f64),
        "records" => return Err(Error::new("an array of records instead of numbers").at(path)),
        other => return Err(Error::new(format!("an array of type {other} instead of numbers")).at(path)),
    })
}

/// Reorders a column-major array to row-major order.
fn row_major(shape: &[usize], values: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(values.len());
    let mut index = vec![0; shape.len()];
    for _ in 0..values.len() {
        let at = index.iter().zip(shape).rev().fold(0, |at, (index, side)| at * side + index);
        out.push(values[at]);
        // Advance the index; the last axis is the fastest.
        for (index, side) in index.iter_mut().zip(shape).rev() {
            *index += 1;
            if *index < *side {
                break;
            }
            *index = 0;
        }
    }
    out
}

fn damaged(reason: &dyn std::fmt::Display, path: &Path) -> Error {
    Error::new(format!("not a readable NumPy array ({reason})")).hint("the file may be damaged").at(path)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The bytes of an `.npy` file with the given type and shape.
    pub(crate) fn npy_bytes(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
        let padded = format!("{header:<117}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((padded.len() as u16).to_le_bytes());
        bytes.extend(padded.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn read_bytes(bytes: &[u8]) -> Result<NpyArray> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("array.npy");
        std::fs::write(&path, bytes).unwrap();
        read(&path)
    }

    #[test]
    fn every_type_and_order_decodes_to_the_same_array() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let single: Vec<u8> = values.iter().flat_map(|value| (*value as f32).to_le_bytes()).collect();
        let double: Vec<u8> = values.iter().flat_map(|value: &f64| value.to_be_bytes()).collect();
        let half: Vec<u8> = [0x3c00_u16, 0x4000, 0x4200, 0x4400, 0x4500, 0x4600].map(u16::to_le_bytes).concat();
        let integers = |bytes: usize| -> Vec<u8> {
            let padded = |value: u8| (0..bytes).map(move |at| if at == 0 { value } else { 0 });
            (1..=6).flat_map(padded).collect()
        };
        let types = ["|u1", "|i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8"].map(|descr| {
            let bytes = descr[2..].parse().unwrap();
            (descr, integers(bytes))
        });
        for (descr, data) in [("<f4", single), (">f8", double), ("<f2", half)].into_iter().chain(types) {
            let array = read_bytes(&npy_bytes(descr, false, "(1, 2, 3)", &data)).unwrap();
            assert_eq!((array.shape, array.values), (vec![1, 2, 3], values.to_vec()), "{descr}");
        }
        assert_eq!(read_bytes(&npy_bytes("|b1", false, "(2,)", &[1, 0])).unwrap().values, [1.0, 0.0]);
        assert_eq!(read_bytes(&npy_bytes("<i2", false, "(2,)", &[0xff, 0xff, 0, 1])).unwrap().values, [-1.0, 256.0]);
        let columns = read_bytes(&npy_bytes("|u1", true, "(2, 3)", &[1, 4, 2, 5, 3, 6])).unwrap();
        assert_eq!((columns.shape, columns.values), (vec![2, 3], values.to_vec()));
    }

    #[test]
    fn other_types_and_damaged_headers_are_rejected() {
        for (bytes, expected) in [
            (npy_bytes("<c8", false, "(1,)", &[0; 8]), "type c8"),
            (npy_bytes("|u1", false, "(7,)", &[0; 6]), "not a readable NumPy array"),
            (npy_bytes("|u1", false, "(4294967296, 4294967296)", &[0; 6]), "not a readable NumPy array"),
            (b"\x93NUMPX".to_vec(), "not a readable NumPy array"),
        ] {
            let message = read_bytes(&bytes).unwrap_err().to_string();
            assert!(message.contains(expected) && message.ends_with("array.npy"), "{message}");
        }
    }
}
