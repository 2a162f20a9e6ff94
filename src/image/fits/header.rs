//! A FITS header: cards of 80 characters, found by keyword.

use crate::image::read::Problem;

/// Length of a card, bytes (FITS 4.0, § 3.1).
pub(super) const CARD: usize = 80;
/// Headers and data are padded to this many bytes.
pub(super) const BLOCK: usize = 2880;
/// A header longer than this is not one; the longest in practice have a few thousand cards.
const MAX_CARDS: usize = 36 * 1000;

/// The cards before `END`, as they lie in the file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Header<'a> {
    cards: &'a [[u8; CARD]],
}

/// One keyword's value and comment.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Card {
    /// The value, without quotes where it is a string.
    pub value: String,
    /// It was a quoted string.
    pub quoted: bool,
    /// What stands after the slash.
    pub comment: String,
}

impl<'a> Header<'a> {
    /// Splits a file into its first header and the bytes of its data.
    pub fn parse(bytes: &'a [u8]) -> Result<(Self, &'a [u8]), Problem> {
        let (cards, _) = bytes.as_chunks::<CARD>();
        let end = cards.iter().take(MAX_CARDS).position(|card| card.starts_with(b"END     "));
        let end = end.ok_or(Problem::NoEnd { searched: cards.len().min(MAX_CARDS) * CARD })?;
        let cards = cards.get(..end).unwrap_or_default();
        let data = ((end + 1) * CARD).next_multiple_of(BLOCK);
        Ok((Self { cards }, bytes.get(data..).unwrap_or_default()))
    }

    /// The first card of a keyword, `HIERARCH` or not.
    pub fn card(&self, keyword: &str) -> Option<Card> {
        self.cards.iter().find_map(|card| {
            let (name, value) = split(card)?;
            (name == keyword.as_bytes()).then(|| Card::parse(value))
        })
    }

    /// A whole number; `None` where the keyword is missing or its value is not one.
    pub fn integer(&self, keyword: &str) -> Option<i64> {
        self.card(keyword)?.integer()
    }

    /// A whole number that the file must have.
    pub fn required(&self, keyword: &'static str) -> Result<i64, Problem> {
        let card = self.card(keyword).ok_or(Problem::MissingKeyword { keyword })?;
        card.integer().ok_or(Problem::BadKeyword { keyword, value: card.value, expected: "a whole number" })
    }

    /// A string, without the blanks at its end.
    pub fn text(&self, keyword: &str) -> Option<String> {
        self.card(keyword).filter(|card| card.quoted).map(|card| card.value)
    }
}

impl Card {
    /// Reads what stands after the `=`; never fails, because a value that makes no sense is refused where it is used.
    fn parse(field: &[u8]) -> Self {
        let field = String::from_utf8_lossy(field);
        let field = field.trim();
        let Some(inside) = field.strip_prefix('\'') else {
            let (value, comment) = field.split_once('/').unwrap_or((field, ""));
            return Self { value: value.trim().to_owned(), quoted: false, comment: comment.trim().to_owned() };
        };
        // A quote inside a string is written twice.
        let mut value = String::new();
        let mut rest = inside;
        while let Some((before, after)) = rest.split_once('\'') {
            value.push_str(before);
            rest = after;
            let Some(more) = rest.strip_prefix('\'') else { break };
            value.push('\'');
            rest = more;
        }
        let comment = rest.split_once('/').map_or("", |(_, comment)| comment);
        Self { value: value.trim_end().to_owned(), quoted: true, comment: comment.trim().to_owned() }
    }

    /// The value as a finite number.
    pub fn number(&self) -> Option<f64> {
        // FITS writes a double's exponent with D; Rust would take `inf` and `nan` for numbers.
        let value = self.value.replace(['D', 'd'], "E");
        value.parse::<f64>().ok().filter(|v| v.is_finite() && !self.quoted)
    }

    /// The value as a whole number that a double holds exactly.
    pub fn integer(&self) -> Option<i64> {
        const EXACT: f64 = 9_007_199_254_740_992.0;
        self.number().filter(|v| v.fract() == 0.0 && v.abs() <= EXACT).map(|v| v as i64)
    }
}

/// Keyword and value field of a card; `None` for comments and blank cards.
fn split(card: &[u8; CARD]) -> Option<(&[u8], &[u8])> {
    let equals = match card.strip_prefix(b"HIERARCH ") {
        Some(_) => card.iter().position(|&c| c == b'=')?,
        None => (card.get(8) == Some(&b'=')).then_some(8)?,
    };
    let (name, value) = card.split_at_checked(equals)?;
    let name = name.strip_prefix(b"HIERARCH ").unwrap_or(name);
    Some((name.trim_ascii(), value.get(1..)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn card(field: &str) -> (String, bool, String) {
        let card = Card::parse(field.as_bytes());
        (card.value, card.quoted, card.comment)
    }

    #[test]
    fn values_comments_and_quotes_are_told_apart() {
        let expect = |value: &str, quoted, comment: &str| (value.to_owned(), quoted, comment.to_owned());
        assert_eq!(card("                   16 / bits"), expect("16", false, "bits"));
        assert_eq!(card(" -77.4288695 / DEGREES"), expect("-77.4288695", false, "DEGREES"));
        assert_eq!(card(" 'x1      '          "), expect("x1", true, ""));
        assert_eq!(card(" 'it''s a/b ' / it's"), expect("it's a/b", true, "it's"));
        assert_eq!(card(" 'no end / here"), expect("", true, "here"));
        assert_eq!(card(" ''"), expect("", true, ""));
        assert_eq!(card(""), expect("", false, ""));
    }

    #[test]
    fn only_finite_numbers_are_numbers() {
        let number = |value: &str| Card::parse(value.as_bytes()).number();
        assert_eq!((number("1.5D2"), number(" 0. / DB"), number("+3")), (Some(150.0), Some(0.0), Some(3.0)));
        for value in ["NaN", "inf", "-infinity", "1e999", "'3'", "", "0x10", "1 2", "T"] {
            assert_eq!(number(value), None, "{value}");
        }
        let integer = |value: &str| Card::parse(value.as_bytes()).integer();
        assert_eq!((integer("38"), integer("38.0"), integer("38.5"), integer("1e300")), (Some(38), Some(38), None, None));
    }
}
