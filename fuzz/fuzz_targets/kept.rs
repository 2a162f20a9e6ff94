#![no_main]

#[path = "../checks/kept.rs"]
mod kept;

libfuzzer_sys::fuzz_target!(|data: &[u8]| kept::check(data));
