//! Settings files and assignments: what loads has finite numbers only, and every error names its place.
use stars::settings::Layers;

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    // The first byte says what the text is: a (f)light file, an as(s)ignment, or a custom file.
    let Some((what, text)) = data.split_first() else { return };
    let Ok(text) = std::str::from_utf8(text) else { return };
    let layers = match what {
        b'f' => Layers::flight("flight.toml", text),
        b's' => Layers::embedded().set(text),
        _ => Layers::embedded().custom("custom.toml", text),
    };
    match layers.load() {
        // JSON has no number that is not finite.
        Ok(loaded) => assert!(!serde_json::to_string(&loaded.settings).expect("settings serialise").contains("null")),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
