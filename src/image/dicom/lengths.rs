//! The lengths that a DICOM file's elements say to have, held against the file before anything is read: a damaged length of gigabytes would
//! otherwise be set aside in memory first and found missing afterwards.

const ITEM: [u16; 2] = [0xFFFE, 0xE000];
const ITEM_END: [u16; 2] = [0xFFFE, 0xE00D];
const SEQUENCE_END: [u16; 2] = [0xFFFE, 0xE0DD];
const TRANSFER_SYNTAX: [u16; 2] = [0x0002, 0x0010];
const PIXEL_DATA: [u16; 2] = [0x7FE0, 0x0010];
const UNDEFINED: u32 = u32::MAX;

/// Value representations whose length has two bytes in explicit syntaxes (PS3.5 §7.1.2).
const SHORT: [&[u8; 2]; 21] = [
    b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FL", b"FD", b"IS", b"LO", b"LT", b"PN", b"SH", b"SL", b"SS", b"ST", b"TM", b"UI",
    b"UL", b"US",
];

/// Value representations of four bytes of length; what is none of all these is taken for UN, which has four, too.
const SEQUENCE: &[u8; 2] = b"SQ";

/// How elements are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Syntax {
    ExplicitLittle,
    ExplicitBig,
    ImplicitLittle,
}

/// Whether a file can be one of DICOM: it says so after its preamble, or at its start.
pub(super) fn says_to_be_dicom(bytes: &[u8]) -> bool {
    start(bytes).is_some()
}

/// Where the first element stands.
fn start(bytes: &[u8]) -> Option<usize> {
    [132, 4].into_iter().find(|&start| bytes.get(start - 4..start) == Some(b"DICM"))
}

/// Walks from element to element, into sequences and items.
///
/// # Errors
/// Names the first element that says to be longer than what is left of the file.
pub(super) fn check_lengths(bytes: &[u8]) -> Result<(), String> {
    let mut at = start(bytes).unwrap_or(bytes.len());
    let (mut syntax, mut of_data, mut is_fragments) = (Syntax::ExplicitLittle, Syntax::ExplicitLittle, false);
    loop {
        // The data follow the file's own group, 2, in the syntax that it names.
        if bytes.get(at..at + 2) != Some(&[2, 0]) {
            syntax = of_data;
        }
        let Some(header) = Header::read(bytes, at, syntax) else { return Ok(()) };
        let value = at + header.size;
        let left = bytes.len() - value;
        let is_entered = match header.tag {
            ITEM => !is_fragments,
            ITEM_END => true,
            SEQUENCE_END => {
                is_fragments = false;
                true
            }
            PIXEL_DATA if header.length == UNDEFINED => {
                is_fragments = true;
                true
            }
            _ => header.is_sequence || header.length == UNDEFINED,
        };
        if is_entered {
            at = value;
            continue;
        }
        let length = header.length as usize;
        if length > left {
            let [group, element] = header.tag;
            return Err(format!(
                "element ({group:04X},{element:04X}) says to be {length} bytes long where {left} are left; the file is damaged"
            ));
        }
        if header.tag == TRANSFER_SYNTAX {
            match bytes[value..value + length].trim_ascii_end() {
                // What is compressed as a whole is not walked.
                name if name.starts_with(b"1.2.840.10008.1.2.1.99") => return Ok(()),
                name => of_data = syntax_of(name),
            }
        }
        at = value + length;
    }
}

fn syntax_of(name: &[u8]) -> Syntax {
    match name.strip_suffix(b"\0").unwrap_or(name) {
        b"1.2.840.10008.1.2" => Syntax::ImplicitLittle,
        b"1.2.840.10008.1.2.2" => Syntax::ExplicitBig,
        _ => Syntax::ExplicitLittle,
    }
}

/// What stands before a value.
struct Header {
    tag: [u16; 2],
    /// Bytes before the value.
    size: usize,
    length: u32,
    is_sequence: bool,
}

impl Header {
    /// The header at a place; none at the end of the file.
    fn read(bytes: &[u8], at: usize, syntax: Syntax) -> Option<Self> {
        let short = |from: usize| {
            let pair = bytes.get(from..from + 2)?.try_into().ok()?;
            Some(if syntax == Syntax::ExplicitBig { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) })
        };
        let long = |from: usize| {
            let four = bytes.get(from..from + 4)?.try_into().ok()?;
            Some(if syntax == Syntax::ExplicitBig { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) })
        };
        let tag = [short(at)?, short(at + 2)?];
        let representation: [u8; 2] = bytes.get(at + 4..at + 6)?.try_into().ok()?;
        let (size, length, is_sequence) = if tag[0] == ITEM[0] || syntax == Syntax::ImplicitLittle {
            (8, long(at + 4)?, false)
        } else if SHORT.contains(&&representation) {
            (8, u32::from(short(at + 6)?), false)
        } else {
            (12, long(at + 8)?, representation == *SEQUENCE)
        };
        Some(Self { tag, size, length, is_sequence })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of these data elements, in explicit little-endian syntax or the one of this name.
    fn file(syntax: &str, data: &[u8]) -> Vec<u8> {
        let name = format!("{syntax}{}", if syntax.len() % 2 == 1 { "\0" } else { "" });
        let meta = [&[2, 0, 0x10, 0][..], b"UI", &(name.len() as u16).to_le_bytes(), name.as_bytes()].concat();
        [&[0; 128][..], b"DICM", &meta, data].concat()
    }

    const EXPLICIT: &str = "1.2.840.10008.1.2.1";

    #[test]
    fn a_length_beyond_the_file_is_told_and_a_whole_file_is_walked_to_its_end() {
        let rows = [&[0x28, 0, 0x10, 0][..], b"US", &[2, 0], &[6, 0]].concat();
        let pixels = |length: u32| [&[0xE0, 0x7F, 0x10, 0][..], b"OW\0\0", &length.to_le_bytes(), &[7; 6]].concat();
        assert_eq!(check_lengths(&file(EXPLICIT, &[rows.clone(), pixels(6)].concat())), Ok(()));
        let told = check_lengths(&file(EXPLICIT, &[rows, pixels(3_000_000_000)].concat())).unwrap_err();
        assert!(told.contains("(7FE0,0010) says to be 3000000000 bytes long where 6 are left"), "{told}");
        assert!(!says_to_be_dicom(b"no DICOM file") && says_to_be_dicom(&file(EXPLICIT, &[])));
    }

    #[test]
    fn sequences_and_fragments_are_walked_through() {
        let undefined = UNDEFINED.to_le_bytes();
        let sequence = [&[8, 0, 0x40, 0x11][..], b"SQ\0\0", &undefined, &[0xFE, 0xFF, 0, 0xE0], &undefined].concat();
        let inner = |length: u16| [&[8, 0, 0x50, 0x11][..], b"UI", &length.to_le_bytes(), b"1.23"].concat();
        let ends = [[0xFE, 0xFF, 0x0D, 0xE0, 0, 0, 0, 0], [0xFE, 0xFF, 0xDD, 0xE0, 0, 0, 0, 0]].concat();
        assert_eq!(check_lengths(&file(EXPLICIT, &[sequence.clone(), inner(4), ends.clone()].concat())), Ok(()));
        assert!(check_lengths(&file(EXPLICIT, &[sequence, inner(400), ends.clone()].concat())).is_err());
        let fragment = |length: u32| [&[0xFE, 0xFF, 0, 0xE0][..], &length.to_le_bytes(), b"abcd"].concat();
        let pixels = [&[0xE0, 0x7F, 0x10, 0][..], b"OB\0\0", &undefined].concat();
        assert_eq!(check_lengths(&file(EXPLICIT, &[pixels.clone(), fragment(4), ends[8..].to_vec()].concat())), Ok(()));
        assert!(check_lengths(&file(EXPLICIT, &[pixels, fragment(4_000_000), ends[8..].to_vec()].concat())).is_err());
    }

    #[test]
    fn implicit_and_big_endian_data_are_walked_too() {
        let implicit = |length: u32| [&[0x28, 0, 0x10, 0][..], &length.to_le_bytes(), &[6, 0]].concat();
        assert_eq!(check_lengths(&file("1.2.840.10008.1.2", &implicit(2))), Ok(()));
        assert!(check_lengths(&file("1.2.840.10008.1.2", &implicit(2_000_000))).is_err());
        let big = |length: u16| [&[0, 0x28, 0, 0x10][..], b"US", &length.to_be_bytes(), &[0, 6]].concat();
        assert_eq!(check_lengths(&file("1.2.840.10008.1.2.2", &big(2))), Ok(()));
        assert!(check_lengths(&file("1.2.840.10008.1.2.2", &big(2000))).is_err());
    }
}
