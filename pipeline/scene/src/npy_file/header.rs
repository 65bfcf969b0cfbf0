//! Headers of `.npy` files: a Python dictionary with the type, the order and the shape of an array.
//! Format: NumPy enhancement proposal 1, versions 1.0 to 3.0.

use std::io::{self, Read};

const MAGIC: &[u8] = b"\x93NUMPY";

/// Longest header in bytes; NumPy itself refuses longer ones.
const MAX_BYTES: usize = 10_000;

/// The description of the array in an `.npy` file.
#[derive(Debug, PartialEq)]
pub(super) struct Header {
    /// NumPy's name of the type, e.g. `<f4`; `records` for records.
    pub(super) descr: String,
    /// Whether the array is in column-major order.
    pub(super) is_fortran: bool,
    /// Size of every axis, outermost first.
    pub(super) shape: Vec<usize>,
}

impl Header {
    /// Reads a header; the first value follows it.
    pub(super) fn read(mut from: impl Read) -> io::Result<Self> {
        let mut start = [0; 8];
        from.read_exact(&mut start)?;
        let length = match (start[..6] == *MAGIC, start[6]) {
            (true, 1) => usize::from(u16::from_le_bytes(bytes(&mut from)?)),
            (true, 2 | 3) => u32::from_le_bytes(bytes(&mut from)?) as usize,
            _ => return Err(invalid("it does not begin like an .npy file of version 1, 2 or 3")),
        };
        if length > MAX_BYTES {
            return Err(invalid(&format!("its header has {length} bytes")));
        }
        let mut text = vec![0; length];
        from.read_exact(&mut text)?;
        let text = String::from_utf8(text).map_err(|_| invalid("its header is not text"))?;
        Self::parse(&text).ok_or_else(|| invalid(&format!("header {:?}", text.trim())))
    }

    fn parse(text: &str) -> Option<Self> {
        let descr = match value(text, "descr")? {
            records if records.starts_with('[') => "records",
            quoted => {
                let quote = quoted.chars().next().filter(|quote| ['\'', '"'].contains(quote))?;
                quoted[1..].split_once(quote)?.0
            }
        };
        let order = value(text, "fortran_order")?;
        let is_fortran = order.starts_with("True");
        let (shape, _) = value(text, "shape")?.strip_prefix('(')?.split_once(')')?;
        let sides = shape.split(',').map(str::trim).filter(|side| !side.is_empty());
        // Python 2 wrote long integers with an L.
        let shape = sides.map(|side| side.trim_end_matches('L').parse().ok()).collect::<Option<_>>()?;
        (is_fortran || order.starts_with("False")).then(|| Self { descr: descr.into(), is_fortran, shape })
    }
}

/// The text from the value of a key on.
fn value<'a>(dictionary: &'a str, key: &str) -> Option<&'a str> {
    let mut places = [format!("'{key}'"), format!("\"{key}\"")].into_iter();
    let after = places.find_map(|quoted| Some(dictionary.split_once(&quoted)?.1))?;
    Some(after.trim_start().strip_prefix(':')?.trim_start())
}

fn bytes<const N: usize>(from: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn invalid(reason: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_as_different_writers_format_them_are_read() {
        let parsed = |text| Header::parse(text).map(|header| (header.descr, header.is_fortran, header.shape));
        let expected = |shape: &[usize]| Some(("<f4".to_string(), false, shape.to_vec()));
        assert_eq!(parsed("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }"), expected(&[3, 4]));
        assert_eq!(parsed(r#"{"shape":(3L,),"descr":"<f4","fortran_order":False}"#), expected(&[3]));
        assert_eq!(parsed("{'descr': '<f4', 'fortran_order': False, 'shape': ()}"), expected(&[]));
        let records = parsed("{'descr': [('x', '<f4')], 'fortran_order': True, 'shape': (2,)}");
        assert_eq!(records, Some(("records".into(), true, vec![2])));
        for damaged in
            ["", "{'descr': '<f4', 'shape': (3,)}", "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}"]
        {
            assert_eq!(parsed(damaged), None, "{damaged}");
        }
    }

    #[test]
    fn a_header_longer_than_its_file_is_refused() {
        for file in [&b"\x93NUMPY\x01\x00\xff\x00{}"[..], b"\x93NUMPY\x02\x00\xff\xff\xff\xff", b"\x93NUMPY\x04\x00"] {
            assert!(Header::read(file).is_err());
        }
    }
}
