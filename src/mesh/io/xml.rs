//! As much XML as VTK's files need: elements, attributes, text, and the raw tail of appended data.

use std::collections::BTreeMap;

/// Elements within elements beyond this are refused.
const DEPTH_LIMIT: usize = 32;

/// One element with what it holds.
#[derive(Debug, Default)]
pub(super) struct Element<'a> {
    pub(super) name: &'a str,
    attributes: BTreeMap<&'a str, String>,
    pub(super) children: Vec<Element<'a>>,
    /// The bytes up to the first child or the end.
    pub(super) text: &'a [u8],
}

impl Element<'_> {
    pub(super) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str)
    }

    pub(super) fn children_named<'b>(&'b self, name: &'b str) -> impl Iterator<Item = &'b Self> {
        self.children.iter().filter(move |child| child.name == name)
    }

    pub(super) fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }
}

/// Reads a document and returns its root; the message of an error says where.
pub(super) fn parse(bytes: &[u8]) -> Result<Element<'_>, String> {
    let mut open: Vec<Element> = vec![];
    let mut at = 0;
    while let Some(offset) = find(&bytes[at..], b"<") {
        let start = at + offset;
        let rest = &bytes[start..];
        if rest.starts_with(b"<!--") {
            at = start + find(rest, b"-->").ok_or_else(|| unclosed("a comment", start))? + 3;
        } else if rest.starts_with(b"<?") || rest.starts_with(b"<!") {
            at = start + find(rest, b">").ok_or_else(|| unclosed("a declaration", start))? + 1;
        } else if rest.starts_with(b"</") {
            at = start + find(rest, b">").ok_or_else(|| unclosed("an end tag", start))? + 1;
            let done = close(&mut open, &bytes[start + 2..at - 1], start)?;
            if let Some(root) = done {
                return Ok(root);
            }
        } else {
            let end = tag_end(rest).ok_or_else(|| unclosed("a tag", start))?;
            at = start + end + 1;
            let is_empty = rest[end - 1] == b'/';
            let mut element = read_tag(&rest[1..if is_empty { end - 1 } else { end }], start)?;
            if element.name == "AppendedData" && !is_empty {
                let tail = &bytes[at..];
                let stop = rfind(tail, b"</AppendedData").ok_or_else(|| unclosed("AppendedData", start))?;
                element.text = &tail[..stop];
                at += stop;
            } else if !is_empty {
                element.text = &bytes[at..at + find(&bytes[at..], b"<").unwrap_or(0)];
            }
            if open.len() >= DEPTH_LIMIT {
                return Err(format!("elements are nested deeper than {DEPTH_LIMIT} at byte {start}"));
            }
            match (is_empty, open.last_mut()) {
                (true, Some(parent)) => parent.children.push(element),
                (true, None) => return Ok(element),
                (false, _) => open.push(element),
            }
        }
    }
    Err(match open.last() {
        Some(element) => format!("it ends within <{}>; is it truncated?", element.name),
        None => "it holds no XML element".into(),
    })
}

fn unclosed(what: &str, start: usize) -> String {
    format!("{what} begins at byte {start} and does not end; is it truncated?")
}

/// Ends the innermost element; the root if that was it.
fn close<'a>(open: &mut Vec<Element<'a>>, name: &[u8], start: usize) -> Result<Option<Element<'a>>, String> {
    let name = std::str::from_utf8(name).unwrap_or("").trim();
    match open.pop() {
        Some(element) if element.name == name => match open.last_mut() {
            Some(parent) => {
                parent.children.push(element);
                Ok(None)
            }
            None => Ok(Some(element)),
        },
        Some(element) => Err(format!("<{}> is closed by </{name}> at byte {start}", element.name)),
        None => Err(format!("</{name}> at byte {start} closes nothing")),
    }
}

/// The position of the `>` that ends a tag, past quoted attributes.
fn tag_end(bytes: &[u8]) -> Option<usize> {
    let mut quote = None;
    for (i, &byte) in bytes.iter().enumerate() {
        match quote {
            Some(mark) if byte == mark => quote = None,
            Some(_) => {}
            None if byte == b'"' || byte == b'\'' => quote = Some(byte),
            None if byte == b'>' => return Some(i),
            None => {}
        }
    }
    None
}

/// Name and attributes of a tag.
fn read_tag(bytes: &[u8], start: usize) -> Result<Element<'_>, String> {
    let malformed = || format!("the tag at byte {start} is malformed");
    let text = std::str::from_utf8(bytes).map_err(|_| malformed())?;
    let (name, mut rest) = text.split_at(text.find(char::is_whitespace).unwrap_or(text.len()));
    let mut element = Element { name, ..Element::default() };
    loop {
        rest = rest.trim_start();
        if rest.is_empty() {
            return Ok(element);
        }
        let (key, after) = rest.split_once('=').ok_or_else(malformed)?;
        let after = after.trim_start();
        let quote = after.chars().next().filter(|c| "\"'".contains(*c)).ok_or_else(malformed)?;
        let (value, remaining) = after[1..].split_once(quote).ok_or_else(malformed)?;
        element.attributes.insert(key.trim(), unescape(value));
        rest = remaining;
    }
}

fn unescape(text: &str) -> String {
    text.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", "\"").replace("&apos;", "'").replace("&amp;", "&")
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}

fn rfind(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).rposition(|window| window == what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_attributes_and_raw_tails_are_found() {
        let text = b"<?xml version='1.0'?><!-- a <b> --><A x=\"1 > 0\" y='&lt;&amp;'>\n<B/> <C>12 3</C><AppendedData encoding=\"raw\">_\x00<\xff</AppendedData></A>";
        let root = parse(text).unwrap();
        assert_eq!((root.name, root.attribute("x"), root.attribute("y")), ("A", Some("1 > 0"), Some("<&")));
        assert_eq!(root.child("C").unwrap().text, b"12 3");
        assert_eq!(root.child("AppendedData").unwrap().text, b"_\x00<\xff");
        assert_eq!(root.children.len(), 3);
    }

    #[test]
    fn every_truncation_is_an_error() {
        let text = b"<?xml?><A x='1'><B>1 2</B><!-- c --><AppendedData encoding='raw'>_xyz</AppendedData></A>";
        for length in 0..text.len() {
            assert!(parse(&text[..length]).is_err(), "{length}");
        }
        assert!(parse(b"<A></B>").is_err() && parse(b"</A>").is_err() && parse(b"<A x=1></A>").is_err());
    }
}
