//! Placement of a partial panorama on the sphere, as cameras and stitching programs store it: the Photo Sphere XMP
//! metadata of Google (namespace `http://ns.google.com/photos/1.0/panorama/`), which Hugin, PTGui and phones use.
//! The metadata is searched as text, since a few properties do not justify an XML parser.

use crate::error::Error;

/// Number of bytes at the start of a file that are searched. Metadata is stored before the picture.
pub const HEAD: usize = 1 << 20;

/// Maximum length of the metadata in bytes, which is the maximum length of the JPEG segment that contains it.
const PACKET: usize = 1 << 16;

/// Maximum number of pixels of a whole sphere.
const MOST: u64 = 1 << 28;

/// The part of a sphere that a picture shows, in pixels. The metadata may have been written for a larger version of
/// the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct GPano {
    /// Width and height of the whole sphere.
    full: [f64; 2],
    /// Width and height of the part.
    part: [f64; 2],
    /// Position of the upper left corner of the part in the whole sphere.
    at: [f64; 2],
    /// Elevation of the centre of the part above the horizon, and the roll of the part, in degrees.
    pub tilt: [f64; 2],
    /// Projection of the picture according to the metadata; `equirectangular` if they do not state one.
    pub projection: String,
}

/// Position of a picture in a whole sphere, in pixels of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Placement {
    /// Width and height of the whole sphere.
    pub size: [usize; 2],
    /// Upper left corner of the picture.
    pub at: [usize; 2],
}

impl GPano {
    /// The metadata in the head of a file; `None` if the file has no such metadata.
    pub fn find(bytes: &[u8]) -> Option<Self> {
        let head = &bytes[..bytes.len().min(HEAD)];
        let begin = head.windows(6).position(|w| w == b"GPano:")?;
        let text = String::from_utf8_lossy(&head[begin..head.len().min(begin + PACKET)]);
        let number = |name: &str| value(&text, name)?.parse::<f64>().ok().filter(|v| v.is_finite());
        let pair = |a: &str, b: &str| Some([number(a)?, number(b)?]);
        Some(Self {
            full: pair("FullPanoWidthPixels", "FullPanoHeightPixels")?,
            part: pair("CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels")?,
            at: pair("CroppedAreaLeftPixels", "CroppedAreaTopPixels")?,
            tilt: ["PosePitchDegrees", "PoseRollDegrees"].map(|name| number(name).unwrap_or(0.0)),
            projection: value(&text, "ProjectionType").unwrap_or("equirectangular").to_owned(),
        })
    }

    /// The number of pixels of the picture as a fraction of those of the whole sphere, above 0 and at most 1.
    pub fn share(&self) -> f64 {
        let share = self.part[0] * self.part[1] / (self.full[0] * self.full[1]);
        if share > 0.0 { share.min(1.0) } else { 1.0 }
    }

    /// The position of a picture of this size in the whole sphere; `None` if the picture is the whole sphere.
    ///
    /// # Errors
    /// If the metadata is impossible for this picture.
    pub fn place(&self, file: &str, [width, height]: [usize; 2]) -> Result<Option<Placement>, Error> {
        let numbers = [width, height].map(|pixels| pixels as f64);
        // The picture may have been scaled since.
        let scale = [numbers[0] / self.part[0], numbers[1] / self.part[1]];
        let size = [0, 1].map(|k| (self.full[k] * scale[k]).round());
        let at = [0, 1].map(|k| (self.at[k] * scale[k]).round());
        let even = (scale[0] / scale[1] - 1.0).abs() < 0.02;
        // Horizontally, a part may extend across the edge of the whole.
        let fits = (0..2).all(|k| size[k] >= numbers[k] && at[k] >= 0.0 && at[k] < size[k])
            && at[1] + numbers[1] <= size[1];
        if !(even && fits) {
            let [[fw, fh], [pw, ph], [x, y]] = [self.full, self.part, self.at];
            let what = format!(
                "the metadata of the picture (GPano) describes a crop of {pw}x{ph} pixels at {x}, {y} of a panorama of {fw}x{fh} pixels, which is not possible for a picture of {width}x{height} pixels; remove the metadata (`exiftool -XMP-GPano:all= FILE`) and pad the picture to 2:1"
            );
            return Err(Error::format(file, what));
        }
        let size = size.map(|pixels| pixels as usize);
        if size == [width, height] {
            return Ok(None);
        }
        if (size[0] as u64).saturating_mul(size[1] as u64) > MOST {
            let what = format!(
                "the picture is a crop of a panorama of {}x{} pixels, which is too large; scale it down",
                size[0], size[1]
            );
            return Err(Error::unsupported(file, what));
        }
        Ok(Some(Placement { size, at: at.map(|pixels| pixels as usize) }))
    }
}

/// The value of a property, which may be stored as an XML attribute or as an element.
fn value<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let name = format!("GPano:{name}");
    text.match_indices(&name).find_map(|(at, _)| {
        let rest = text[at + name.len()..].trim_start();
        let (rest, end) = match rest.strip_prefix('=') {
            Some(rest) => {
                let rest = rest.trim_start();
                let quote = rest.chars().next().filter(|c| matches!(c, '"' | '\''))?;
                (&rest[1..], quote)
            }
            None => (rest.strip_prefix('>')?, '<'),
        };
        Some(rest[..rest.find(end)?].trim())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(numbers: [&str; 6]) -> Vec<u8> {
        let names = [
            "FullPanoWidthPixels",
            "FullPanoHeightPixels",
            "CroppedAreaImageWidthPixels",
            "CroppedAreaImageHeightPixels",
            "CroppedAreaLeftPixels",
            "CroppedAreaTopPixels",
        ];
        let mut bytes = vec![0xff, 0xd8, 0xff, 0xe1, 0, 0];
        // Some as attributes and some as elements.
        let (front, back) = numbers.split_at(3);
        let attributes: String =
            names.iter().zip(front).map(|(name, v)| format!(" GPano:{name}=\"{v}\"")).collect();
        let elements: String = names[3..]
            .iter()
            .zip(back)
            .map(|(name, v)| format!("<GPano:{name}>{v}</GPano:{name}>"))
            .collect();
        bytes.extend(format!("<rdf:Description{attributes}>{elements}</rdf:Description>").into_bytes());
        bytes.extend([0xff, 0xda, 0, 9]);
        bytes
    }

    fn place(numbers: [&str; 6], size: [usize; 2]) -> Result<Option<Placement>, String> {
        let found = GPano::find(&packet(numbers)).expect("metadata");
        found.place("a", size).map_err(|error| error.to_string())
    }

    #[test]
    fn parts_are_laid_where_they_belong_and_nonsense_is_refused() {
        let half = ["256", "128", "128", "64", "64", "32"];
        assert_eq!(place(half, [128, 64]), Ok(Some(Placement { size: [256, 128], at: [64, 32] })));
        // Scaled down since it was written.
        assert_eq!(place(half, [32, 16]), Ok(Some(Placement { size: [64, 32], at: [16, 8] })));
        assert_eq!(place(["256", "128", "256", "128", "0", "0"], [256, 128]), Ok(None));
        // Over the edge.
        let over = ["256", "128", "128", "64", "200", "32"];
        assert_eq!(place(over, [128, 64]), Ok(Some(Placement { size: [256, 128], at: [200, 32] })));
        for wrong in [
            ["100", "50", "128", "64", "0", "0"],
            ["256", "128", "128", "64", "-4", "0"],
            ["256", "128", "128", "64", "0", "100"],
            ["256", "128", "0", "64", "0", "0"],
            ["1e9", "1e9", "128", "64", "0", "0"],
        ] {
            let reported = place(wrong, [128, 64]).expect_err("is refused");
            assert!(reported.contains("crop"), "{reported}");
        }
        assert!(place(half, [128, 128]).is_err());
        assert_eq!(GPano::find(b"GPano:FullPanoWidthPixels=\"no\""), None);
        assert_eq!(GPano::find(b""), None);
    }
}
