#![no_main]

#[path = "../checks.rs"]
mod checks;
#[path = "../harness.rs"]
mod harness;

libfuzzer_sys::fuzz_target!(|data: &[u8]| harness::within(data, checks::packets));
