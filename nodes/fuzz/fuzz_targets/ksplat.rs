#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::read(b"\0\x01\0\0\x01\0\0\0", data);
});
