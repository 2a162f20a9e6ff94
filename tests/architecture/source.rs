//! A Rust source file seen as the paths that it names: enough of a lexer for that, and no more.

/// A source file, with its comments and literals taken out, and then its tests.
pub struct Source {
    code: String,
    opening_doc: String,
}

impl Source {
    pub fn new(text: &str) -> Self {
        let opening: Vec<&str> = text.lines().map_while(|line| line.strip_prefix("//!")).map(str::trim).collect();
        Self { code: without_tests(&without_literals(text)), opening_doc: opening.join(" ").trim().to_owned() }
    }

    /// What the file says of itself in its first lines.
    pub fn opening_doc(&self) -> &str {
        &self.opening_doc
    }

    /// Lines that hold code.
    pub fn code_lines(&self) -> usize {
        self.code.lines().filter(|line| !line.trim().is_empty()).count()
    }

    /// Every path that the file names, groups taken apart: `a::{b, c::d}` gives `a::b` and `a::c::d`.
    ///
    /// `super` chains that lead out of a file `depth` modules below the crate are given as `crate::…`.
    pub fn paths(&self, depth: usize) -> Vec<String> {
        let tokens = tokens(&self.code);
        let mut paths = Vec::new();
        let mut at = 0;
        while at < tokens.len() {
            at = path_from(&tokens, at, "", &mut paths).max(at + 1);
        }
        paths.iter().map(|path| out_of_super(path, depth)).collect()
    }
}

/// Reads one path at `at` behind `prefix`, adds it (and those of its groups) to `paths`, and returns where it ends.
fn path_from(tokens: &[&str], mut at: usize, prefix: &str, paths: &mut Vec<String>) -> usize {
    let mut path = prefix.to_owned();
    loop {
        match tokens.get(at) {
            Some(&"{") if !path.is_empty() && path.ends_with("::") => {
                at += 1;
                while tokens.get(at).is_some_and(|token| *token != "}") {
                    at = if tokens[at] == "," { at + 1 } else { path_from(tokens, at, &path, paths).max(at + 1) };
                }
                return at + 1;
            }
            Some(token) if is_name(token) => {
                path.push_str(token);
                at += 1;
            }
            _ => break,
        }
        if tokens.get(at) != Some(&"::") {
            break;
        }
        path.push_str("::");
        at += 1;
    }
    if path.len() > prefix.len() {
        paths.push(path.trim_end_matches("::").to_owned());
    }
    at
}

/// `super::super::x` from `depth` = 2 modules below the crate is `crate::x`.
fn out_of_super(path: &str, depth: usize) -> String {
    let climbs = path.split("::").take_while(|segment| *segment == "super").count();
    if climbs > 0 && climbs >= depth {
        let rest: Vec<&str> = path.split("::").skip(climbs).collect();
        return format!("crate::{}", rest.join("::"));
    }
    path.to_owned()
}

fn is_name(token: &str) -> bool {
    token.chars().next().is_some_and(|c| c.is_alphabetic() || c == '_')
}

/// Names, `::`, and every other sign by itself.
fn tokens(code: &str) -> Vec<&str> {
    let mut tokens = Vec::new();
    let mut rest = code.trim_start();
    while let Some(first) = rest.chars().next() {
        let length = if first.is_alphanumeric() || first == '_' {
            rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len())
        } else if rest.starts_with("::") {
            2
        } else {
            first.len_utf8()
        };
        tokens.push(&rest[..length]);
        rest = rest[length..].trim_start();
    }
    tokens
}

/// The text without what stands under `#[cfg(test)]`: one item, to its semicolon or its closing brace.
fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut kept = String::new();
    let mut rest = code;
    while let Some(start) = rest.find(MARK) {
        kept.push_str(&rest[..start]);
        rest = &rest[start + MARK.len()..];
        let mut open = 0_usize;
        let end = rest.char_indices().find(|(_, c)| match c {
            '{' => {
                open += 1;
                false
            }
            '}' => {
                open = open.saturating_sub(1);
                open == 0
            }
            ';' => open == 0,
            _ => false,
        });
        rest = end.map_or("", |(at, _)| &rest[at + 1..]);
    }
    kept + rest
}

/// The text without comments, and with empty strings and characters, so that braces and names in them count for nothing.
fn without_literals(text: &str) -> String {
    let mut code = String::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let skip = literal_or_comment(rest, code.chars().last());
        if skip == 0 {
            code.push(first);
            rest = &rest[first.len_utf8()..];
        } else {
            code.push(' ');
            rest = &rest[skip..];
        }
    }
    code
}

/// Length of the comment or literal that `rest` begins with, 0 for none. `before` is the character before it.
fn literal_or_comment(rest: &str, before: Option<char>) -> usize {
    let word_before = before.is_some_and(|c| c.is_alphanumeric() || c == '_');
    if rest.starts_with("//") {
        rest.find('\n').unwrap_or(rest.len())
    } else if rest.starts_with("/*") {
        block_comment(rest)
    } else if rest.starts_with('"') {
        quoted(rest, '"')
    } else if rest.starts_with('r') && !word_before {
        raw_string(rest)
    } else if let Some(after) = rest.strip_prefix('\'') {
        // A lifetime has no closing quote right behind one character.
        let mut chars = after.chars();
        match (chars.next(), chars.next()) {
            (Some('\\'), _) => quoted(rest, '\''),
            (Some(c), Some('\'')) => 2 + c.len_utf8(),
            _ => 0,
        }
    } else {
        0
    }
}

fn block_comment(rest: &str) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while at < rest.len() {
        match rest.get(at..at + 2) {
            Some("/*") => (depth, at) = (depth + 1, at + 2),
            Some("*/") => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
        if depth == 0 {
            return at;
        }
    }
    rest.len()
}

fn quoted(rest: &str, quote: char) -> usize {
    let mut escaped = false;
    for (at, c) in rest.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            _ if c == quote => return at + 1,
            _ => {}
        }
    }
    rest.len()
}

fn raw_string(rest: &str) -> usize {
    let hashes = rest[1..].chars().take_while(|c| *c == '#').count();
    if rest[1 + hashes..].starts_with('"') {
        let close = format!("\"{}", "#".repeat(hashes));
        rest[2 + hashes..].find(&close).map_or(rest.len(), |at| 2 + hashes + at + close.len())
    } else {
        0
    }
}
