//! The page, as a browser reads it: one document without any other file, and the mask tool, which also stands alone.

use std::sync::OnceLock;

/// The tool for masks: a document that needs nothing else, served beside the page and readable from a disk.
pub const MASK_TOOL: &str = include_str!("../../config/mask.html");

const FRAME: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
const PROGRAM: [&str; 5] = [
    include_str!("page/words.js"),
    include_str!("page/picture.js"),
    include_str!("page/panels.js"),
    include_str!("page/focus.js"),
    include_str!("page/main.js"),
];

/// The page.
pub fn page() -> &'static str {
    static PAGE: OnceLock<String> = OnceLock::new();
    PAGE.get_or_init(|| FRAME.replace("/* style */", STYLE).replace("/* program */", &PROGRAM.concat()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_and_tool_are_whole_and_name_nothing_outside() {
        for (name, text) in [("page", page()), ("mask.html", MASK_TOOL)] {
            assert!(text.starts_with("<!doctype html>") && text.trim_end().ends_with("</html>"), "{name}");
            assert!(!text.contains("/* style */") && !text.contains("/* program */"), "{name}");
            for outside in ["http://", "https://", "//cdn", "@import", "src=\"http"] {
                assert!(!text.contains(outside), "{name} has {outside}");
            }
        }
    }
}
