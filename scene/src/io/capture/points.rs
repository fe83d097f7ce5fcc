//! Points of a COLMAP model: the file `points3D`, as text or binary.

use crate::error::Error;
use crate::types::Point;

/// Number of bytes of a point in a binary file, without its track: number, position, colour, error, and length of
/// the track.
const HEAD: usize = 8 + 24 + 3 + 8 + 8;
/// Number of bytes of an element of a track.
const ELEMENT: usize = 8;

fn point(position: [f64; 3], rgb: [u8; 3]) -> Point {
    Point { position: position.map(|v| v as f32), rgb: rgb.map(|code| f32::from(code) / 255.0) }
}

/// A point, and how well the photographs agree on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoredPoint {
    /// The point.
    pub point: Point,
    /// Mean distance, in pixels, between the projections of the point and its observations.
    pub error_px: f64,
    /// Number of observations.
    pub observations: u64,
}

/// Reads the points of a file. Points that are not finite are left out.
pub fn read(file: &str, bytes: &[u8]) -> Result<Vec<Point>, Error> {
    let points = if file.to_lowercase().ends_with(".txt") {
        text(file, bytes)?
    } else {
        binary(file, bytes)?.into_iter().map(|scored| scored.point).collect()
    };
    let finite = |point: &Point| point.position.iter().all(|v| v.is_finite());
    Ok(points.into_iter().filter(finite).collect())
}

fn text(file: &str, bytes: &[u8]) -> Result<Vec<Point>, Error> {
    let text = std::str::from_utf8(bytes).map_err(|_| Error::format(file, "is not UTF-8 text"))?;
    let mut points = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let words: Vec<&str> = line.split_ascii_whitespace().take(7).collect();
        let parsed = match words.as_slice() {
            [_, x, y, z, r, g, b] => (|| {
                let position = [x.parse().ok()?, y.parse().ok()?, z.parse().ok()?];
                Some(point(position, [r.parse().ok()?, g.parse().ok()?, b.parse().ok()?]))
            })(),
            _ => None,
        };
        let wrong = || Error::format(file, format!("line {} is not a point of COLMAP", number + 1));
        points.push(parsed.ok_or_else(wrong)?);
    }
    Ok(points)
}

/// Reads the points of a binary file with their errors, including points that are not finite.
pub fn binary(file: &str, bytes: &[u8]) -> Result<Vec<ScoredPoint>, Error> {
    let short = || Error::format(file, "ends too early");
    let (count, mut rest) = bytes.split_first_chunk::<8>().ok_or_else(short)?;
    let count = u64::from_le_bytes(*count);
    if count > (rest.len() / HEAD) as u64 {
        let what = format!("claims to hold {count} points, which is more than its size allows");
        return Err(Error::format(file, what));
    }
    let mut points = Vec::with_capacity(count as usize);
    for _ in 0..count {
        let (head, after) = rest.split_first_chunk::<HEAD>().ok_or_else(short)?;
        let number = |at: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&head[at..at + 8]);
            word
        };
        let position = [8, 16, 24].map(|at| f64::from_le_bytes(number(at)));
        let (error_px, observations) = (f64::from_le_bytes(number(35)), u64::from_le_bytes(number(43)));
        let point = point(position, [head[32], head[33], head[34]]);
        points.push(ScoredPoint { point, error_px, observations });
        let track = observations.checked_mul(ELEMENT as u64);
        let track = track.filter(|bytes| *bytes <= after.len() as u64).ok_or_else(short)?;
        rest = &after[track as usize..];
    }
    if rest.is_empty() { Ok(points) } else { Err(Error::format(file, "has extra bytes at its end")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_binary_give_the_same_points() {
        let text = "# a comment\n3 1.5 -2 0.25 255 0 51 0.7 1 2 3 4\n\n9 0 0 1 0 0 0 0.1\n";
        let mut bytes = 2_u64.to_le_bytes().to_vec();
        for (position, rgb, track) in [([1.5, -2.0, 0.25], [255, 0, 51], 2_u64), ([0.0, 0.0, 1.0], [0; 3], 0)]
        {
            bytes.extend(7_u64.to_le_bytes());
            position.iter().for_each(|v: &f64| bytes.extend(v.to_le_bytes()));
            bytes.extend(rgb);
            bytes.extend(0.7_f64.to_le_bytes());
            bytes.extend(track.to_le_bytes());
            bytes.extend(vec![0; track as usize * ELEMENT]);
        }
        let points = read("points3D.txt", text.as_bytes()).expect("is valid");
        assert_eq!(points[0], Point { position: [1.5, -2.0, 0.25], rgb: [1.0, 0.0, 0.2] });
        assert_eq!(read("points3D.bin", &bytes).expect("is valid"), points);
        let scored = binary("points3D.bin", &bytes).expect("is valid");
        assert_eq!((scored[0].error_px, scored[0].observations), (0.7, 2));
        for end in 0..bytes.len() {
            assert!(read("points3D.bin", &bytes[..end]).is_err());
        }
        let mut long = bytes.clone();
        long.push(0);
        let huge = [u64::MAX.to_le_bytes().to_vec(), vec![0; 200]].concat();
        assert!(read("a.bin", &long).is_err() && read("a.bin", &huge).is_err());
        for wrong in ["1 2 3", "1 x 0 0 0 0 0", "1 0 0 0 256 0 0"] {
            assert!(read("points3D.txt", wrong.as_bytes()).is_err());
        }
    }
}
