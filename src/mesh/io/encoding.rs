//! Binary arrays as VTK's XML files hold them: blocks of zlib, base64, little endian.

use std::io::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;

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
