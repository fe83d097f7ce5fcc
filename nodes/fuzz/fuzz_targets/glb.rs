#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::read(b"glTF\x02\0\0\0", data);
});
