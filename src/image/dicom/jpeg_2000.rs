//! What a JPEG 2000 codestream says of its size (ISO/IEC 15444-1 annex A.5), looked at before the decoder, which trusts it, writes its samples.

/// Start of a codestream and of its size segment.
const START: [u8; 4] = [0xFF, 0x4F, 0xFF, 0x51];

/// Checks that a frame holds one grey picture of `shape`, columns and rows.
///
/// # Errors
/// Says what it holds instead.
pub(super) fn check_size(frame: &[u8], shape: [usize; 2]) -> Result<(), String> {
    let start = frame.windows(START.len()).position(|bytes| bytes == START).ok_or("its JPEG 2000 codestream does not begin")?;
    let segment = frame.get(start + START.len()..start + START.len() + 41).ok_or("its JPEG 2000 header is cut off")?;
    let word = |at: usize| segment[at..at + 4].iter().fold(0_usize, |word, &byte| word << 8 | usize::from(byte));
    // Length (2 bytes) and capabilities (2), then the far corner and the origin of the picture; tiles take 16 bytes more, and the number of
    // components is followed by the first one's depth and steps across and down.
    let extent = [word(4).saturating_sub(word(12)), word(8).saturating_sub(word(16))];
    let components = usize::from(segment[36]) << 8 | usize::from(segment[37]);
    if components == 1 && extent == shape && segment[39..] == [1, 1] {
        return Ok(());
    }
    Err(format!(
        "its JPEG 2000 codestream holds {components} components of {} × {} pixels (every {} across, every {} down) where one of {} × {} is needed",
        extent[0], extent[1], segment[39], segment[40], shape[0], shape[1]
    ))
}
