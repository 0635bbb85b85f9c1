//! Text from outside as text of the page: it never becomes an element, an attribute or the end of a script.

use std::io;

use serde::Serialize;

/// Text as the content of an element or of a quoted attribute.
pub(super) fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            '\0'..='\x08' | '\x0b' | '\x0c' | '\x0e'..='\x1f' => safe.push('\u{fffd}'),
            other => safe.push(other),
        }
    }
    safe
}

/// A record as JSON that may stand in a `<script>` element: no `<` is left that could close it or open a comment.
pub(super) fn script_json<T: Serialize>(record: &T) -> io::Result<String> {
    Ok(serde_json::to_string(record)?.replace('<', "\\u003c").replace('\u{2028}', "\\u2028").replace('\u{2029}', "\\u2029"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_from_outside_becomes_text() {
        assert_eq!(escaped("<img src=x onerror='a(\"b\")'>&\u{1}"), "&lt;img src=x onerror=&#39;a(&quot;b&quot;)&#39;&gt;&amp;\u{fffd}");
    }

    #[test]
    fn json_cannot_close_its_script_and_reads_back_as_it_was() {
        let text = "</script><!-- <script> \u{2028} \"quoted\"";
        let json = script_json(&text).unwrap();
        assert!(!json.contains('<'));
        assert_eq!(serde_json::from_str::<String>(&json).unwrap(), text);
    }
}
