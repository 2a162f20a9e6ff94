//! The language of the lens controller (Birger EF-232): words that are sent, and what each may be answered with.
//!
//! Every word and every reply ends with a carriage return. A reply that is not exactly of the form that belongs to its word is
//! a [`Misread`], with its text; nothing is guessed.

use super::request::{AperturePosition, FocusCounts};

/// Longest text of a reply that is kept for people, characters: longer than any that the controller has.
const TEXT_CHARS: usize = 80;

/// A word for the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Word {
    /// Asks for the version: its reply is like no other, so that it marks a place in the stream of replies.
    Version,
    /// Learns the focus range by driving to both stops.
    LearnFocus,
    /// Asks for range and focus.
    ReadFocus,
    /// Moves to a focus, counted from the near stop.
    SetFocus(FocusCounts),
    /// Moves the focus by so many counts.
    MoveFocus(i32),
    /// Makes the aperture ready.
    InitAperture,
    /// Asks for the aperture.
    ReadAperture,
    /// Moves the aperture.
    SetAperture(AperturePosition),
}

/// What the controller answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply {
    /// Its version.
    Version(String),
    /// Where the focus is, and the furthest that it can be, both from the near stop.
    Focus {
        /// Where it is.
        at: FocusCounts,
        /// The far stop.
        furthest: FocusCounts,
    },
    /// It has not learned its range, so that its counts mean nothing.
    NotLearned,
    /// Where the aperture is.
    Aperture(AperturePosition),
    /// What moves has moved.
    Done,
}

/// A line that is not the reply that belongs to the word.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Misread {
    /// The controller's own error, with its text.
    Refused(String),
    /// Anything else, with its text.
    Unexpected(String),
}

impl Word {
    /// The bytes that are sent.
    pub fn bytes(self) -> Vec<u8> {
        let text = match self {
            Self::SetFocus(to) => format!("fa{to}\r"),
            Self::MoveFocus(by) => format!("mf{by}\r"),
            Self::SetAperture(to) => format!("ma{to}\r"),
            Self::Version | Self::LearnFocus | Self::ReadFocus | Self::InitAperture | Self::ReadAperture => {
                format!("{}\r", self.label())
            }
        };
        text.into_bytes()
    }

    /// The word without its number.
    pub fn label(self) -> &'static str {
        match self {
            Self::Version => "vs",
            Self::LearnFocus => "la",
            Self::ReadFocus => "fp",
            Self::SetFocus(_) => "fa",
            Self::MoveFocus(_) => "mf",
            Self::InitAperture => "in",
            Self::ReadAperture => "pa",
            Self::SetAperture(_) => "ma",
        }
    }

    /// Whether it moves the focus.
    pub fn moves_focus(self) -> bool {
        matches!(self, Self::LearnFocus | Self::SetFocus(_) | Self::MoveFocus(_))
    }

    /// Whether it moves the aperture.
    pub fn moves_aperture(self) -> bool {
        matches!(self, Self::InitAperture | Self::SetAperture(_))
    }

    /// Reads a reply, without its carriage return, to this word.
    ///
    /// # Errors
    /// Where it is another text than this word may be answered with.
    pub fn read(self, line: &[u8]) -> Result<Reply, Misread> {
        let text = str::from_utf8(line).ok().filter(|text| text.bytes().all(|c| c == b' ' || c == b'\t' || c.is_ascii_graphic()));
        let Some(text) = text.map(str::trim) else { return Err(Misread::Unexpected(printable(line))) };
        let reply = match self {
            Self::Version => version(text),
            Self::ReadFocus => focus(text),
            Self::ReadAperture => aperture(text),
            // What stands behind DONE is not written down for these, so nothing is made of it: the lens is read back.
            Self::LearnFocus | Self::MoveFocus(_) | Self::InitAperture => text.starts_with("DONE").then_some(Reply::Done),
            Self::SetFocus(_) => done(text).map(|_| Reply::Done),
            Self::SetAperture(_) => done(text).filter(|flag| flag.starts_with('f')).map(|_| Reply::Done),
        };
        reply.ok_or_else(|| {
            if text.starts_with("ERR") { Misread::Refused(printable(line)) } else { Misread::Unexpected(printable(line)) }
        })
    }
}

/// Whether a line is the version: two parts about a colon, the first an `s`.
fn version(text: &str) -> Option<Reply> {
    let (first, version) = text.split_once(':')?;
    (first == "s" && !version.contains(':')).then(|| Reply::Version(version.trim().to_owned()))
}

/// A line's text for people: what can't be shown is escaped.
pub fn printable(line: &[u8]) -> String {
    let mut text: String = line.escape_ascii().to_string().chars().take(TEXT_CHARS).collect();
    if line.is_empty() {
        text.push_str("(empty)");
    }
    text
}

/// Three numbers with labels: the near stop, the far stop, where it is, each in the controller's own count.
fn focus(text: &str) -> Option<Reply> {
    let mut numbers = text.split_whitespace().map(labelled);
    let (near, far, at) = (numbers.next()??, numbers.next()??, numbers.next()??);
    if numbers.next().is_some() {
        return None;
    }
    if far <= near {
        return Some(Reply::NotLearned);
    }
    Some(Reply::Focus { at: FocusCounts(at.checked_sub(near)?), furthest: FocusCounts(far.checked_sub(near)?) })
}

fn labelled(group: &str) -> Option<i32> {
    let (label, value) = group.split_once(':')?;
    let is_label = !label.is_empty() && label.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'_');
    if is_label { number(value) } else { None }
}

/// The position, and something more behind a comma.
fn aperture(text: &str) -> Option<Reply> {
    let (position, more) = text.split_once(',')?;
    let position = number(position).filter(|position| *position >= 0)?;
    (!more.is_empty()).then_some(Reply::Aperture(AperturePosition(position)))
}

/// `DONE<number>,<flag>`: the flag. The number is not used: where the lens is, is read.
fn done(text: &str) -> Option<&str> {
    let (count, flag) = text.strip_prefix("DONE")?.split_once(',')?;
    number(count)?;
    (!flag.is_empty()).then_some(flag)
}

/// A number as the controller writes it: digits, and a minus where it is negative.
fn number(text: &str) -> Option<i32> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    (!digits.is_empty() && digits.bytes().all(|c| c.is_ascii_digit())).then(|| text.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SET: Word = Word::SetFocus(FocusCounts(3030));
    const CLOSE: Word = Word::SetAperture(AperturePosition(6));

    fn at(at: i32, furthest: i32) -> Reply {
        Reply::Focus { at: FocusCounts(at), furthest: FocusCounts(furthest) }
    }

    #[test]
    fn what_is_sent_is_the_controllers_language() {
        let sent: Vec<String> = [
            Word::Version,
            Word::LearnFocus,
            Word::ReadFocus,
            SET,
            Word::MoveFocus(-20),
            Word::InitAperture,
            Word::ReadAperture,
            CLOSE,
        ]
        .iter()
        .map(|word| String::from_utf8(word.bytes()).unwrap())
        .collect();
        assert_eq!(sent, ["vs\r", "la\r", "fp\r", "fa3030\r", "mf-20\r", "in\r", "pa\r", "ma6\r"]);
    }

    #[test]
    fn each_word_takes_its_own_replies() {
        for (word, line, reply) in [
            (Word::Version, "s:BC1 2.04", Reply::Version("BC1 2.04".to_owned())),
            (Word::Version, "s:", Reply::Version(String::new())),
            (Word::ReadFocus, "fmin:0  fmax:4200  current:3030", at(3030, 4200)),
            (Word::ReadFocus, "fmin:-137  fmax:4063  current:2893", at(3030, 4200)),
            (Word::ReadFocus, "  a:10\tb:20  c:9 ", at(-1, 10)),
            (Word::ReadFocus, "fmin:0  fmax:0  current:0", Reply::NotLearned),
            (Word::ReadFocus, "fmin:5  fmax:-5  current:0", Reply::NotLearned),
            (SET, "DONE3030,0", Reply::Done),
            (SET, "DONE-3,1", Reply::Done),
            (Word::MoveFocus(3), "DONE", Reply::Done),
            (Word::LearnFocus, "DONE:LA", Reply::Done),
            (Word::InitAperture, "DONE", Reply::Done),
            (Word::ReadAperture, "6,f22", Reply::Aperture(AperturePosition(6))),
            (Word::ReadAperture, "0,18,more", Reply::Aperture(AperturePosition(0))),
            (CLOSE, "DONE6,f22", Reply::Done),
        ] {
            assert_eq!(word.read(line.as_bytes()), Ok(reply), "{word:?} {line}");
        }
    }

    #[test]
    fn anything_else_is_refused_with_its_text() {
        for (word, line) in [
            (Word::Version, "v:1"),
            (Word::Version, "s:1:2"),
            (Word::Version, "xs:1"),
            (Word::ReadFocus, ""),
            (Word::ReadFocus, "DONE3030,0"),
            (Word::ReadFocus, "fmin:0  fmax:4200"),
            (Word::ReadFocus, "fmin:0  fmax:4200  current:3030  more:1"),
            (Word::ReadFocus, "fmin:0  fmax:4200  current:30x0"),
            (Word::ReadFocus, "fmin:0  fmax:4200  current:"),
            (Word::ReadFocus, "fmin:0  fmax:4200  :3030"),
            (Word::ReadFocus, "fmin:0  fmax:4200  current:+3030"),
            (Word::ReadFocus, "fmin:0  fmax:4200  current:3030000000"),
            (Word::ReadFocus, "fmin:-2147483648  fmax:2147483647  current:2147483647"),
            (Word::ReadFocus, "fm\u{7}in:0  fmax:4200  current:3030"),
            (SET, "DONE"),
            (SET, "DONE3030"),
            (SET, "DONE3030,"),
            (SET, "DON3030,0"),
            (SET, "DONEx,0"),
            (Word::MoveFocus(3), "DON"),
            (Word::LearnFocus, "OK"),
            (Word::ReadAperture, "6"),
            (Word::ReadAperture, "6,"),
            (Word::ReadAperture, "-1,f22"),
            (CLOSE, "DONE6,22"),
            (Word::ReadAperture, "DONE6,f22"),
        ] {
            let Err(Misread::Unexpected(text)) = word.read(line.as_bytes()) else { panic!("{word:?} takes {line}") };
            assert_eq!(text, printable(line.as_bytes()));
        }
        assert_eq!(Word::ReadFocus.read(b"ERR7"), Err(Misread::Refused("ERR7".to_owned())));
        assert_eq!(SET.read(b"ERR"), Err(Misread::Refused("ERR".to_owned())));
        assert_eq!(Word::ReadFocus.read(b"fm\xffin\x00"), Err(Misread::Unexpected("fm\\xffin\\x00".to_owned())));
    }

    proptest! {
        #[test]
        fn no_other_words_reply_is_taken_for_a_reading(n in any::<i32>(), m in any::<i32>()) {
            for line in [format!("DONE{n},{m}"), format!("s:{n}"), format!("ERR{n}"), format!("DONE{n},f{m}"), n.to_string()] {
                prop_assert!(Word::ReadFocus.read(line.as_bytes()).is_err());
                prop_assert!(Word::ReadAperture.read(line.as_bytes()).is_err());
            }
            for line in [format!("fmin:{n}  fmax:{m}  current:{n}"), format!("{n},f{m}"), format!("s:{n}")] {
                for word in [Word::LearnFocus, SET, Word::MoveFocus(n), Word::InitAperture, CLOSE] {
                    prop_assert!(word.read(line.as_bytes()).is_err());
                }
            }
        }

        #[test]
        fn any_bytes_are_a_reply_or_refused(line in prop::collection::vec(any::<u8>(), 0..200)) {
            for word in [Word::Version, Word::ReadFocus, Word::ReadAperture, Word::LearnFocus, SET, CLOSE] {
                if let Err(Misread::Refused(text) | Misread::Unexpected(text)) = word.read(&line) {
                    prop_assert!(!text.is_empty() && text.len() <= TEXT_CHARS + 7 && text.is_ascii());
                }
            }
        }
    }
}
