#![no_main]

#[path = "../checks.rs"]
mod checks;
#[path = "../harness.rs"]
mod harness;

libfuzzer_sys::fuzz_target!(|data: &[u8]| harness::within(data, checks::readers::npz));
libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, max: usize, seed: u32| {
    harness::mutate::archive(data, size, max, seed)
});
