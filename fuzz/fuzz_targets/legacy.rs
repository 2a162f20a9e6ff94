#![no_main]

#[path = "../checks/legacy.rs"]
mod legacy;

libfuzzer_sys::fuzz_target!(|data: &[u8]| legacy::check(data));
