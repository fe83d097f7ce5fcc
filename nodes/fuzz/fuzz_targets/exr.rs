#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::picture(&[b"\x76\x2f\x31\x01", data].concat());
});
