//! Writers of small test files, implemented from the specifications of the formats.

use std::io::Write;

use crate::io::splats::sh_rest;

/// A row of an INRIA PLY.
#[derive(Clone)]
pub struct PlyRow {
    pub mean: [f32; 3],
    pub dc: [f32; 3],
    pub rest: Vec<f32>,
    pub opacity: f32,
    pub scale: [f32; 3],
    pub rotation: [f32; 4],
}

impl Default for PlyRow {
    fn default() -> Self {
        Self {
            mean: [1.0, 2.0, 3.0],
            dc: [0.1, 0.2, 0.3],
            rest: Vec::new(),
            opacity: 0.5,
            scale: [-1.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
        }
    }
}

pub fn ply(rows: &[PlyRow], degree: u32) -> Vec<u8> {
    ply_with(rows, degree, &[])
}

pub fn ply_with(rows: &[PlyRow], degree: u32, extra: &[(&str, f32)]) -> Vec<u8> {
    let rest = sh_rest(degree) * 3;
    let names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2".split(' ').map(str::to_owned);
    let names = names
        .chain((0..rest).map(|i| format!("f_rest_{i}")))
        .chain("opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split(' ').map(str::to_owned))
        .chain(extra.iter().map(|(name, _)| (*name).to_owned()));
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", rows.len());
    names.for_each(|name| out.push_str(&format!("property float {name}\n")));
    out.push_str("end_header\n");
    let mut out = out.into_bytes();
    for row in rows {
        let mut harmonics = row.rest.clone();
        harmonics.resize(rest, 0.25);
        let numbers = row.mean.iter().chain(&[0.0; 3]).chain(&row.dc).chain(&harmonics);
        let numbers = numbers.chain([&row.opacity]).chain(&row.scale).chain(&row.rotation);
        for value in numbers.chain(extra.iter().map(|(_, value)| value)) {
            out.extend_from_slice(&value.to_le_bytes());
        }
    }
    out
}

/// A row of a compressed PLY.
#[derive(Clone)]
pub struct Packed {
    pub position: u32,
    pub rotation: u32,
    pub scale: u32,
    pub colour: u32,
    pub rest: Vec<u8>,
}

/// A compressed PLY with centres from -1 to 2 (shifted by 10 for each chunk), scales from e^-6 to 1, and colours
/// from -0.5 to 1.5.
pub fn compressed_ply(rows: &[Packed], degree: u32) -> Vec<u8> {
    let chunks = rows.len().div_ceil(256);
    let mut out =
        format!("ply\nformat binary_little_endian 1.0\ncomment made here\nelement chunk {chunks}\n");
    let bounds = ["min_x", "min_y", "min_z", "max_x", "max_y", "max_z"];
    let bounds = bounds.map(str::to_owned).into_iter();
    let scales = ["min", "max"].into_iter().flat_map(|m| ["x", "y", "z"].map(|a| format!("{m}_scale_{a}")));
    let colours = ["min", "max"].into_iter().flat_map(|m| ["r", "g", "b"].map(|a| format!("{m}_{a}")));
    bounds.chain(scales).chain(colours).for_each(|name| out.push_str(&format!("property float {name}\n")));
    out.push_str(&format!("element vertex {}\n", rows.len()));
    for name in ["position", "rotation", "scale", "color"] {
        out.push_str(&format!("property uint packed_{name}\n"));
    }
    if degree > 0 {
        out.push_str(&format!("element sh {}\n", rows.len()));
        (0..sh_rest(degree) * 3).for_each(|i| out.push_str(&format!("property uchar f_rest_{i}\n")));
    }
    out.push_str("end_header\n");
    let mut out = out.into_bytes();
    for chunk in 0..chunks {
        let at = 10.0 * chunk as f32;
        let numbers = [[at - 1.0; 3], [at + 2.0; 3], [-6.0; 3], [0.0; 3], [-0.5; 3], [1.5; 3]];
        numbers.as_flattened().iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
    }
    for row in rows {
        for word in [row.position, row.rotation, row.scale, row.colour] {
            out.extend_from_slice(&word.to_le_bytes());
        }
    }
    rows.iter().for_each(|row| out.extend_from_slice(&row.rest));
    out
}

pub fn splat(count: usize) -> Vec<u8> {
    let mut out = Vec::new();
    for i in 0..count {
        let v = i as f32;
        for number in [v, -v, v * 2.0, 0.5, 0.25, 0.0] {
            out.extend_from_slice(&number.to_le_bytes());
        }
        out.extend_from_slice(&[255, 0, 128, 51, 192, 64, 192, 64]);
    }
    out
}

/// Converts a number to an IEEE 16-bit float. Panics if the conversion is not exact.
pub fn half(value: f32) -> [u8; 2] {
    let bits = value.to_bits();
    let sign = (bits >> 16 & 0x8000) as u16;
    if value == 0.0 {
        return sign.to_le_bytes();
    }
    let exponent = (bits >> 23 & 255) as i32 - 127 + 15;
    assert!((1..31).contains(&exponent) && bits & 0x1fff == 0, "{value}");
    (sign | (exponent as u16) << 10 | (bits >> 13 & 1023) as u16).to_le_bytes()
}

/// The coefficient that [`ksplat`] writes, from -1 to 1 in steps of 1/16.
pub fn harmonic(i: usize, channel: usize) -> f32 {
    ((i * 5 + channel * 11) % 32) as f32 / 16.0 - 1.0
}

/// A `.ksplat` of five splats: a full bucket of two, then partially filled buckets of one and two.
pub fn ksplat(level: usize, degree: usize) -> Vec<u8> {
    let mut head = vec![0_u8; 4096 + 1024];
    let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
    put(1, &[1]);
    for (at, word) in [(4, 1_u32), (8, 1), (12, 5), (16, 5)] {
        put(at, &word.to_le_bytes());
    }
    put(20, &(level as u16).to_le_bytes());
    put(36, &(-1.0_f32).to_le_bytes());
    put(40, &1.0_f32.to_le_bytes());
    let section = 4096;
    let packed = level > 0;
    put(section, &5_u32.to_le_bytes());
    put(section + 4, &5_u32.to_le_bytes());
    put(section + 40, &(degree as u16).to_le_bytes());
    if packed {
        put(section + 8, &2_u32.to_le_bytes());
        put(section + 12, &3_u32.to_le_bytes());
        put(section + 16, &4.0_f32.to_le_bytes());
        put(section + 20, &12_u16.to_le_bytes());
        put(section + 24, &32_767_u32.to_le_bytes());
        put(section + 32, &1_u32.to_le_bytes());
        put(section + 36, &2_u32.to_le_bytes());
    }
    let mut out = head;
    let centres = [[0.0_f32, 0.0, -1.0], [0.5, -1.0, -2.0], [1.0, -2.5, -3.5]];
    if packed {
        out.extend_from_slice(&1_u32.to_le_bytes());
        out.extend_from_slice(&2_u32.to_le_bytes());
        centres.as_flattened().iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
    }
    for i in 0..5 {
        let v = i as f32;
        let real = |out: &mut Vec<u8>, value: f32| match level {
            0 => out.extend_from_slice(&value.to_le_bytes()),
            _ => out.extend_from_slice(&half(value)),
        };
        let mean = [v * 0.25, 1.0 - v, -v];
        for axis in 0..3 {
            if packed {
                let from = mean[axis] - centres[[0, 0, 1, 2, 2][i]][axis];
                let steps = (from / (2.0 / 32_767.0)).round() + 32_767.0;
                out.extend_from_slice(&(steps as u16).to_le_bytes());
            } else {
                real(&mut out, mean[axis]);
            }
        }
        [0.5, 0.25, 0.125].into_iter().for_each(|s| real(&mut out, s));
        [1.0, -1.0, 1.0, 1.0].into_iter().for_each(|q| real(&mut out, q));
        out.extend_from_slice(&[255, 0, 128, 102]);
        for l in 1..=degree {
            for channel in 0..3 {
                for m in 0..2 * l + 1 {
                    let value = harmonic(l * l - 1 + m, channel);
                    match level {
                        2 => out.push(((value + 1.0) / 2.0 * 255.0).round() as u8),
                        _ => real(&mut out, value),
                    }
                }
            }
        }
    }
    out
}

/// Three splats in SPZ of any version, flagged antialiased.
pub fn spz(version: u32, degree: u8) -> Vec<u8> {
    let rest = sh_rest(degree.into());
    let mut streams: [Vec<u8>; 6] = Default::default();
    for i in 0..3 {
        let v = i as f32;
        for value in [1.5 * v, -2.25 * v, 0.125 * v] {
            match version {
                1 => streams[0].extend_from_slice(&half(value)),
                _ => streams[0].extend_from_slice(&((value * 4096.0) as i32).to_le_bytes()[..3]),
            }
        }
        streams[1].push([0, 51, 255][i]);
        streams[2].extend_from_slice(&[128, 255, 0]);
        streams[3].extend_from_slice(&[144, 160, 120]);
        // w 0.8, x 0, y 0.36, z -0.48.
        match version {
            1 | 2 => streams[4].extend([0.0_f32, 0.36, -0.48].map(|q| (q * 127.5 + 127.5).round() as u8)),
            _ => {
                let part = |q: f32| {
                    let size = (q.abs() / std::f32::consts::FRAC_1_SQRT_2 * 511.0).round() as u32;
                    u32::from(q < 0.0) << 9 | size
                };
                let word = 3 << 30 | part(0.0) << 20 | part(0.36) << 10 | part(-0.48);
                streams[4].extend_from_slice(&word.to_le_bytes());
            }
        }
        for _ in 0..rest {
            streams[5].extend_from_slice(&[0, 128, 192]);
        }
    }
    let mut head = b"NGSP".to_vec();
    head.extend_from_slice(&version.to_le_bytes());
    head.extend_from_slice(&3_u32.to_le_bytes());
    head.extend_from_slice(&[degree, 12, 1]);
    if version < 4 {
        head.push(0);
        streams.iter().for_each(|stream| head.extend_from_slice(stream));
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        packed.write_all(&head).unwrap();
        return packed.finish().unwrap();
    }
    let streams: Vec<Vec<u8>> = streams.into_iter().filter(|stream| !stream.is_empty()).collect();
    head.push(streams.len() as u8);
    head.extend_from_slice(&32_u32.to_le_bytes());
    head.extend_from_slice(&[0; 12]);
    let packed: Vec<Vec<u8>> = streams.iter().map(|stream| zstd(stream)).collect();
    for (packed, stream) in packed.iter().zip(&streams) {
        head.extend_from_slice(&(packed.len() as u64).to_le_bytes());
        head.extend_from_slice(&(stream.len() as u64).to_le_bytes());
    }
    packed.iter().for_each(|packed| head.extend_from_slice(packed));
    head
}

/// A Zstandard frame of one raw block (RFC 8878, section 3.1.1).
fn zstd(bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![0x28, 0xb5, 0x2f, 0xfd, 0x20, bytes.len() as u8];
    out.extend_from_slice(&((bytes.len() as u32) << 3 | 1).to_le_bytes()[..3]);
    out.extend_from_slice(bytes);
    out
}

fn webp(width: u32, height: u32, pixel: impl Fn(usize) -> [u8; 4]) -> Vec<u8> {
    let rgba: Vec<u8> = (0..(width * height) as usize).flat_map(pixel).collect();
    let mut out = Vec::new();
    image_webp::WebPEncoder::new(&mut out)
        .encode(&rgba, width, height, image_webp::ColorType::Rgba8)
        .unwrap();
    out
}

/// Seven splats of degree 1 in SOG of either version. Both versions have the same numbers, except for the
/// opacities.
pub fn sog(version: u32) -> Vec<(String, Vec<u8>)> {
    let names = ["means_l", "means_u", "scales", "quats", "sh0", "shN_centroids", "shN_labels"];
    let names = names.map(|name| format!("{name}.webp"));
    // Centre 3 is (19, -0.5, 0) in logarithms.
    let third = |i: usize| -> [u16; 3] {
        if i == 3 { [65_535, 0, 6157] } else { [(i * 9000) as u16, (i * 4000) as u16, 777] }
    };
    let pictures = [
        webp(3, 3, |i| third(i).map(|v| v as u8).concat_alpha(255)),
        webp(3, 3, |i| third(i).map(|v| (v >> 8) as u8).concat_alpha(255)),
        webp(3, 3, |i| [i as u8 * 20, 0, 255, 255]),
        webp(3, 3, |i| [128, 40, 200, 252 + (i % 4) as u8]),
        webp(3, 3, |i| [0, 128, 255, if i == 3 { 255 } else { i as u8 * 30 }]),
        // A palette of three sets: 64 sets of 3 pixels in a row.
        webp(192, 1, |i| [i as u8, 255 - i as u8, 7, 255]),
        webp(3, 3, |i| [(i % 3) as u8, 0, 0, 255]),
    ];
    let line = |low: f64, high: f64| -> Vec<f64> {
        (0..256).map(|i| low + (high - low) * f64::from(i) / 255.0).collect()
    };
    let ln = crate::math::num::f64::ln;
    let files = |i: usize, n: usize| serde_json::json!(names[i..i + n]);
    let means = serde_json::json!({"shape": [7, 3], "mins": [-1.0, -ln(1.5), -0.1], "maxs": [ln(20.0), 1.0, 0.964], "files": files(0, 2)});
    let quats = serde_json::json!({"files": files(3, 1)});
    let meta = if version == 2 {
        serde_json::json!({
            "version": 2, "count": 7, "means": means, "quats": quats,
            "scales": {"codebook": line(-7.0, 1.0), "files": files(2, 1)},
            "sh0": {"codebook": line(-2.0, 3.0), "files": files(4, 1)},
            "shN": {"count": 3, "bands": 1, "codebook": line(-0.5, 0.5), "files": files(5, 2)},
        })
    } else {
        serde_json::json!({
            "means": means, "quats": quats,
            "scales": {"mins": [-7.0, -7.0, -7.0], "maxs": [1.0, 1.0, 1.0], "files": files(2, 1)},
            "sh0": {"mins": [-2.0, -2.0, -2.0, -1.0], "maxs": [3.0, 3.0, 3.0, 20.0], "files": files(4, 1)},
            "shN": {"shape": [7, 9], "mins": -0.5, "maxs": 0.5, "quantization": 8, "files": files(5, 2)},
        })
    };
    let mut out = vec![("meta.json".to_owned(), serde_json::to_vec(&meta).unwrap())];
    out.extend(names.into_iter().zip(pictures));
    out
}

trait ConcatAlpha {
    fn concat_alpha(self, alpha: u8) -> [u8; 4];
}
impl ConcatAlpha for [u8; 3] {
    fn concat_alpha(self, alpha: u8) -> [u8; 4] {
        [self[0], self[1], self[2], alpha]
    }
}

/// A ZIP archive, stored or deflated.
pub fn zip(folder: &str, files: &[(String, Vec<u8>)], deflated: bool) -> Vec<u8> {
    let (mut out, mut contents) = (Vec::new(), Vec::new());
    for (name, bytes) in files {
        let name = format!("{folder}{name}");
        let mut checksum = flate2::Crc::new();
        checksum.update(bytes);
        let packed = if deflated {
            let mut packed = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::default());
            packed.write_all(bytes).unwrap();
            packed.finish().unwrap()
        } else {
            bytes.clone()
        };
        let mut common = vec![20, 0, 0, 0, if deflated { 8 } else { 0 }, 0, 0, 0, 0, 0];
        for word in [checksum.sum(), packed.len() as u32, bytes.len() as u32] {
            common.extend_from_slice(&word.to_le_bytes());
        }
        common.extend_from_slice(&(name.len() as u16).to_le_bytes());
        common.extend_from_slice(&[0, 0]);
        contents.extend_from_slice(b"PK\x01\x02\x14\0");
        contents.extend_from_slice(&common);
        contents.extend_from_slice(&[0; 10]);
        contents.extend_from_slice(&(out.len() as u32).to_le_bytes());
        contents.extend_from_slice(name.as_bytes());
        out.extend_from_slice(b"PK\x03\x04");
        out.extend_from_slice(&common);
        out.extend_from_slice(name.as_bytes());
        out.extend_from_slice(&packed);
    }
    let (start, length, n) = (out.len() as u32, contents.len() as u32, files.len() as u16);
    out.extend_from_slice(&contents);
    out.extend_from_slice(b"PK\x05\x06\0\0\0\0");
    out.extend_from_slice(&n.to_le_bytes());
    out.extend_from_slice(&n.to_le_bytes());
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(&start.to_le_bytes());
    out.extend_from_slice(&[0, 0]);
    out
}

/// Two splats as GLB; `node` is the JSON of the node in addition to its mesh.
pub fn glb(node: &str, colours: &str) -> Vec<u8> {
    let mut binary: Vec<u8> = Vec::new();
    let (mut views, mut accessors, mut attributes) = (Vec::new(), Vec::new(), Vec::new());
    let mut column = |name: &str, kind: u32, shape: &str, normalized: bool, bytes: Vec<u8>| {
        let n = views.len();
        views.push(format!(r#"{{"buffer":0,"byteOffset":{},"byteLength":{}}}"#, binary.len(), bytes.len()));
        accessors.push(format!(
            r#"{{"bufferView":{n},"componentType":{kind},"normalized":{normalized},"count":2,"type":"{shape}"}}"#
        ));
        attributes.push(format!(r#""{name}":{n}"#));
        binary.extend_from_slice(&bytes);
        binary.resize(binary.len().next_multiple_of(4), 0);
    };
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let name = |what: &str| format!("KHR_gaussian_splatting:{what}");
    column("POSITION", 5126, "VEC3", false, floats(&[1.0, 2.0, 3.0, -1.0, 0.0, 0.5]));
    let turns: Vec<u8> =
        [0_i16, 0, 0, 32_767, 18_918, 0, 0, 26_754].iter().flat_map(|v| v.to_le_bytes()).collect();
    column(&name("ROTATION"), 5122, "VEC4", true, turns);
    column(&name("SCALE"), 5126, "VEC3", false, floats(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.0]));
    column(&name("OPACITY"), 5121, "SCALAR", true, vec![255, 51]);
    column(&name("SH_DEGREE_0_COEF_0"), 5126, "VEC3", false, floats(&[0.5, 0.25, -0.5, 1.0, 1.0, 1.0]));
    for n in 0..3 {
        let v = n as f32;
        column(
            &name(&format!("SH_DEGREE_1_COEF_{n}")),
            5126,
            "VEC3",
            false,
            floats(&[v, 0.0, 1.0, -v, 2.0, 3.0]),
        );
    }
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_gaussian_splatting"],"scene":0,"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"mesh":0{node}}}],"buffers":[{{"byteLength":{}}}],"bufferViews":[{}],"accessors":[{}],
        "meshes":[{{"primitives":[{{"mode":0,"attributes":{{{}}},"extensions":{{"KHR_gaussian_splatting":
        {{"kernel":"ellipse","colorSpace":"{colours}","sortingMethod":"cameraDistance"}}}}}}]}}]}}"#,
        binary.len(),
        views.join(","),
        accessors.join(","),
        attributes.join(","),
    );
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend_from_slice(&((12 + 8 + json.len() + 8 + binary.len()) as u32).to_le_bytes());
    out.extend_from_slice(&(json.len() as u32).to_le_bytes());
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&json);
    out.extend_from_slice(&(binary.len() as u32).to_le_bytes());
    out.extend_from_slice(b"BIN\0");
    out.extend_from_slice(&binary);
    out
}
