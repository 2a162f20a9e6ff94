//! From the text of a settings file to dotted keys with values and lines.

use super::error::Problem;
use toml::Value;
use toml::de::{DeTable, DeValue};

/// Longest text that is looked at, bytes: some twenty times the flight file.
pub const MAX_TEXT_BYTES: usize = 1 << 18;
/// Longest piece of a file that an error repeats, characters.
const QUOTE_CHARS: usize = 60;
/// Longest key whose sections are looked into, bytes: twice the longest that exists. Without it, many keys below a long
/// section name would fill the memory.
const MAX_KEY_BYTES: usize = 120;

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
    let breaks: Vec<usize> = text.bytes().enumerate().filter(|(_, c)| *c == b'\n').map(|(at, _)| at).collect();
    let numbered = found.into_iter().map(|(start, given)| Given { line: breaks.partition_point(|at| *at < start) + 1, ..given });
    Ok(numbered.collect())
}

/// Collects the leaves below a table with the byte at which each begins. The parser bounds the depth (80), so this ends.
fn walk(text: &str, prefix: &str, table: &DeTable<'_>, found: &mut Vec<(usize, Given)>) {
    for (name, value) in table {
        let dot = if prefix.is_empty() { "" } else { "." };
        let key = format!("{prefix}{dot}{}", plain_or_quoted(name.get_ref()));
        if let (DeValue::Table(below), true) = (value.get_ref(), key.len() <= MAX_KEY_BYTES) {
            walk(text, &key, below, found);
            continue;
        }
        let written = quote(text.get(value.span()).unwrap_or_default());
        found.push((name.span().start, Given { key, value: plain_value(value.get_ref()), written, line: 0 }));
    }
}

/// One part of a dotted key: as it is, or shortened and in quotes where no setting could be called so.
fn plain_or_quoted(part: &str) -> String {
    let plain =
        (1..=QUOTE_CHARS).contains(&part.len()) && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
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
    let mut letters = text.split_whitespace().flat_map(|word| word.chars().chain([' ']));
    let mut short: String = letters.by_ref().take(QUOTE_CHARS).map(|c| if c.is_control() { '?' } else { c }).collect();
    short.truncate(short.trim_end().len());
    if letters.any(|c| c != ' ') {
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
    fn what_an_error_repeats_is_one_short_line_without_control_characters() {
        assert_eq!(quote("  a\n b\u{7}\t"), "a b?");
        assert_eq!(quote(&"x".repeat(60)), "x".repeat(60));
        assert_eq!(quote(&"x ".repeat(31)), "x ".repeat(30).trim_end().to_owned() + "…");
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
    fn many_keys_below_a_long_section_do_not_multiply() {
        let many = (0..20_000).map(|n| format!("k{n}=1\n")).collect::<String>();
        let long = "a".repeat(MAX_TEXT_BYTES - many.len() - 3);
        let given = read(&format!("[{long}]\n{many}")).unwrap();
        let bytes: usize = given.iter().map(|one| one.key.len() + one.written.len()).sum();
        assert!(bytes < 10 * MAX_TEXT_BYTES, "{bytes}");
        assert_eq!(given[19_999].line, 20_001);
    }

    #[test]
    fn deep_or_long_texts_end_in_an_error_and_not_in_a_crash() {
        let deep =
            ["a.".repeat(100_000) + "a = 1", format!("a = {}", "[".repeat(250_000)), "a = ".to_owned() + &"{a=".repeat(80_000)];
        for text in deep {
            assert!(read(&text).is_err());
        }
        let (line, problem) = read(&"#".repeat(MAX_TEXT_BYTES + 1)).unwrap_err();
        assert_eq!((line, problem.to_string()), (0, "262145 bytes are too many for settings, expected at most 262144".into()));
    }
}
