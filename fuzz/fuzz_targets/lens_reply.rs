#![no_main]

#[path = "../checks/lens_reply.rs"]
mod lens_reply;

libfuzzer_sys::fuzz_target!(|data: &[u8]| lens_reply::check(data));
