//! Tests with files that are something else: text, meshes, pointers of Git LFS, parts that were not fetched.

use super::*;

// A `.splat` file has no header, so any file whose size is a multiple of 32 was one.
#[test]
fn text_is_not_read_as_splats() {
    for line in ["0.511822,0.950464,0.144160\n", "v 0.511822 0.950464 0.144160\n", "cl\u{e9}ment 1 2 3\r\n"] {
        for count in [32, 33, 500] {
            let mut text = line.repeat(count).into_bytes();
            text.resize(text.len().next_multiple_of(32), b' ');
            let error = read(&text).err().unwrap_or_else(|| panic!("{line} is read"));
            assert!(error.message().contains("a text file, but not in a known splat format"), "{error}");
        }
    }
    // Centres that begin like JPEG XL.
    let mut splat = build::splat(3);
    splat[..4].copy_from_slice(&f32::from_bits(0x3f80_0aff).to_le_bytes());
    assert_eq!(read(&splat).unwrap().0.len(), 3);
    assert!(read(b"\xff\x0a and the rest of it").is_err_and(|e| e.message().contains("JPEG XL")));
}

// Pictures of a SOG scene that were not fetched, and their names as Windows writes them.
#[test]
fn pictures_of_sog_that_are_something_else_are_named() {
    let mut files = build::sog(2);
    let name = files[1].0.clone();
    files[1].1 = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n".to_vec();
    let error = read(&build::zip("", &files, false)).err().unwrap();
    assert!(error.message().contains("git lfs pull") && error.message().contains(&name), "{error}");
    let mut files = build::sog(2);
    let (wanted, _) = read(&build::zip("", &files, false)).unwrap();
    let meta = String::from_utf8(files[0].1.clone()).unwrap();
    assert!(meta.contains(&format!("\"{name}\"")));
    files[0].1 = meta.replace(&format!("\"{name}\""), &format!("\".\\\\{name}\"")).into_bytes();
    assert!(read(&build::zip("", &files, false)).unwrap().0 == wanted);
}

/// Files of meshes are named, although their numbers could be those of a `.splat` file.
#[test]
fn formats_of_meshes_are_named() {
    let fbx = [&b"Kaydara FBX Binary  \0\x1a\0"[..], &[0_u8; 77][..]].concat();
    let blender = [&b"BLENDER-v300"[..], &[0_u8; 84][..]].concat();
    for (bytes, says) in
        [(&fbx[..], "FBX"), (&blender[..], "Blender"), (b"solid a\n facet normal 0 0 1\n", "STL")]
    {
        let error = read(bytes).err().unwrap();
        assert!(error.message().contains(says) && error.message().contains("without splats"), "{error}");
    }
}

#[test]
fn pointers_of_git_lfs_are_named() {
    let text = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22e\nsize 12345\n";
    let error = read(text).err().unwrap();
    assert!(error.message().contains("git lfs pull"), "{error}");
}
