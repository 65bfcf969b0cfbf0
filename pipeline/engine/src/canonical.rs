//! Canonical bytes: one byte string per JSON value, equal on every machine and in every version.

use serde_json::Value;

use crate::digest::Digest;

/// The canonical bytes of `value`.
#[cfg(test)]
pub(crate) fn bytes(value: &Value) -> Vec<u8> {
    let mut bytes = Vec::new();
    append(&mut bytes, value);
    bytes
}

/// SHA-256, in hex, of the canonical bytes of `value` in the domain `tag`, which names the kind and version of the
/// data.
pub(crate) fn sha256_hex(tag: &str, value: &Value) -> String {
    let mut message = Vec::new();
    append_text(&mut message, b's', tag);
    append(&mut message, value);
    Digest::of(&message).to_string()
}

/// Appends the canonical bytes of `value`: tagged, length-delimited, maps sorted by key, floats as IEEE bits.
///
/// Integers and floats differ (`1` is not `1.0`): a typed parameter serializes as one or the other, however the recipe
/// spells it. Negative zero equals zero. JSON has no NaN.
fn append(bytes: &mut Vec<u8>, value: &Value) {
    match value {
        Value::Null => bytes.push(b'n'),
        Value::Bool(value) => bytes.extend([b'b', u8::from(*value)]),
        Value::Number(number) => append_number(bytes, number),
        Value::String(text) => append_text(bytes, b's', text),
        Value::Array(items) => {
            append_count(bytes, b'a', items.len());
            items.iter().for_each(|item| append(bytes, item));
        }
        Value::Object(map) => {
            append_count(bytes, b'm', map.len());
            // The map keeps insertion order if any crate enables that feature of serde_json.
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_unstable_by_key(|(key, _)| key.as_str());
            for (key, value) in entries {
                append_text(bytes, b's', key);
                append(bytes, value);
            }
        }
    }
}

fn append_number(bytes: &mut Vec<u8>, number: &serde_json::Number) {
    // 128 bits hold both i64 and u64, so a value has the same encoding for either type.
    if let Some(integer) = number.as_i128() {
        bytes.push(b'i');
        bytes.extend(integer.to_le_bytes());
    } else {
        let float = number.as_f64().filter(|float| float.is_finite()).expect("JSON numbers are finite");
        let float = if float == 0.0 { 0.0 } else { float };
        bytes.push(b'f');
        bytes.extend(float.to_bits().to_le_bytes());
    }
}

fn append_text(bytes: &mut Vec<u8>, tag: u8, text: &str) {
    append_count(bytes, tag, text.len());
    bytes.extend(text.as_bytes());
}

fn append_count(bytes: &mut Vec<u8>, tag: u8, count: usize) {
    bytes.push(tag);
    bytes.extend((count as u64).to_le_bytes());
}
