#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::file::mesh("a.ply", data);
});
