#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    target::file::cameras("transforms.json", &[("transforms.json", data)]);
});
