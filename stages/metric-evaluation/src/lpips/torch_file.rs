//! Reader of tensor dictionaries in files of `torch.save`: the archive format since PyTorch 1.6, and the older sequence of
//! pickles. Published weights use both.

use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};

use super::pickle::{self, Storage, TensorView, Value};

/// The beginning of the older format: a pickle of a magic number, then a pickle of the version (1001).
const MAGIC: &[u8] = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.";
/// The beginning of an archive.
const ARCHIVE: &[u8] = b"PK\x03\x04";
/// Size of an f32 in bytes.
const VALUE_BYTES: usize = 4;

/// A row-major tensor.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tensor {
    /// Sizes, outermost first.
    pub(crate) shape: Vec<usize>,
    /// The values, row-major.
    pub(crate) values: Vec<f32>,
}

/// Reads the named f32 tensors of a file.
///
/// # Errors
/// A description of the damaged or unsupported part of the file.
pub(crate) fn read(bytes: &[u8]) -> Result<BTreeMap<String, Tensor>, String> {
    if let Some(rest) = bytes.strip_prefix(MAGIC) {
        read_sequence(rest)
    } else if bytes.starts_with(ARCHIVE) {
        read_archive(bytes)
    } else {
        Err("not a file of torch.save".into())
    }
}

/// Reads the older format: properties of the writing machine, the dictionary, the keys of its storages, then the length and
/// the values of each storage.
fn read_sequence(bytes: &[u8]) -> Result<BTreeMap<String, Tensor>, String> {
    let (machine, rest) = pickle::read(bytes)?;
    let little_endian = entries(&machine)?
        .iter()
        .any(|(key, value)| matches!((key, value), (Value::Text(key), Value::Int(1)) if key == "little_endian"));
    if !little_endian {
        return Err("the file was written with another byte order".into());
    }
    let (table, rest) = pickle::read(rest)?;
    let (keys, mut rest) = pickle::read(rest)?;
    let Value::List(keys) = keys else { return Err("the list of storages is missing".into()) };
    let mut storages = BTreeMap::new();
    for key in keys.borrow().iter() {
        let Value::Text(key) = key else { return Err("a storage has no name".into()) };
        let (len, values) = rest.split_first_chunk::<8>().ok_or("the file ends early")?;
        let bytes = usize::try_from(i64::from_le_bytes(*len)).ok().and_then(|len| len.checked_mul(VALUE_BYTES));
        let (values, after) = bytes.and_then(|bytes| values.split_at_checked(bytes)).ok_or("the file ends early")?;
        storages.insert(key.clone(), values.to_vec());
        rest = after;
    }
    tensors(&table, |storage| storages.get(&storage.key).cloned().ok_or_else(|| missing(storage)))
}

/// Reads the archive format: the dictionary is `NAME/data.pkl`, the storages are `NAME/data/KEY`.
fn read_archive(bytes: &[u8]) -> Result<BTreeMap<String, Tensor>, String> {
    let damaged = |error: zip::result::ZipError| format!("the archive is damaged ({error})");
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
    let names = archive.file_names().collect::<Result<Vec<_>, _>>().map_err(damaged)?;
    let table_file = names.iter().find(|name| name.ends_with("/data.pkl")).ok_or("the archive has no data.pkl")?;
    let folder = table_file.trim_end_matches("data.pkl").to_owned();
    drop(names);
    let mut file = |name: &str| {
        let file = archive.by_name(&format!("{folder}{name}")).map_err(damaged)?;
        let mut content = Vec::new();
        // torch.save does not compress, so no part is larger than the file.
        file.take(bytes.len() as u64).read_to_end(&mut content).map_err(|error| error.to_string())?;
        Ok::<_, String>(content)
    };
    if file("byteorder").is_ok_and(|order| order != b"little") {
        return Err("the file was written with another byte order".into());
    }
    let table = file("data.pkl")?;
    let (table, _) = pickle::read(&table)?;
    tensors(&table, |storage| file(&format!("data/{}", storage.key)).map_err(|_| missing(storage)))
}

fn missing(storage: &Storage) -> String {
    format!("storage {} is missing in the file", storage.key)
}

/// The tensors of a dictionary; `load` returns the bytes of a storage.
fn tensors(
    table: &Value,
    mut load: impl FnMut(&Storage) -> Result<Vec<u8>, String>,
) -> Result<BTreeMap<String, Tensor>, String> {
    let mut found = BTreeMap::new();
    for (key, value) in entries(table)? {
        let (Value::Text(name), Value::Tensor(view)) = (&key, value) else {
            return Err(format!("an entry is not a named tensor: {key:?}"));
        };
        let TensorView { storage, offset, shape } = view;
        let bytes = load(&storage)?;
        if bytes.len() != storage.len * VALUE_BYTES {
            return Err(format!("storage {} has {} bytes for {} values", storage.key, bytes.len(), storage.len));
        }
        let count: usize = shape.iter().product();
        let part = &bytes[offset * VALUE_BYTES..(offset + count) * VALUE_BYTES];
        let values = part.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        found.insert(name.clone(), Tensor { shape, values });
    }
    Ok(found)
}

fn entries(table: &Value) -> Result<Vec<(Value, Value)>, String> {
    let Value::Table(entries) = table else { return Err("the file is not a dictionary of tensors".into()) };
    Ok(entries.borrow().clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lpips::tests::torch_bytes;

    fn table() -> BTreeMap<String, Tensor> {
        let tensor = |shape: &[usize], first: f32| Tensor {
            shape: shape.to_vec(),
            values: (0..shape.iter().product::<usize>()).map(|at| first + at as f32).collect(),
        };
        [("features.0.weight".into(), tensor(&[2, 3, 1, 1], 0.5)), ("features.0.bias".into(), tensor(&[2], -7.0))]
            .into()
    }

    #[test]
    fn both_formats_read_back_equal() {
        assert_eq!(read(&torch_bytes::sequence(&table())).unwrap(), table());
        assert_eq!(read(&torch_bytes::archive(&table())).unwrap(), table());
    }

    #[test]
    fn other_files_are_refused() {
        let sequence = torch_bytes::sequence(&table());
        let replaced = |from: &[u8], to: &[u8]| {
            let at = sequence.windows(from.len()).position(|window| window == from).unwrap();
            let mut bytes = sequence.clone();
            bytes[at..at + from.len()].copy_from_slice(to);
            read(&bytes).unwrap_err()
        };
        assert!(replaced(b"_rebuild_tensor_v2", b"_rebuild_sensor_v2").contains("is not supported"));
        assert!(replaced(b"FloatStorage", b"FloatStorags").contains("instead of 32-bit floats"));
        assert!(replaced(b"little_endian", b"little_indian").contains("byte order"));
        assert!(read(b"no torch").unwrap_err().contains("torch.save"));
        let mut longer = table();
        longer.get_mut("features.0.bias").unwrap().shape = vec![3];
        assert!(read(&torch_bytes::sequence(&longer)).unwrap_err().contains("exceeds its storage of 2"));
    }

    /// Truncation at every byte and a change of every byte give an error or other numbers, never a panic.
    #[test]
    fn damaged_files_never_panic() {
        for bytes in [torch_bytes::sequence(&table()), torch_bytes::archive(&table())] {
            for len in 0..bytes.len() {
                let mut changed = bytes.clone();
                changed[len] ^= 0x15;
                let _ = read(&changed);
                // Truncation removes the directory at the end of an archive.
                assert!(read(&bytes[..len]).is_err(), "{len} of {} bytes were read", bytes.len());
            }
        }
    }
}
