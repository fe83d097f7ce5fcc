#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::file::object("a.obj", data);
});
