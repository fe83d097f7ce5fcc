#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::read(b"ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\nproperty float min_y\nproperty float min_z\n", data);
});
