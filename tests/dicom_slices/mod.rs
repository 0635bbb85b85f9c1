//! A small DICOM cine, byte by byte: slices of 8 × 6 pixels.

/// An uncompressed slice of two, at one of four phases, in explicit little-endian elements.
pub(crate) fn dicom_slice(slice: u16, phase: u16) -> Vec<u8> {
    let mut bytes = [vec![0; 128], b"DICM".to_vec()].concat();
    let element = |bytes: &mut Vec<u8>, group: u16, number: u16, vr: &str, value: &[u8]| {
        bytes.extend([group, number].iter().flat_map(|n| n.to_le_bytes()));
        bytes.extend(vr.bytes());
        let length = value.len().next_multiple_of(2);
        match vr {
            "OW" | "OB" => bytes.extend([0_u8; 2].into_iter().chain((length as u32).to_le_bytes())),
            _ => bytes.extend((length as u16).to_le_bytes()),
        }
        bytes.extend(value);
        bytes.resize(bytes.len() + length - value.len(), if vr == "UI" { 0 } else { b' ' });
    };
    let mut meta = Vec::new();
    element(&mut meta, 2, 1, "OB", &[0, 1]);
    element(&mut meta, 2, 2, "UI", b"1.2.840.10008.5.1.4.1.1.4");
    element(&mut meta, 2, 3, "UI", format!("1.2.3.{slice}.{phase}").as_bytes());
    element(&mut meta, 2, 0x10, "UI", b"1.2.840.10008.1.2.1");
    element(&mut meta, 2, 0x12, "UI", b"1.2.3.4");
    element(&mut bytes, 2, 0, "UL", &(meta.len() as u32).to_le_bytes());
    bytes.extend(meta);
    let mut put = |group, number, vr: &str, value: &str| element(&mut bytes, group, number, vr, value.as_bytes());
    put(8, 0x103e, "LO", "cine");
    put(0x18, 0x50, "DS", "8");
    put(0x18, 0x1060, "DS", &(175 * phase).to_string());
    put(0x18, 0x1062, "IS", "700");
    put(0x20, 0x0e, "UI", &format!("1.2.{slice}"));
    put(0x20, 0x13, "IS", &(phase + 1).to_string());
    put(0x20, 0x32, "DS", &format!("0\\0\\{}", 8 * slice));
    put(0x20, 0x37, "DS", "1\\0\\0\\0\\1\\0");
    put(0x28, 0x04, "CS", "MONOCHROME2");
    put(0x28, 0x30, "DS", "1.5\\1.5");
    for (number, value) in [(2, 1_u16), (0x10, 6), (0x11, 8), (0x100, 16), (0x101, 16), (0x102, 15), (0x103, 0)] {
        element(&mut bytes, 0x28, number, "US", &value.to_le_bytes());
    }
    let pixels: Vec<u8> = (0..48).flat_map(|n: u16| (100 + 10 * n + phase).to_le_bytes()).collect();
    element(&mut bytes, 0x7fe0, 0x10, "OW", &pixels);
    bytes
}
