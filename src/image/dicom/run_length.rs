//! DICOM's run-length compression (PS3.5 annex G), which its crate does not read without panicking on damaged files.

/// The pixels of one frame, little endian, `width` bytes each.
///
/// # Errors
/// Says what of the frame is damaged.
pub(super) fn decode(frame: &[u8], pixel_count: usize, width: usize) -> Result<Vec<u8>, String> {
    let word = |n: usize| frame.get(4 * n..4 * n + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let segment_count = word(0).ok_or("its run-length header is cut off")?;
    if segment_count != width {
        return Err(format!("it has {segment_count} run-length segments for pixels of {width} bytes"));
    }
    let mut bytes = vec![0; pixel_count * width];
    for segment in 0..segment_count {
        let start = word(segment + 1).filter(|start| *start <= frame.len()).ok_or("a run-length segment begins beyond its end")?;
        let end = word(segment + 2).filter(|_| segment + 1 < segment_count).unwrap_or(frame.len());
        let packed = frame.get(start..end).ok_or("its run-length segments overlap or end beyond the frame")?;
        // The first segment holds the highest bytes.
        let places = bytes[width - 1 - segment..].iter_mut().step_by(width);
        let written = unpack(packed, places);
        if written != pixel_count {
            return Err(format!("run-length segment {segment} holds {written} bytes where {pixel_count} are needed"));
        }
    }
    Ok(bytes)
}

/// Writes literal and repeated runs until either side ends; the number of bytes written.
fn unpack<'a>(packed: &[u8], mut places: impl Iterator<Item = &'a mut u8>) -> usize {
    let mut written = 0;
    let mut rest = packed;
    while let Some((&control, after)) = rest.split_first() {
        let control = control as i8;
        let (values, count) = match control {
            0.. => (after.get(..control as usize + 1).unwrap_or(after), 1),
            -128 => (&after[..0], 0),
            _ => (after.get(..1).unwrap_or(after), usize::from(control.unsigned_abs()) + 1),
        };
        rest = &after[values.len()..];
        for &value in values.iter().cycle().take(values.len() * count) {
            let Some(place) = places.next() else { return written };
            *place = value;
            written += 1;
        }
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The standard's own example of runs: a literal of three, a repeat of four, nothing, a literal of one.
    #[test]
    fn runs_are_unpacked_high_byte_first() {
        let high = [2_u8, 1, 2, 3, 253, 9, 128, 0, 7];
        let low = [7_u8, 10, 20, 30, 40, 50, 60, 70, 80];
        let mut header = [0_u32; 16];
        header[..3].copy_from_slice(&[2, 64, 64 + 9]);
        let frame = [header.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>(), high.to_vec(), low.to_vec()].concat();
        let words: Vec<u16> = decode(&frame, 8, 2).unwrap().chunks(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        assert_eq!(words, [0x010A, 0x0214, 0x031E, 0x0928, 0x0932, 0x093C, 0x0946, 0x0750]);
        assert!(decode(&frame[..70], 8, 2).is_err());
        assert!(decode(&frame, 9, 2).unwrap_err().contains("8 bytes where 9"));
        assert!(decode(&frame, 8, 1).is_err());
        assert!(decode(&[], 8, 1).is_err());
    }
}
