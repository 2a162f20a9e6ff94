//! From the text of a settings file to dotted keys with values and lines.

use super::error::Problem;
use toml::Value;
use toml::de::{DeTable, DeValue};

/// Longest text that is looked at, bytes: over a hundred times the flight file.
pub const MAX_TEXT_BYTES: usize = 1 << 20;
/// Longest piece of a file that an error repeats, characters.
const QUOTE_CHARS: usize = 60;

/// One key of a file with its value.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Given {
    /// The dotted key; a part that is no plain word is in quotes, so that it is like no setting's key.
    pub(super) key: String,
    pub(super) value: Value,
    /// The value as it was written.
    pub(super) written: String,
    /// From 1.
    pub(super) line: usize,
}

/// The keys of a TOML text, in the order in which they stand there. A mistake comes with its line (0: none).
pub(super) fn read(text: &str) -> Result<Vec<Given>, (usize, Problem)> {
    if text.len() > MAX_TEXT_BYTES {
        return Err((0, Problem::TooLong { bytes: text.len(), limit: MAX_TEXT_BYTES }));
    }
    let document = DeTable::parse(text).map_err(|error| syntax(text, &error))?;
    let mut found = Vec::new();
    walk(text, "", document.get_ref(), &mut found);
    found.sort_by_key(|(start, _)| *start);
    Ok(found.into_iter().map(|(_, given)| given).collect())
}

/// Collects the leaves below a table. The parser bounds the depth (80), so this ends.
fn walk(text: &str, prefix: &str, table: &DeTable<'_>, found: &mut Vec<(usize, Given)>) {
    for (name, value) in table {
        let dot = if prefix.is_empty() { "" } else { "." };
        let key = format!("{prefix}{dot}{}", plain_or_quoted(name.get_ref()));
        if let DeValue::Table(below) = value.get_ref() {
            walk(text, &key, below, found);
            continue;
        }
        let start = name.span().start;
        let written = quote(text.get(value.span()).unwrap_or_default());
        found.push((start, Given { key, value: plain_value(value.get_ref()), written, line: line_of(text, start) }));
    }
}

fn plain_or_quoted(part: &str) -> String {
    let plain = !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if plain { part.into() } else { format!("\"{}\"", quote(part)) }
}

/// The value without its place. A whole number beyond 64 bits becomes a float, which no whole setting accepts.
fn plain_value(value: &DeValue<'_>) -> Value {
    match value {
        DeValue::String(text) => Value::String(text.to_string()),
        DeValue::Integer(n) => match i64::from_str_radix(n.as_str(), n.radix()) {
            Ok(whole) => Value::Integer(whole),
            Err(_) => Value::Float(f64::INFINITY),
        },
        // The parser has checked the digits, so only a NaN can come of a failure, and that is refused.
        DeValue::Float(x) => Value::Float(x.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(b) => Value::Boolean(*b),
        DeValue::Datetime(when) => Value::Datetime(*when),
        DeValue::Array(all) => Value::Array(all.iter().map(|one| plain_value(one.get_ref())).collect()),
        DeValue::Table(below) => {
            Value::Table(below.iter().map(|(name, one)| (name.get_ref().to_string(), plain_value(one.get_ref()))).collect())
        }
    }
}

fn syntax(text: &str, error: &toml::de::Error) -> (usize, Problem) {
    let span = error.span().unwrap_or_default();
    let line = line_of(text, span.start);
    let message = match (error.message(), text.get(span)) {
        ("duplicate key", Some(key)) => format!("duplicate key '{}'", quote(key)),
        (message, _) => format!("not TOML: {}", message.replace('\n', " ")),
    };
    let quoted = quote(text.lines().nth(line.saturating_sub(1)).unwrap_or_default());
    (line, Problem::Syntax { message, line: quoted })
}

/// The line, from 1, of a byte of the text; a byte past the end is on the last line.
fn line_of(text: &str, byte: usize) -> usize {
    let breaks = text.bytes().take(byte).filter(|c| *c == b'\n').count();
    (breaks + 1).min(text.lines().count().max(1))
}

/// A piece of a file, on one line and not too long, for an error.
pub(super) fn quote(text: &str) -> String {
    let one_line = text.trim().split_whitespace().collect::<Vec<_>>().join(" ");
    let mut short: String = one_line.chars().map(|c| if c.is_control() { '?' } else { c }).take(QUOTE_CHARS).collect();
    if one_line.chars().count() > QUOTE_CHARS {
        short.push('…');
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_come_in_the_order_of_their_lines_with_sections_inline_tables_and_dots_alike() {
        let text = "b.z = 1\n[a]\ny = 'two'\nx = { w = [1,\n 2], v = true }\n";
        let read: Vec<_> = read(text).unwrap().into_iter().map(|given| (given.line, given.key, given.written)).collect();
        let wanted = [(1, "b.z", "1"), (3, "a.y", "'two'"), (4, "a.x.w", "[1, 2]"), (5, "a.x.v", "true")];
        assert_eq!(read, wanted.map(|(line, key, written)| (line, key.to_owned(), written.to_owned())));
    }

    #[test]
    fn a_quoted_key_with_dots_is_not_taken_for_a_path() {
        assert_eq!(read("\"camera.name\" = 'x'").unwrap()[0].key, "\"camera.name\"");
    }

    #[test]
    fn syntax_errors_have_their_line_even_at_the_end_of_the_text() {
        for (text, wanted) in [("a = 1\nb = \"x\n", 2), ("a = 1\n\n[b", 3), ("a = 1\na = 2\n", 2), ("[a\n", 1), ("", 0)] {
            assert_eq!(read(text).map_or_else(|(line, _)| line, |_| 0), wanted, "{text:?}");
        }
    }

    #[test]
    fn deep_or_long_texts_end_in_an_error_and_not_in_a_crash() {
        let deep =
            ["a.".repeat(300_000) + "a = 1", format!("a = {}", "[".repeat(600_000)), "a = ".to_owned() + &"{a=".repeat(200_000)];
        for text in deep {
            assert!(read(&text).is_err());
        }
        let (line, problem) = read(&"#".repeat(MAX_TEXT_BYTES + 1)).unwrap_err();
        assert_eq!((line, problem.to_string()), (0, "1048577 bytes are too many for settings, expected at most 1048576".into()));
    }
}
