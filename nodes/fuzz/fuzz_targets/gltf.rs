#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::read(br#"{"asset":{"version":"2.0"},"#, data);
});
