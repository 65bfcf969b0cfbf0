//! Stanford PLY files: reads the `vertex` element as rows of f32, from any scalar type, ASCII or binary.
//!
//! The published crates allocate a map of boxed values per vertex, which is too slow for a million Gaussians with 62
//! properties each.

use std::path::{Path, PathBuf};

use crate::image_file::{read_file, write_file};
use crate::{Error, Result};

/// The encoding of values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyFormat {
    /// Text, one line per vertex.
    Ascii,
    /// Packed, little endian.
    BinaryLittleEndian,
    /// Packed, big endian.
    BinaryBigEndian,
}

/// A named property of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// Name in the header.
    pub name: String,
    value: Scalar,
    /// Type of the length, for list properties.
    list_length: Option<Scalar>,
}

/// The scalar types of the format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

/// An element that the header announces.
struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// An open PLY file: the parsed header and the undecoded body.
pub struct Ply {
    path: PathBuf,
    format: PlyFormat,
    elements: Vec<Element>,
    bytes: Vec<u8>,
    body_at: usize,
}

impl Property {
    /// A property of type `float` (32 bits).
    pub fn float(name: impl Into<String>) -> Self {
        Self { name: name.into(), value: Scalar::F32, list_length: None }
    }

    /// A property of type `uchar` (8 bits, unsigned).
    pub fn byte(name: impl Into<String>) -> Self {
        Self { name: name.into(), value: Scalar::U8, list_length: None }
    }

    /// Whether the values have a floating-point type.
    pub(crate) fn is_float(&self) -> bool {
        matches!(self.value, Scalar::F32 | Scalar::F64)
    }
}

impl Ply {
    /// Reads a file and parses its header.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = read_file(path)?;
        let blame = |reason: String| Error::new(format!("not a readable PLY file ({reason})")).at(path);
        let (format, elements, body_at) = parse_header(&bytes).map_err(blame)?;
        Ok(Self { path: path.into(), format, elements, bytes, body_at })
    }

    /// The number of vertices according to the header.
    fn vertex_count(&self) -> usize {
        self.vertex_element().map_or(0, |element| element.count)
    }

    /// The vertex property with a name, if the file has it.
    pub fn property(&self, name: &str) -> Option<&Property> {
        self.vertex_element()?.properties.iter().find(|property| property.name == name)
    }

    /// Decodes the named vertex properties to [vertices, names] values, converted to f32.
    pub fn vertices(&self, names: &[&str]) -> Result<Vec<f32>> {
        let blame = |reason: String| Error::new(format!("not a usable PLY file ({reason})")).at(&self.path);
        let element = self.vertex_element().ok_or_else(|| blame("no element vertex".into()))?;
        let position = |name: &&str| {
            let found = element.properties.iter().position(|property| property.name == *name);
            found.ok_or_else(|| blame(format!("vertices have no property {name}")))
        };
        let wanted = names.iter().map(position).collect::<Result<Vec<_>>>()?;
        let body = &self.bytes[self.body_at..];
        match self.format {
            PlyFormat::Ascii => {
                let text = std::str::from_utf8(body).map_err(|_| blame("the ASCII body is not UTF-8".into()))?;
                self.read_rows(&wanted, AsciiValues(text.split_ascii_whitespace())).map_err(blame)
            }
            PlyFormat::BinaryLittleEndian | PlyFormat::BinaryBigEndian => {
                let big_endian = self.format == PlyFormat::BinaryBigEndian;
                self.read_rows(&wanted, BinaryValues { bytes: body, big_endian }).map_err(blame)
            }
        }
    }

    fn vertex_element(&self) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == "vertex")
    }

    /// Decodes the body up to the last vertex and keeps the wanted properties.
    fn read_rows(&self, wanted: &[usize], mut values: impl Values) -> std::result::Result<Vec<f32>, String> {
        // The count in the header may be wrong: reserve no more than the body can hold.
        let mut rows = Vec::with_capacity(self.vertex_count().min(self.bytes.len()) * wanted.len());
        let mut row = Vec::new();
        for element in &self.elements {
            for index in 0..element.count {
                row.clear();
                for property in &element.properties {
                    let value = values.property(property);
                    row.push(value.ok_or_else(|| {
                        format!("{} {index} of {} is truncated or not a number", element.name, element.count)
                    })?);
                }
                if element.name == "vertex" {
                    rows.extend(wanted.iter().map(|at| row[*at]));
                }
            }
            if element.name == "vertex" {
                break;
            }
        }
        Ok(rows)
    }
}

/// Writes a file with the one element `vertex`; `values` yields its rows, one value per property.
pub fn write_ply(
    path: &Path,
    format: PlyFormat,
    properties: &[Property],
    count: usize,
    values: impl Iterator<Item = f32>,
) -> Result<()> {
    let mut bytes = header_text(format, properties, count).into_bytes();
    for (index, value) in values.enumerate() {
        let column = index % properties.len();
        match (format, properties[column].value) {
            (PlyFormat::Ascii, _) => {
                let end = if column + 1 == properties.len() { '\n' } else { ' ' };
                bytes.extend(format!("{value}{end}").bytes());
            }
            (_, Scalar::U8) => bytes.push(value as u8),
            (PlyFormat::BinaryLittleEndian, _) => bytes.extend(value.to_le_bytes()),
            (PlyFormat::BinaryBigEndian, _) => bytes.extend(value.to_be_bytes()),
        }
    }
    write_file(path, &bytes)
}

/// The header for `count` vertices.
fn header_text(format: PlyFormat, properties: &[Property], count: usize) -> String {
    let format = match format {
        PlyFormat::Ascii => "ascii",
        PlyFormat::BinaryLittleEndian => "binary_little_endian",
        PlyFormat::BinaryBigEndian => "binary_big_endian",
    };
    let mut text = format!("ply\nformat {format} 1.0\nelement vertex {count}\n");
    for property in properties {
        let kind = if property.value == Scalar::U8 { "uchar" } else { "float" };
        text += &format!("property {kind} {}\n", property.name);
    }
    text + "end_header\n"
}

/// Parses the header: the format, the elements and the offset of the body.
fn parse_header(bytes: &[u8]) -> std::result::Result<(PlyFormat, Vec<Element>, usize), String> {
    let (mut format, mut elements, mut at) = (None, Vec::<Element>::new(), 0);
    loop {
        let length = bytes[at..].iter().position(|byte| *byte == b'\n').ok_or("the header does not end")?;
        // A comment may be in any encoding.
        let line = String::from_utf8_lossy(&bytes[at..at + length]);
        let words: Vec<_> = line.split_ascii_whitespace().collect();
        let first = at == 0;
        at += length + 1;
        match words.as_slice() {
            ["ply"] if first => {}
            _ if first => return Err("no `ply` at the start".into()),
            ["format", name, _] => format = Some(parse_format(name)?),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| format!("{count} is not a count"))?;
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let element = elements.last_mut().ok_or("a property before any element")?;
                element.properties.push(parse_property(rest).ok_or_else(|| format!("cannot parse `{line}`"))?);
            }
            ["end_header"] => break,
            ["comment" | "obj_info", ..] | [] => {}
            _ => return Err(format!("cannot parse `{line}`")),
        }
    }
    // An element without properties has no bytes, so the body does not bound its count.
    if let Some(element) = elements.iter().find(|element| element.properties.is_empty()) {
        return Err(format!("element {} has no properties", element.name));
    }
    Ok((format.ok_or("the header names no format")?, elements, at))
}

fn parse_format(name: &str) -> std::result::Result<PlyFormat, String> {
    match name {
        "ascii" => Ok(PlyFormat::Ascii),
        "binary_little_endian" => Ok(PlyFormat::BinaryLittleEndian),
        "binary_big_endian" => Ok(PlyFormat::BinaryBigEndian),
        _ => Err(format!("unknown format {name}")),
    }
}

fn parse_property(words: &[&str]) -> Option<Property> {
    match words {
        ["list", length, value, name] => Some(Property {
            name: (*name).into(),
            value: Scalar::parse(value)?,
            list_length: Some(Scalar::parse(length)?),
        }),
        [value, name] => Some(Property { name: (*name).into(), value: Scalar::parse(value)?, list_length: None }),
        _ => None,
    }
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }
}

/// A decoder of consecutive values; `None` if the body ends early or a value does not parse.
trait Values {
    /// The next scalar.
    fn scalar(&mut self, kind: Scalar) -> Option<f64>;

    /// The next property as f32. A list is skipped and yields its length.
    fn property(&mut self, property: &Property) -> Option<f32> {
        let Some(length_kind) = property.list_length else {
            return self.scalar(property.value).map(|value| value as f32);
        };
        let length = self.scalar(length_kind)?;
        for _ in 0..length as usize {
            self.scalar(property.value)?;
        }
        Some(length as f32)
    }
}

/// Decoder of ASCII bodies.
struct AsciiValues<'a>(std::str::SplitAsciiWhitespace<'a>);

impl Values for AsciiValues<'_> {
    fn scalar(&mut self, _kind: Scalar) -> Option<f64> {
        self.0.next()?.parse().ok()
    }
}

/// Decoder of binary bodies.
struct BinaryValues<'a> {
    bytes: &'a [u8],
    big_endian: bool,
}

impl BinaryValues<'_> {
    /// The next N bytes in little-endian order.
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, tail) = self.bytes.split_first_chunk::<N>()?;
        self.bytes = tail;
        let mut value = *head;
        if self.big_endian {
            value.reverse();
        }
        Some(value)
    }
}

impl Values for BinaryValues<'_> {
    fn scalar(&mut self, kind: Scalar) -> Option<f64> {
        Some(match kind {
            Scalar::I8 => f64::from(i8::from_le_bytes(self.take()?)),
            Scalar::U8 => f64::from(u8::from_le_bytes(self.take()?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(self.take()?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.take()?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.take()?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.take()?)),
            Scalar::F32 => f64::from(f32::from_le_bytes(self.take()?)),
            Scalar::F64 => f64::from_le_bytes(self.take()?),
        })
    }
}

#[cfg(test)]
mod tests;
