#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::picture(&[b"II*\0", data].concat());
});
