//! The 64-bit FNV-1a hash, which, unlike the standard library's, is the same for every build: it tells whether two things are the same.

/// Where every hash begins.
pub const FINGERPRINT_START: u64 = 0xcbf2_9ce4_8422_2325;

/// The hash of some bytes.
pub fn fingerprint(bytes: &[u8]) -> u64 {
    fingerprint_on(FINGERPRINT_START, bytes)
}

/// The hash of what was hashed so far and of some bytes behind it.
pub fn fingerprint_on(so_far: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(so_far, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Published test vectors of the FNV authors.
    #[test]
    fn hash_is_fnv1a() {
        assert_eq!(fingerprint(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fingerprint(b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fingerprint(b"foobar"), 0x8594_4171_f739_67e8);
        assert_eq!(fingerprint_on(fingerprint(b"foo"), b"bar"), fingerprint(b"foobar"));
    }
}
