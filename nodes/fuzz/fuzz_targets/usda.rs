#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::read(b"#usda 1.0\n", data);
});
