#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::read(b"ply\nformat binary_little_endian 1.0\nelement vertex ", data);
});
