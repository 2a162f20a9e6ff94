#![no_main]

#[path = "../checks/bad_pixels.rs"]
mod bad_pixels;

libfuzzer_sys::fuzz_target!(|data: &[u8]| bad_pixels::check(data));
