#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::picture(&[b"#?RADIANCE\n", data].concat());
});
