//! The numbers of a section of a .msh file, as text or as bytes.

use std::str::SplitAsciiWhitespace;

/// How a file writes its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Words.
    Text,
    /// Bytes, the most significant one first or last.
    Binary { is_big_endian: bool },
}

/// The numbers of a section, one after the other.
pub(super) struct Numbers<'a> {
    source: Source<'a>,
    section: &'a str,
}

enum Source<'a> {
    Words(SplitAsciiWhitespace<'a>),
    Bytes { rest: &'a [u8], is_big_endian: bool },
}

impl<'a> Numbers<'a> {
    pub(super) fn new(content: &'a [u8], encoding: Encoding, section: &'a str) -> Result<Self, String> {
        let source = match encoding {
            Encoding::Text => Source::Words(text_of(content, section)?.split_ascii_whitespace()),
            Encoding::Binary { is_big_endian } => Source::Bytes { rest: content, is_big_endian },
        };
        Ok(Self { source, section })
    }

    pub(super) fn is_binary(&self) -> bool {
        matches!(self.source, Source::Bytes { .. })
    }

    /// An `int`: 32 bits in a binary file.
    pub(super) fn integer(&mut self) -> Result<i64, String> {
        self.next(i32::from_le_bytes, i64::from)
    }

    /// An `int` that counts something.
    pub(super) fn count(&mut self) -> Result<u64, String> {
        let number = self.integer()?;
        u64::try_from(number).map_err(|_| format!("section ${}: {number} counts nothing", self.section))
    }

    /// A `size_t`: 64 bits in a binary file.
    pub(super) fn size(&mut self) -> Result<u64, String> {
        self.next(u64::from_le_bytes, |number| number)
    }

    /// A `double`.
    pub(super) fn real(&mut self) -> Result<f64, String> {
        self.next(f64::from_le_bytes, |number| number)
    }

    /// A number that is a line of text in binary files too.
    pub(super) fn line(&mut self) -> Result<u64, String> {
        let Source::Bytes { rest, .. } = &mut self.source else { return self.size() };
        let end = rest.iter().position(|&byte| byte == b'\n').ok_or_else(|| ends_early(self.section))?;
        let (line, after) = (&rest[..end], &rest[end + 1..]);
        *rest = after;
        let word = text_of(line, self.section)?.trim();
        word.parse().map_err(|_| no_number(self.section, word))
    }

    fn next<T: std::str::FromStr, R: Copy, const N: usize>(
        &mut self,
        from_bytes: fn([u8; N]) -> R,
        widen: impl Fn(R) -> T,
    ) -> Result<T, String> {
        match &mut self.source {
            Source::Words(words) => {
                let word = words.next().ok_or_else(|| ends_early(self.section))?;
                word.parse().map_err(|_| no_number(self.section, word))
            }
            Source::Bytes { rest, is_big_endian } => {
                let (&bytes, after) = rest.split_first_chunk::<N>().ok_or_else(|| ends_early(self.section))?;
                *rest = after;
                let mut bytes = bytes;
                if *is_big_endian {
                    bytes.reverse();
                }
                Ok(widen(from_bytes(bytes)))
            }
        }
    }
}

pub(super) fn text_of<'a>(bytes: &'a [u8], section: &str) -> Result<&'a str, String> {
    std::str::from_utf8(bytes).map_err(|_| format!("section ${section} holds bytes that are no text"))
}

fn ends_early(section: &str) -> String {
    format!("section ${section} ends too early")
}

fn no_number(section: &str, word: &str) -> String {
    format!("section ${section}: {word:?} is not a number of the kind needed")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_bytes_of_either_order_are_the_same_numbers() {
        let text = b" -7 9\n3\n0.5".to_vec();
        let binary = |integer: [u8; 4], size: [u8; 8], real: [u8; 8]| [&integer[..], &size[..], b"3\n", &real[..]].concat();
        let little = binary((-7_i32).to_le_bytes(), 9_u64.to_le_bytes(), 0.5_f64.to_le_bytes());
        let big = binary((-7_i32).to_be_bytes(), 9_u64.to_be_bytes(), 0.5_f64.to_be_bytes());
        let (first, last) = (Encoding::Binary { is_big_endian: true }, Encoding::Binary { is_big_endian: false });
        for (content, encoding) in [(text, Encoding::Text), (little, last), (big, first)] {
            let mut numbers = Numbers::new(&content, encoding, "Nodes").unwrap();
            let found = (numbers.integer(), numbers.size(), numbers.line(), numbers.real());
            assert_eq!(found, (Ok(-7), Ok(9), Ok(3), Ok(0.5)));
            assert_eq!(numbers.real(), Err("section $Nodes ends too early".to_string()));
        }
    }
}
