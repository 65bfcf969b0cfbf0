//! The nested boxes of an MP4 or MOV file (ISO/IEC 14496-12, 4.2).

/// Bytes of the start of a box: its size and its name.
pub(super) const BOX_START: usize = 8;

/// The big-endian number at a place.
pub(super) fn number(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

/// The boxes in a box; ends at the first damaged one.
pub(super) fn boxes(bytes: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        let size = number(rest, 0)? as usize;
        let whole = rest.get(..size).filter(|_| size >= BOX_START)?;
        rest = &rest[size..];
        Some((&whole[4..BOX_START], &whole[BOX_START..]))
    })
}

pub(super) fn child<'a>(bytes: &'a [u8], name: &[u8; 4]) -> Option<&'a [u8]> {
    boxes(bytes).find(|(found, _)| found == name).map(|(_, content)| content)
}
