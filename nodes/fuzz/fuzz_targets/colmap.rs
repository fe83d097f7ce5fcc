#![no_main]
// The first byte chooses between text and binary.
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((kind, rest)) = data.split_first() else { return };
    let (cameras, images) = target::file::halves(rest);
    let names = if kind % 2 == 0 { ["cameras.bin", "images.bin"] } else { ["cameras.txt", "images.txt"] };
    target::file::cameras(names[0], &[(names[0], cameras), (names[1], images)]);
});
