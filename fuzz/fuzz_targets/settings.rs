//! Settings files and assignments: what loads has finite numbers only, and every error names its place.
#![no_main]

use libfuzzer_sys::fuzz_target;
use stars::settings::Layers;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    for layers in
        [Layers::embedded().custom("custom.toml", text), Layers::flight("flight.toml", text), Layers::embedded().set(text)]
    {
        match layers.load() {
            // JSON has no number that is not finite.
            Ok(loaded) => assert!(!serde_json::to_string(&loaded.settings).expect("settings serialise").contains("null")),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
});
