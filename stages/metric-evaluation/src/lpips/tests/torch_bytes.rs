//! Writer of files in the formats of `torch.save`.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};

use zip::write::SimpleFileOptions;

use crate::lpips::torch_file::Tensor;

type Table = BTreeMap<String, Tensor>;

/// Writes the format before version 1.6: pickles, then storages.
pub(crate) fn sequence(table: &Table) -> Vec<u8> {
    let mut bytes = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.".to_vec();
    bytes.extend(b"\x80\x02}q\x00(");
    text(&mut bytes, "protocol_version");
    bytes.extend(b"M\xe9\x03");
    text(&mut bytes, "little_endian");
    bytes.extend(b"\x88u.");
    bytes.extend(pickled(table));
    bytes.extend(b"\x80\x02]q\x00(");
    (0..table.len()).for_each(|key| text(&mut bytes, &key.to_string()));
    bytes.extend(b"e.");
    for tensor in table.values() {
        bytes.extend((tensor.values.len() as i64).to_le_bytes());
        bytes.extend(tensor.values.iter().flat_map(|value| value.to_le_bytes()));
    }
    bytes
}

/// Writes the format since version 1.6: an archive with one file per storage.
pub(crate) fn archive(table: &Table) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: String, content: &[u8]| {
        let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        archive.start_file(format!("model/{name}"), stored).unwrap();
        archive.write_all(content).unwrap();
    };
    add("data.pkl".into(), &pickled(table));
    add("byteorder".into(), b"little");
    for (key, tensor) in table.values().enumerate() {
        let content: Vec<u8> = tensor.values.iter().flat_map(|value| value.to_le_bytes()).collect();
        add(format!("data/{key}"), &content);
    }
    archive.finish().unwrap().into_inner()
}

/// Pickles an `OrderedDict` of tensors.
fn pickled(table: &Table) -> Vec<u8> {
    let mut bytes = b"\x80\x02ccollections\nOrderedDict\nq\x00)Rq\x01(".to_vec();
    for (key, (name, tensor)) in table.iter().enumerate() {
        text(&mut bytes, name);
        bytes.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut bytes, "storage");
        bytes.extend(b"ctorch\nFloatStorage\n");
        text(&mut bytes, &key.to_string());
        text(&mut bytes, "cpu");
        integer(&mut bytes, tensor.values.len());
        bytes.extend(b"tQK\x00(");
        tensor.shape.iter().for_each(|size| integer(&mut bytes, *size));
        bytes.extend(b"t(");
        let stride = |axis: usize| tensor.shape[axis + 1..].iter().product();
        (0..tensor.shape.len()).for_each(|axis| integer(&mut bytes, stride(axis)));
        bytes.extend(b"t\x89h\x00)RtR");
    }
    bytes.extend(b"u.");
    bytes
}

fn text(bytes: &mut Vec<u8>, text: &str) {
    bytes.push(b'X');
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(text.as_bytes());
}

fn integer(bytes: &mut Vec<u8>, value: usize) {
    bytes.push(b'J');
    bytes.extend((value as i32).to_le_bytes());
}
