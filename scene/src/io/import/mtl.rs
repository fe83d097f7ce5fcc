//! Materials of Wavefront OBJ files, after the MTL specification of Wavefront and the extension for physically
//! based materials (`Pr`, `Pm`). No crate is used: a library that stops at the first unusual line loses all
//! materials of the file.

use std::collections::BTreeSet;

use super::text::{Lines, number, relative, word, words};

/// A material.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Material {
    pub name: String,
    /// `Kd`, linear.
    pub diffuse: Option<[f32; 3]>,
    /// `Ke`, linear.
    pub emissive: Option<[f32; 3]>,
    /// Exponent `Ns` of the highlight.
    pub exponent: Option<f32>,
    /// Opacity: `d`, or one minus `Tr`.
    pub opacity: Option<f32>,
    /// `Pr`, from 0 to 1.
    pub roughness: Option<f32>,
    /// `Pm`, from 0 to 1.
    pub metallic: Option<f32>,
    /// `map_Kd`.
    pub texture: Option<Texture>,
}

/// A texture of a material.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Texture {
    /// Path relative to the material file.
    pub path: String,
    /// Offset of u and v (`-o`), added after the scale.
    pub offset: [f32; 2],
    /// Scale of u and v (`-s`).
    pub scale: [f32; 2],
}

/// The content of a material file.
#[derive(Debug, Default)]
pub(super) struct Parsed {
    pub materials: Vec<Material>,
    /// Lines that cannot be read, each with its number.
    pub wrong: Vec<(usize, String)>,
    /// Statements and options that change the look and are not read.
    pub ignored: BTreeSet<String>,
}

/// A material file that an OBJ file names.
#[derive(Debug)]
pub(super) struct Library {
    /// Path relative to the OBJ file.
    pub path: String,
    /// The content; `None` if the file cannot be read.
    pub bytes: Option<Vec<u8>>,
}

impl Library {
    /// Path of a file that the library names, relative to the OBJ file.
    pub fn sibling(&self, path: &str) -> String {
        self.path.rsplit_once('/').map_or_else(|| path.to_owned(), |(folder, _)| format!("{folder}/{path}"))
    }
}

/// The material files that an OBJ file names, in order. A statement may name several files; names may contain
/// spaces, so the rest of the line is tried first.
pub(super) fn libraries(obj: &[u8], read: &mut dyn FnMut(&str) -> Option<Vec<u8>>) -> Vec<Library> {
    let mut found: Vec<Library> = Vec::new();
    for (_, line) in Lines::of(obj) {
        let (keyword, rest) = word(&line);
        if !keyword.eq_ignore_ascii_case("mtllib") {
            continue;
        }
        let Some(whole) = relative(rest) else { continue };
        let mut made = vec![Library { bytes: read(&whole), path: whole }];
        if made[0].bytes.is_none() && rest.contains([' ', '\t']) {
            let several = words(rest).filter_map(relative);
            let several: Vec<Library> = several.map(|path| Library { bytes: read(&path), path }).collect();
            if several.iter().any(|library| library.bytes.is_some()) {
                made = several;
            }
        }
        for library in made {
            if found.iter().all(|known| known.path != library.path) {
                found.push(library);
            }
        }
    }
    found
}

/// One number for grey, or red, green and blue; a fourth number is ignored.
fn colour(rest: &str) -> Option<[f32; 3]> {
    let numbers = words(rest).map(number).collect::<Option<Vec<f32>>>()?;
    match numbers[..] {
        [grey] => Some([grey; 3]),
        [r, g, b] | [r, g, b, _] => Some([r, g, b]),
        _ => None,
    }
}

fn first_number(rest: &str) -> Option<f32> {
    words(rest).next().and_then(number)
}

/// Reads a texture statement: options such as `-s 1 1 1`, then a path. Adds the names of unsupported options to
/// `ignored`.
fn texture(rest: &str, ignored: &mut BTreeSet<String>) -> Option<Texture> {
    let (mut offset, mut scale) = ([0.0; 2], [1.0; 2]);
    let mut rest = rest;
    while rest.starts_with('-') {
        let (option, mut after) = word(rest);
        let most = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        let mut values: Vec<&str> = Vec::new();
        for _ in 0..most {
            let (value, following) = word(after);
            // Offsets and scales may have fewer numbers.
            if most == 1 || value.parse::<f32>().is_ok() {
                values.push(value);
                after = following;
            }
        }
        rest = after;
        let numbers: Vec<f32> = values.iter().filter_map(|value| number(value)).collect();
        let pair = |default: f32| [0, 1].map(|k| numbers.get(k).copied().unwrap_or(default));
        let neutral = match option {
            "-o" => {
                offset = pair(0.0);
                true
            }
            "-s" => {
                scale = pair(1.0);
                true
            }
            "-t" => numbers.iter().all(|v| *v == 0.0),
            "-mm" => numbers[..] == [0.0, 1.0],
            "-clamp" | "-cc" => values != ["on"],
            "-bm" => numbers[..] == [1.0],
            // These change no colour.
            "-blendu" | "-blendv" | "-texres" | "-type" => true,
            _ => false,
        };
        if !neutral {
            ignored.insert(format!("map_Kd {option}"));
        }
    }
    // A comment; names may contain the sign.
    let path = rest.split(" # ").next().unwrap_or_default();
    Some(Texture { path: relative(path)?, offset, scale })
}

fn word_as_written(line: &str) -> String {
    word(line).0.chars().take(40).collect()
}

/// Reads the materials of a file. Keywords may be in upper or lower case.
pub(super) fn parse(bytes: &[u8]) -> Parsed {
    let mut parsed = Parsed::default();
    for (line, text) in Lines::of(bytes) {
        let (keyword, rest) = word(&text);
        let keyword = keyword.to_ascii_lowercase();
        if keyword == "newmtl" {
            parsed.materials.push(Material { name: rest.to_owned(), ..Material::default() });
            continue;
        }
        let ignored = &mut parsed.ignored;
        let mut unplaced = Material::default();
        let placed = !parsed.materials.is_empty();
        let material = parsed.materials.last_mut().unwrap_or(&mut unplaced);
        let read = match keyword.as_str() {
            "kd" => colour(rest).map(|rgb| material.diffuse = Some(rgb)),
            "ke" => colour(rest).map(|rgb| material.emissive = Some(rgb)),
            "ns" => first_number(rest).map(|n| material.exponent = Some(n)),
            "pr" => first_number(rest).map(|n| material.roughness = Some(n)),
            "pm" => first_number(rest).map(|n| material.metallic = Some(n)),
            "d" => {
                let value = rest.strip_prefix("-halo").unwrap_or(rest);
                first_number(value).map(|n| material.opacity = Some(n))
            }
            // `d` has precedence, since programs disagree about the meaning of `Tr`: some write 1 for opaque, and
            // nobody saves an invisible material on purpose.
            "tr" => first_number(rest).map(|n| {
                if n < 1.0 {
                    material.opacity.get_or_insert(1.0 - n);
                }
            }),
            "map_kd" => texture(rest, ignored).map(|texture| material.texture = Some(texture)),
            // Ambient light, and numbers of which most files have the default.
            "ka" | "ks" | "ni" | "illum" | "tf" | "map_ka" | "sharpness" | "ps" | "pc" | "pcr" | "aniso"
            | "anisor" => Some(()),
            "bump" | "norm" | "disp" | "refl" | "decal" => {
                ignored.insert(keyword.clone());
                Some(())
            }
            // Textures, and keywords of other programs.
            word if word.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_') => {
                ignored.insert(word_as_written(&text));
                Some(())
            }
            _ => None,
        };
        if read.is_none() || !placed {
            parsed.wrong.push((line, text.chars().take(80).collect()));
        }
    }
    parsed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn red(text: &str) -> (Material, usize) {
        let parsed = parse(format!("newmtl red\n{text}\n").as_bytes());
        (parsed.materials[0].clone(), parsed.wrong.len())
    }

    #[test]
    fn colours_have_one_number_or_three() {
        for (text, found) in [
            ("Kd 0.8", Some([0.8; 3])),
            ("\tkd 0.8 0.2 0.1 # red", Some([0.8, 0.2, 0.1])),
            ("Kd 0.8 0.2 0.1 1.0", Some([0.8, 0.2, 0.1])),
            ("Kd 0.8 \\\n 0.2 0.1", Some([0.8, 0.2, 0.1])),
            ("Kd 0.8 0.2", None),
            ("Kd", None),
            ("Kd 0,8 0,2 0,1", None),
            ("Kd nan nan nan", None),
            ("Kd 1e39 0 0", None),
            ("Kd xyz 0.1 0.2 0.3", None),
            ("Kd spectral a.rfl", None),
        ] {
            let (material, wrong) = red(text);
            assert_eq!((material.diffuse, wrong), (found, usize::from(found.is_none())), "{text}");
        }
        assert_eq!(red("Ka 0.8\nKs 0.8\nillum 300\nNi").1, 0, "not used");
        assert_eq!((red("d -halo 0.5").0.opacity, red("Tr 0.25").0.opacity), (Some(0.5), Some(0.75)));
        assert_eq!(red("Tr 1\nd 1").0.opacity, Some(1.0));
        assert_eq!((red("d 1\nTr 1").0.opacity, red("Tr 1").0.opacity), (Some(1.0), None));
        assert_eq!((red("Pr 0.8\nPm 0").0.roughness, red("Ns x").1, red("d").1), (Some(0.8), 1, 1));
    }

    #[test]
    fn files_of_other_kinds_have_no_materials() {
        let lfs = parse(b"version https://git-lfs.github.com/spec/v1\noid sha256:abc\nsize 12\n");
        assert_eq!((lfs.materials.len(), lfs.wrong.len()), (0, 3));
        let early = parse(b"Kd 1 1 1\nnewmtl red\n");
        assert_eq!((early.materials.len(), early.wrong.len()), (1, 1));
        let latin = parse(b"\xef\xbb\xbf# gr\xfcn\r\nnewmtl gr\xfcn\r\nKd 1 0 0\r\n");
        assert_eq!((latin.materials[0].name.as_str(), latin.wrong.len()), ("gr\u{fc}n", 0));
    }

    #[test]
    fn textures_have_options_and_paths() {
        let of = |text: &str| {
            let parsed = parse(format!("newmtl a\n{text}\n").as_bytes());
            let texture = parsed.materials[0].texture.clone();
            (texture.map(|t| (t.path, t.offset, t.scale)), parsed.ignored.into_iter().collect::<Vec<_>>())
        };
        let plain = |path: &str| Some((path.to_owned(), [0.0; 2], [1.0; 2]));
        assert_eq!(of("map_Kd maps\\a  b.png"), (plain("maps/a  b.png"), vec![]));
        assert_eq!(of("map_kd -s 1 1 1 -o 0 0 0 \"t.png\""), (plain("t.png"), vec![]));
        let moved = Some(("t.png".to_owned(), [0.5, 0.25], [2.0, 3.0]));
        assert_eq!(of("map_Kd -s 2 3 -o 0.5 0.25 t.png"), (moved, vec![]));
        assert_eq!(of("map_Kd -clamp on t.png"), (plain("t.png"), vec!["map_Kd -clamp".to_owned()]));
        assert_eq!(of("map_Kd -mm 0 1 -clamp off C:\\x\\t.png"), (plain("t.png"), vec![]));
        assert_eq!(of("map_Kd t.png # made here"), (plain("t.png"), vec![]));
        assert_eq!(of("map_d d.png\nbump b.png\nmap_Ka a.png").1, ["bump", "map_d"]);
        assert_eq!(of("map_Kd").0, None);
        assert_eq!(of("Km 0.2\nvray_ior 1.5\nKm 0.3").1, ["Km", "vray_ior"], "of other programs");
        let library = |path: &str| Library { path: path.to_owned(), bytes: None };
        assert_eq!(library("sub/a.mtl").sibling("t.png"), "sub/t.png");
        assert_eq!(library("a.mtl").sibling("t.png"), "t.png");
    }

    #[test]
    fn statements_name_one_file_with_spaces_or_several() {
        let found = |text: &str, there: &[&str]| {
            let mut read = |name: &str| there.contains(&name).then(|| name.as_bytes().to_vec());
            let all = libraries(text.as_bytes(), &mut read);
            all.into_iter().map(|library| (library.path, library.bytes.is_some())).collect::<Vec<_>>()
        };
        let of = |name: &str, there: bool| (name.to_owned(), there);
        assert_eq!(found("mtllib a b.mtl\n", &["a b.mtl"]), [of("a b.mtl", true)]);
        assert_eq!(found("mtllib a.mtl b.mtl\n", &["a.mtl"]), [of("a.mtl", true), of("b.mtl", false)]);
        assert_eq!(found("mtllib a b.mtl\n", &[]), [of("a b.mtl", false)]);
        assert_eq!(found("mtllib a.mtl # b\n", &["a.mtl"]), [of("a.mtl", true)]);
        assert_eq!(found("\u{feff}mtllib \\\na.mtl\nmtllib a.mtl\n", &["a.mtl"]), [of("a.mtl", true)]);
        assert_eq!(found("mtllib C:\\x\\a.mtl\n", &["a.mtl"]), [of("a.mtl", true)]);
    }
}
