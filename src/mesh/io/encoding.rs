//! Arrays as VTK's XML files hold them: text, or blocks of bytes in base64 or raw, in the file or appended, plain or in zlib.

use std::io::{Read, Write};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;

use super::xml::Element;

/// Bytes a block before compression, VTK's own default.
const BLOCK_BYTES: usize = 32_768;

/// Base64 of the zlib-compressed bytes: a header of 64-bit numbers (blocks, block size, size of the last partial block, compressed size of
/// each) and the blocks.
pub(super) fn encode_compressed(bytes: &[u8]) -> std::io::Result<String> {
    let mut header = vec![bytes.len().div_ceil(BLOCK_BYTES) as u64, BLOCK_BYTES as u64, (bytes.len() % BLOCK_BYTES) as u64];
    let mut body = Vec::with_capacity(bytes.len() / 2);
    for block in bytes.chunks(BLOCK_BYTES) {
        let start = body.len();
        let mut encoder = ZlibEncoder::new(&mut body, Compression::fast());
        encoder.write_all(block)?;
        encoder.finish()?;
        header.push((body.len() - start) as u64);
    }
    let header: Vec<u8> = header.into_iter().flat_map(u64::to_le_bytes).collect();
    Ok(STANDARD.encode(header) + &STANDARD.encode(body))
}

/// How a file encodes its arrays.
pub(super) struct Encoding<'a> {
    header_bytes: usize,
    is_compressed: bool,
    is_big_endian: bool,
    appended: Option<(&'a [u8], bool)>,
}

impl<'a> Encoding<'a> {
    /// From the attributes of the `VTKFile` element and its `AppendedData`.
    pub(super) fn of(file: &'a Element<'a>) -> Result<Self, String> {
        let is_compressed = match file.attribute("compressor") {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => return Err(format!("its compressor {other} is not supported; write it with zlib or without compression")),
        };
        let appended = match file.child("AppendedData") {
            None => None,
            Some(element) => {
                let mark = element.text.iter().position(|&b| b == b'_').ok_or("its appended data do not begin with '_'")?;
                Some((&element.text[mark + 1..], element.attribute("encoding") != Some("base64")))
            }
        };
        Ok(Self {
            header_bytes: if file.attribute("header_type") == Some("UInt64") { 8 } else { 4 },
            is_compressed,
            is_big_endian: file.attribute("byte_order") == Some("BigEndian"),
            appended,
        })
    }

    /// The numbers of a `DataArray`, `count` of them.
    pub(super) fn numbers(&self, array: &Element, count: usize) -> Result<Vec<f64>, String> {
        let name = array.attribute("Name").unwrap_or("without a name");
        let kind = NumberKind::named(array.attribute("type").unwrap_or("")).ok_or_else(|| format!("array {name}: unknown type"))?;
        let numbers = match array.attribute("format") {
            Some("ascii") | None => ascii(array.text)?,
            Some("binary") => {
                let text: Vec<u8> = array.text.iter().copied().filter(|b| !b.is_ascii_whitespace()).collect();
                kind.numbers(&self.bytes(&text, false).map_err(|reason| format!("array {name}: {reason}"))?, self.is_big_endian)
            }
            Some("appended") => {
                let (data, is_raw) = self.appended.ok_or_else(|| format!("array {name} is appended, but the file has no appended data"))?;
                let offset = array.attribute("offset").and_then(|o| o.trim().parse::<usize>().ok());
                let data = offset.and_then(|offset| data.get(offset..)).ok_or_else(|| format!("array {name} begins beyond the data"))?;
                kind.numbers(&self.bytes(data, is_raw).map_err(|reason| format!("array {name}: {reason}"))?, self.is_big_endian)
            }
            Some(other) => return Err(format!("array {name}: unknown format {other}")),
        };
        if numbers.len() == count {
            Ok(numbers)
        } else {
            Err(format!("array {name} has {} numbers where {count} are needed; is it truncated?", numbers.len()))
        }
    }

    /// The bytes behind a block header.
    fn bytes(&self, data: &[u8], is_raw: bool) -> Result<Vec<u8>, String> {
        let size = self.header_bytes;
        if !self.is_compressed {
            let length = self.header_number(&stretch(data, 0, size, is_raw)?.0, 0)?;
            let bytes = stretch(data, 0, size.saturating_add(length), is_raw)?.0;
            return Ok(bytes[size..].to_vec());
        }
        let block_count = self.header_number(&stretch(data, 0, size, is_raw)?.0, 0)?;
        let (header, body_start) = stretch(data, 0, block_count.saturating_add(3).saturating_mul(size), is_raw)?;
        let mut block_ends = vec![0_usize];
        for block in 0..block_count {
            let length = self.header_number(&header, 3 + block)?;
            block_ends.push(block_ends[block].checked_add(length).ok_or("a block is too long")?);
        }
        let body = stretch(data, body_start, block_ends[block_count], is_raw)?.0;
        let mut bytes = vec![];
        for ends in block_ends.windows(2) {
            // A block cannot be larger than the header says, so that a forged file cannot fill the memory.
            let limit = self.header_number(&header, 1)? as u64;
            let block = ZlibDecoder::new(&body[ends[0]..ends[1]]);
            block.take(limit).read_to_end(&mut bytes).map_err(|error| format!("a compressed block is damaged: {error}"))?;
        }
        Ok(bytes)
    }

    fn header_number(&self, header: &[u8], index: usize) -> Result<usize, String> {
        let size = self.header_bytes;
        let bytes = index.checked_mul(size).and_then(|start| header.get(start..start + size)).ok_or("its header is cut off")?;
        let in_order = |value: u64, &byte: &u8| value << 8 | u64::from(byte);
        let value = if self.is_big_endian { bytes.iter().fold(0, in_order) } else { bytes.iter().rev().fold(0, in_order) };
        usize::try_from(value).map_err(|_| "a length in its header is senseless".to_string())
    }
}

/// `length` bytes that begin at the character `start`, and the character after them.
fn stretch(data: &[u8], start: usize, length: usize, is_raw: bool) -> Result<(Vec<u8>, usize), String> {
    let characters = if is_raw { length } else { length.div_ceil(3).saturating_mul(4) };
    let end = start.saturating_add(characters);
    if is_raw {
        let bytes = data.get(start..end).ok_or("its data end too early; is the file truncated?")?;
        return Ok((bytes.to_vec(), end));
    }
    let slice = data.get(start..end.min(data.len())).ok_or("its data end too early; is the file truncated?")?;
    let mut bytes = vec![];
    for group in slice.chunks(4) {
        match STANDARD.decode(group) {
            Ok(decoded) => bytes.extend(decoded),
            Err(_) => break,
        }
    }
    if bytes.len() < length {
        return Err("its base64 data end too early; is the file truncated?".into());
    }
    bytes.truncate(length);
    Ok((bytes, end))
}

fn ascii(text: &[u8]) -> Result<Vec<f64>, String> {
    let text = std::str::from_utf8(text).map_err(|_| "an array of text holds other bytes".to_string())?;
    text.split_ascii_whitespace().map(|word| word.parse().map_err(|_| format!("{word:?} is not a number"))).collect()
}

/// The type of the numbers of an array.
#[derive(Debug, Clone, Copy)]
pub(super) enum NumberKind {
    Int(usize),
    Unsigned(usize),
    Float32,
    Float64,
}

impl NumberKind {
    /// By the name in a VTK XML file.
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "Int8" => Self::Int(1),
            "Int16" => Self::Int(2),
            "Int32" => Self::Int(4),
            "Int64" => Self::Int(8),
            "UInt8" => Self::Unsigned(1),
            "UInt16" => Self::Unsigned(2),
            "UInt32" => Self::Unsigned(4),
            "UInt64" => Self::Unsigned(8),
            "Float32" => Self::Float32,
            "Float64" => Self::Float64,
            _ => return None,
        })
    }

    /// By the name in a legacy VTK file.
    pub(super) fn legacy(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "vtktypeint8" => Self::Int(1),
            "short" | "vtktypeint16" => Self::Int(2),
            "int" | "vtktypeint32" => Self::Int(4),
            "long" | "vtktypeint64" | "vtkIdType" => Self::Int(8),
            "bit" | "unsigned_char" | "vtktypeuint8" => Self::Unsigned(1),
            "unsigned_short" | "vtktypeuint16" => Self::Unsigned(2),
            "unsigned_int" | "vtktypeuint32" => Self::Unsigned(4),
            "unsigned_long" | "vtktypeuint64" => Self::Unsigned(8),
            "float" => Self::Float32,
            "double" => Self::Float64,
            _ => return None,
        })
    }

    /// Bytes of one number.
    pub(super) fn size(self) -> usize {
        match self {
            Self::Int(size) | Self::Unsigned(size) => size,
            Self::Float32 => 4,
            Self::Float64 => 8,
        }
    }

    /// As many whole numbers as the bytes hold.
    pub(super) fn numbers(self, bytes: &[u8], is_big_endian: bool) -> Vec<f64> {
        let bits = |chunk: &[u8]| {
            let in_order = |value: u64, &byte: &u8| value << 8 | u64::from(byte);
            if is_big_endian { chunk.iter().fold(0, in_order) } else { chunk.iter().rev().fold(0, in_order) }
        };
        let number = |chunk: &[u8]| match self {
            // Shifted to the top and back, the sign is carried along.
            Self::Int(size) => ((bits(chunk) << (64 - 8 * size)) as i64 >> (64 - 8 * size)) as f64,
            Self::Unsigned(_) => bits(chunk) as f64,
            Self::Float32 => f64::from(f32::from_bits(bits(chunk) as u32)),
            Self::Float64 => f64::from_bits(bits(chunk)),
        };
        bytes.chunks_exact(self.size()).map(number).collect()
    }
}
