//! COLMAP models: the files `cameras` and `images`, as text or binary.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{BufRead, Read};

use super::distortion::{Bend, Coefficients};
use super::raw::{Raw, from_colmap};
use crate::error::Error;
use crate::io::foreign::{BYTE_ORDER_MARK, refuse_foreign};
use crate::types::LensModel;

/// Name of each camera model and its number of parameters, in the order of the model numbers in binary files;
/// see COLMAP's documentation of cameras.txt and its `sensor/models.h`.
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    (PANORAMA, 2),
];
/// The camera model of panoramas. Its parameters are the width and the height.
const PANORAMA: &str = "EQUIRECTANGULAR";

struct Lens {
    width: u64,
    height: u64,
    lens: [f64; 4],
    distortion: Option<Bend>,
}

/// Distortion coefficients of a model that is not a fisheye, from the parameters after the principal point.
fn coefficients(model: &str, rest: &[f64]) -> Coefficients {
    let mut found = Coefficients::default();
    match (model, rest) {
        ("SIMPLE_RADIAL", [k1]) => found.k[0] = *k1,
        ("RADIAL", [k1, k2]) => found.k[..2].copy_from_slice(&[*k1, *k2]),
        ("OPENCV", [k1, k2, p1, p2]) => {
            found.k[..2].copy_from_slice(&[*k1, *k2]);
            found.p = [*p1, *p2];
        }
        ("FULL_OPENCV", [k1, k2, p1, p2, others @ ..]) => {
            found.k[..2].copy_from_slice(&[*k1, *k2]);
            found.p = [*p1, *p2];
            found.k[2..].iter_mut().zip(others).for_each(|(to, from)| *to = *from);
        }
        ("FOV", [omega]) => found.omega = *omega,
        // A point at the radius r of the picture moves by r^3 |k| / (1 + k r^2), which is at most 2 |k| r^3 if |k| r^2
        // is at most 1/2. Beyond that, the bound is larger than the half of the picture.
        ("SIMPLE_DIVISION" | "DIVISION", [k]) => found.k[0] = 2.0 * k,
        _ => {}
    }
    found
}

/// The lens model, from the parameters after the principal point. `None` for models that cameras cannot have.
fn lens_model(model: &str, rest: &[f64]) -> Option<LensModel> {
    let fisheye = |given: &[f64]| {
        let mut k = [0.0; 4];
        k.iter_mut().zip(given).for_each(|(to, from)| *to = *from);
        LensModel::Fisheye { k }
    };
    match (model, rest) {
        ("SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "FULL_OPENCV", _) => {
            Some(coefficients(model, rest).rational())
        }
        ("OPENCV_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" | "SIMPLE_FISHEYE" | "FISHEYE", k) => {
            Some(fisheye(k))
        }
        ("FOV", [omega]) => Some(LensModel::FieldOfView { omega: *omega }),
        ("SIMPLE_DIVISION" | "DIVISION", [k]) => Some(LensModel::Division { k: *k }),
        _ => None,
    }
}

/// Reads the parameters of a camera. The error is the end of a sentence that begins with the camera.
fn lens(model: &str, width: u64, height: u64, params: &[f64]) -> Result<Lens, String> {
    let Some((_, count)) = MODELS.iter().find(|(name, _)| *name == model) else {
        return Err(format!("has the camera model `{model}`, which is unknown"));
    };
    if model == PANORAMA {
        return Err(format!("has the camera model `{model}`, which is not a perspective camera"));
    }
    let wrong = || {
        format!(
            "has the wrong number of parameters, {} (the camera model `{model}` needs {count})",
            params.len()
        )
    };
    if params.len() != *count {
        return Err(wrong());
    }
    let one_focal = matches!(
        model,
        "SIMPLE_PINHOLE"
            | "SIMPLE_RADIAL"
            | "RADIAL"
            | "SIMPLE_RADIAL_FISHEYE"
            | "RADIAL_FISHEYE"
            | "SIMPLE_DIVISION"
            | "SIMPLE_FISHEYE"
    );
    let (lens, rest) = match (one_focal, params) {
        (true, [f, cx, cy, rest @ ..]) => ([*f, *f, *cx, *cy], rest),
        (false, [fx, fy, cx, cy, rest @ ..]) => ([*fx, *fy, *cx, *cy], rest),
        _ => return Err(wrong()),
    };
    let pixels = match (model, rest) {
        // Fisheye models distort even when all their coefficients are 0.
        _ if model.contains("FISHEYE") => f64::INFINITY,
        // The parameters are alpha and beta; an alpha of 0 is a pinhole camera.
        ("EUCM", [alpha, _]) => {
            if *alpha == 0.0 {
                0.0
            } else {
                f64::INFINITY
            }
        }
        _ => coefficients(model, rest).pixels([width, height], lens),
    };
    let bends = pixels.partial_cmp(&0.0) != Some(std::cmp::Ordering::Equal);
    let distortion =
        bends.then(|| Bend { text: format!("{model} {rest:?}"), model: lens_model(model, rest), pixels });
    Ok(Lens { width, height, lens, distortion })
}

fn camera(
    file: &str,
    lenses: &BTreeMap<u64, Lens>,
    id: u64,
    picture: String,
    q: [f64; 4],
    t: [f64; 3],
) -> Result<Raw, Error> {
    let lens = lenses.get(&id).ok_or_else(|| {
        Error::format(file, format!("image `{picture}` refers to camera {id}, which does not exist"))
    })?;
    let world_from_camera = from_colmap(q, t)
        .ok_or_else(|| Error::format(file, format!("image `{picture}` has a quaternion of length 0")))?;
    let Lens { width, height, lens, distortion } = lens;
    Ok(Raw {
        picture,
        width: *width,
        height: *height,
        lens: *lens,
        distortion: distortion.clone(),
        world_from_camera,
    })
}

/// Sorts cameras by name, as the INRIA code and most other programs do. Every eighth camera is then the same camera
/// as in those programs.
fn sorted(mut cameras: Vec<Raw>) -> Vec<Raw> {
    cameras.sort_by(|a, b| a.picture.cmp(&b.picture));
    cameras
}

/// Reads `cameras.txt` and `images.txt`.
pub fn text(file: &str, cameras: &[u8], images: &[u8]) -> Result<Vec<Raw>, Error> {
    // Names of pictures have the encoding of the system that wrote them, so they may not be UTF-8.
    fn as_text<'a>(file: &str, bytes: &'a [u8]) -> Result<Cow<'a, str>, Error> {
        refuse_foreign(file, bytes)?;
        Ok(String::from_utf8_lossy(bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes)))
    }
    let mut lenses = BTreeMap::new();
    for (number, line) in as_text(file, cameras)?.lines().enumerate() {
        if line.trim().is_empty() || line.trim_start().starts_with('#') {
            continue;
        }
        let odd = || Error::format(file, format!("line {} of cameras.txt cannot be parsed", number + 1));
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let [id, model, width, height, params @ ..] = words.as_slice() else { return Err(odd()) };
        let params = params.iter().map(|w| w.parse().ok()).collect::<Option<Vec<f64>>>().ok_or_else(odd)?;
        let whole = |word: &str| word.parse::<u64>().map_err(|_| odd());
        let id = whole(id)?;
        let lens = lens(model, whole(width)?, whole(height)?, &params)
            .map_err(|what| Error::unsupported(file, format!("camera {id} {what}")))?;
        lenses.insert(id, lens);
    }
    let mut found = Vec::new();
    for (number, line) in as_text(file, images)?.lines().enumerate() {
        // Lines between the cameras list the points that they see, unless the writer left them out: triples of
        // numbers, or empty.
        if line.trim().is_empty() || line.trim_start().starts_with('#') || is_points(line) {
            continue;
        }
        let odd = || Error::format(file, format!("line {} of images.txt cannot be parsed", number + 1));
        // The name is last and may contain spaces.
        let (words, name) = first_words::<9>(line).ok_or_else(odd)?;
        let [image, pose @ .., id] = words.as_slice() else { return Err(odd()) };
        image.parse::<u64>().map_err(|_| odd())?;
        let pose = pose.iter().map(|w| w.parse().ok()).collect::<Option<Vec<f64>>>().ok_or_else(odd)?;
        let [w, x, y, z, t0, t1, t2] = pose[..] else { return Err(odd()) };
        let id = id.parse().map_err(|_| odd())?;
        found.push(camera(file, &lenses, id, name.to_owned(), [w, x, y, z], [t0, t1, t2])?);
    }
    Ok(sorted(found))
}

/// Splits a line into its first `N` words and the remaining text. `None` if no text remains.
fn first_words<const N: usize>(line: &str) -> Option<([&str; N], &str)> {
    let mut rest = line.trim();
    let mut words = [""; N];
    for word in &mut words {
        (*word, rest) = rest.split_once(|c: char| c.is_ascii_whitespace())?;
        rest = rest.trim_start();
    }
    (!rest.is_empty()).then_some((words, rest))
}

/// Number of images in an `images.txt`, without checking them. Memory does not depend on the length of the lines.
pub fn count_images(reader: &mut impl BufRead) -> std::io::Result<usize> {
    /// Number of bytes of a line that are kept. The first words of a line distinguish images and points.
    const HEAD: u64 = 1 << 16;
    let (mut count, mut first, mut head) = (0, true, Vec::new());
    loop {
        head.clear();
        if reader.by_ref().take(HEAD).read_until(b'\n', &mut head)? == 0 {
            return Ok(count);
        }
        let cut = !head.ends_with(b"\n");
        if cut {
            reader.skip_until(b'\n')?;
        }
        let line = head.strip_prefix(BYTE_ORDER_MARK).filter(|_| first).unwrap_or(&head);
        first = false;
        let line = String::from_utf8_lossy(line);
        let line = line.trim();
        let few: Vec<&str> = line.split_ascii_whitespace().take(FEW).collect();
        let points = if few.len() < FEW { is_points(line) } else { are_points(&few) };
        if !(line.is_empty() || line.starts_with('#') || points) {
            count += 1;
        }
    }
}

/// Number of words that distinguish a long line of points from an image: four points. An image has ten words or
/// more, and its tenth word begins its name.
const FEW: usize = 12;

/// True if a line of images.txt lists points.
fn is_points(line: &str) -> bool {
    are_points(&line.split_ascii_whitespace().collect::<Vec<_>>())
}

/// True if words are points: repeated x, y, and the index of a 3D point or -1.
fn are_points(words: &[&str]) -> bool {
    words.len().is_multiple_of(3)
        && words.chunks(3).all(|point| match point {
            [x, y, id] => x.parse::<f64>().is_ok() && y.parse::<f64>().is_ok() && id.parse::<i64>().is_ok(),
            _ => false,
        })
}

/// Reads numbers from the front of a binary file.
struct Reader<'a> {
    file: &'a str,
    rest: &'a [u8],
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let (head, rest) =
            self.rest.split_first_chunk::<N>().ok_or_else(|| Error::format(self.file, "ends too early"))?;
        self.rest = rest;
        Ok(*head)
    }
    fn u32(&mut self) -> Result<u32, Error> {
        self.take().map(u32::from_le_bytes)
    }
    fn u64(&mut self) -> Result<u64, Error> {
        self.take().map(u64::from_le_bytes)
    }
    fn f64(&mut self) -> Result<f64, Error> {
        self.take().map(f64::from_le_bytes)
    }
    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], Error> {
        let mut out = [0.0; N];
        for slot in &mut out {
            *slot = self.f64()?;
        }
        Ok(out)
    }
    fn name(&mut self) -> Result<String, Error> {
        let end = self
            .rest
            .iter()
            .position(|b| *b == 0)
            .ok_or_else(|| Error::format(self.file, "ends too early"))?;
        let name = String::from_utf8_lossy(&self.rest[..end]).into_owned();
        self.rest = &self.rest[end + 1..];
        Ok(name)
    }
    fn skip(&mut self, count: u64, size: u64) -> Result<(), Error> {
        let bytes = count.checked_mul(size).filter(|n| *n <= self.rest.len() as u64);
        let bytes = bytes.ok_or_else(|| Error::format(self.file, "ends too early"))?;
        self.rest = &self.rest[bytes as usize..];
        Ok(())
    }
    fn end(&self) -> Result<(), Error> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(Error::format(self.file, "has extra bytes at its end"))
        }
    }
}

/// Reads `cameras.bin` and `images.bin`.
pub fn binary(file: &str, cameras: &[u8], images: &[u8]) -> Result<Vec<Raw>, Error> {
    let mut from = Reader { file, rest: cameras };
    let mut lenses = BTreeMap::new();
    for _ in 0..from.u64()? {
        let (id, model) = (from.u32()?, from.u32()? as usize);
        let (width, height) = (from.u64()?, from.u64()?);
        let (name, count) = MODELS.get(model).ok_or_else(|| {
            let what = format!("camera {id} uses camera model number {model}, which is unknown");
            Error::unsupported(file, what)
        })?;
        let params = (0..*count).map(|_| from.f64()).collect::<Result<Vec<_>, _>>()?;
        let lens = lens(name, width, height, &params)
            .map_err(|what| Error::unsupported(file, format!("camera {id} {what}")))?;
        lenses.insert(u64::from(id), lens);
    }
    from.end()?;
    let mut from = Reader { file, rest: images };
    let mut found = Vec::new();
    for _ in 0..from.u64()? {
        from.u32()?;
        let (q, t) = (from.f64s()?, from.f64s()?);
        let id = from.u32()?;
        let name = from.name()?;
        let points = from.u64()?;
        from.skip(points, 24)?;
        found.push(camera(file, &lenses, id.into(), name, q, t)?);
    }
    from.end()?;
    Ok(sorted(found))
}
