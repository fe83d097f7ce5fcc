#![no_main]
// The first byte chooses the level. The rest is `lod-meta.json` and the file with its splats.
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((level, rest)) = data.split_first() else { return };
    let (text, rows) = target::file::halves(rest);
    target::file::streamed(u32::from(level % 4), &[("lod-meta.json", text), ("a.sog", rows)]);
});
