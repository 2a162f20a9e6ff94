#![no_main]

#[path = "../checks/solve.rs"]
mod solve;

libfuzzer_sys::fuzz_target!(|data: &[u8]| solve::check(data));
