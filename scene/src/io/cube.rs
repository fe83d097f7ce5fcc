//! Lookup tables of colours in `.cube` files (Adobe, *Cube LUT specification 1.0*), with the input ranges and the
//! pair of a curve and a cube that DaVinci Resolve writes.

use crate::error::Error;

/// Maximum number of entries of a curve, and maximum number of entries along an edge of a cube.
const LARGEST_CURVE: usize = 65_536;
const LARGEST_CUBE: usize = 256;

/// A lookup table: a curve for each channel, a cube, or a curve and then a cube.
#[derive(Debug, Clone, PartialEq)]
pub struct CubeLut {
    curve: Option<Table>,
    cube: Option<Table>,
}

/// Entries at equal distances within a range of inputs.
#[derive(Debug, Clone, PartialEq)]
struct Table {
    /// Number of entries along each axis.
    size: usize,
    /// Inputs of the first and of the last entry, for each channel.
    low: [f64; 3],
    high: [f64; 3],
    /// `size` entries of a curve, or `size` cubed of a cube, in which red varies fastest.
    entries: Vec<[f32; 3]>,
}

impl CubeLut {
    /// Parses a file.
    ///
    /// # Errors
    /// If the text is not a complete table; the error names the line.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        let text = std::str::from_utf8(bytes)
            .map_err(|_| Error::format(file, "a `.cube` file is text, but this file is not UTF-8"))?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut header = Header::default();
        let mut rows: Vec<[f32; 3]> = Vec::new();
        for (number, line) in text.split(['\n', '\r']).enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let bad = |what: &str| Error::format(file, format!("line {}: {what}", number + 1));
            let Some(first) = line.split_whitespace().next() else { continue };
            if first.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
                && !matches!(first.to_ascii_lowercase().as_str(), "nan" | "inf" | "infinity")
            {
                if !rows.is_empty() {
                    return Err(bad(&format!("the keyword `{first}` must come before the table entries")));
                }
                header.keyword(first, line).map_err(|what| bad(&what))?;
                continue;
            }
            let numbers = numbers(line).ok_or_else(|| bad("a table entry needs finite numbers"))?;
            let [r, g, b] = numbers[..] else { return Err(bad("a table entry needs three numbers")) };
            rows.push([r as f32, g as f32, b as f32]);
            if rows.len() > LARGEST_CURVE + LARGEST_CUBE.pow(3) {
                return Err(bad("the table has more entries than the `.cube` format permits"));
            }
        }
        header.tables(rows).map_err(|what| Error::format(file, what))
    }

    /// The output for an input. Inputs outside the range of the table are clamped to it; NaN counts as the lower
    /// end. A cube is interpolated linearly within tetrahedra, which keeps greys grey.
    pub fn apply(&self, input: [f32; 3]) -> [f32; 3] {
        let curved = self.curve.as_ref().map_or(input, |curve| curve.along(input));
        self.cube.as_ref().map_or(curved, |cube| cube.inside(curved))
    }

    /// Writes a cube of `size` entries along each edge for inputs from 0 to 1, and its text. `colour` is the output
    /// for an input.
    pub fn write(title: &str, size: usize, colour: impl Fn([f32; 3]) -> [f32; 3]) -> String {
        let title: String = title.chars().filter(|c| !c.is_control() && *c != '"').collect();
        let mut text = format!("TITLE \"{title}\"\nLUT_3D_SIZE {size}\n");
        let at = |index: usize| index as f32 / (size - 1) as f32;
        for blue in 0..size {
            for green in 0..size {
                for red in 0..size {
                    let [r, g, b] = colour([at(red), at(green), at(blue)]);
                    text.push_str(&format!("{r:.7} {g:.7} {b:.7}\n"));
                }
            }
        }
        text
    }
}

impl Table {
    /// Position of a value among the entries, 0 to `size - 1`.
    fn position(&self, value: f32, channel: usize) -> f64 {
        let (low, high) = (self.low[channel], self.high[channel]);
        let part = (f64::from(value) - low) / (high - low);
        let part = if part.is_nan() { 0.0 } else { part.clamp(0.0, 1.0) };
        part * (self.size - 1) as f64
    }

    /// Each channel through its own curve.
    fn along(&self, input: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|channel| {
            let at = self.position(input[channel], channel);
            let first = (at as usize).min(self.size - 2);
            let [a, b] = [first, first + 1].map(|i| f64::from(self.entries[i][channel]));
            (a + (b - a) * (at - first as f64)) as f32
        })
    }

    /// The colour at a point of the cube.
    fn inside(&self, input: [f32; 3]) -> [f32; 3] {
        let at: [f64; 3] = std::array::from_fn(|channel| self.position(input[channel], channel));
        let first = at.map(|at| (at as usize).min(self.size - 2));
        let part: [f64; 3] = std::array::from_fn(|i| at[i] - first[i] as f64);
        let stride = [1, self.size, self.size * self.size];
        let mut index = first[0] + first[1] * stride[1] + first[2] * stride[2];
        // From the lower corner to the upper one along the axes in the order of decreasing parts: the corners of
        // the tetrahedron that holds the point.
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| part[*b].total_cmp(&part[*a]));
        let mut sum = self.entries[index].map(|v| f64::from(v) * (1.0 - part[order[0]]));
        for (step, axis) in order.into_iter().enumerate() {
            index += stride[axis];
            let weight = part[axis] - order.get(step + 1).map_or(0.0, |next| part[*next]);
            for (sum, v) in sum.iter_mut().zip(self.entries[index]) {
                *sum += f64::from(v) * weight;
            }
        }
        sum.map(|v| v as f32)
    }
}

/// Keywords of a file.
#[derive(Default)]
struct Header {
    curve: Option<usize>,
    cube: Option<usize>,
    low: Option<[f64; 3]>,
    high: Option<[f64; 3]>,
    curve_range: Option<[f64; 2]>,
    cube_range: Option<[f64; 2]>,
}

impl Header {
    fn keyword(&mut self, word: &str, line: &str) -> Result<(), String> {
        let rest = line[word.len()..].trim();
        let of = |count: usize| {
            numbers(rest)
                .filter(|numbers| numbers.len() == count)
                .ok_or_else(|| format!("`{word}` needs {count} finite numbers"))
        };
        let size = |largest: usize| {
            let size = rest.parse::<usize>().ok().filter(|size| (2..=largest).contains(size));
            size.map(Some).ok_or_else(|| format!("`{word}` needs a number from 2 to {largest}"))
        };
        match word {
            "TITLE" => {}
            "LUT_1D_SIZE" => self.curve = size(LARGEST_CURVE)?,
            "LUT_3D_SIZE" => self.cube = size(LARGEST_CUBE)?,
            "DOMAIN_MIN" => self.low = of(3)?.try_into().ok(),
            "DOMAIN_MAX" => self.high = of(3)?.try_into().ok(),
            "LUT_1D_INPUT_RANGE" => self.curve_range = of(2)?.try_into().ok(),
            "LUT_3D_INPUT_RANGE" => self.cube_range = of(2)?.try_into().ok(),
            _ => return Err(format!("the keyword `{word}` is unknown")),
        }
        Ok(())
    }

    fn tables(self, mut rows: Vec<[f32; 3]>) -> Result<CubeLut, String> {
        let wanted = self.curve.unwrap_or(0) + self.cube.map_or(0, |size| size.pow(3));
        if wanted == 0 {
            return Err("the file has neither `LUT_1D_SIZE` nor `LUT_3D_SIZE`".to_owned());
        }
        if rows.len() != wanted {
            return Err(format!("the table needs {wanted} entries, but has {}", rows.len()));
        }
        let rest = rows.split_off(self.curve.unwrap_or(0));
        let table = |size, range: Option<[f64; 2]>, entries| {
            let low = range.map_or(self.low.unwrap_or([0.0; 3]), |[low, _]| [low; 3]);
            let high = range.map_or(self.high.unwrap_or([1.0; 3]), |[_, high]| [high; 3]);
            if low.iter().zip(high).any(|(low, high)| *low >= high) {
                return Err("the lower end of the input range is not below its upper end".to_owned());
            }
            Ok(Table { size, low, high, entries })
        };
        Ok(CubeLut {
            curve: self.curve.map(|size| table(size, self.curve_range, rows)).transpose()?,
            cube: self.cube.map(|size| table(size, self.cube_range, rest)).transpose()?,
        })
    }
}

/// The numbers of a line; `None` if one is not a finite number.
fn numbers(line: &str) -> Option<Vec<f64>> {
    line.split_whitespace().map(|word| word.parse().ok().filter(|v: &f64| v.is_finite())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<CubeLut, String> {
        CubeLut::read("a.cube", text.as_bytes()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_written_cube_is_read_and_interpolated_exactly_where_it_is_linear() {
        let matrix = |[r, g, b]: [f32; 3]| [0.5 * r + 0.25 * g, 0.75 * g + 0.125 * b, 1.0 - b];
        let lut = read(&CubeLut::write("a \"look\"", 5, matrix)).unwrap_or_else(|e| panic!("{e}"));
        for i in 0..200_u32 {
            let part = |k: u32| ((i * k) % 101) as f32 / 100.0;
            let input = [part(7), part(31), part(57)];
            for (a, b) in lut.apply(input).iter().zip(matrix(input)) {
                assert!((a - b).abs() < 3e-7, "{input:?}");
            }
        }
        // Inputs outside the range, and NaN.
        assert_eq!(lut.apply([-1.0, f32::NAN, 9.0]), lut.apply([0.0, 0.0, 1.0]));
    }

    /// Greys stay grey in a cube that keeps its diagonal, whatever its other entries are.
    #[test]
    fn greys_are_interpolated_along_the_diagonal() {
        let odd = |[r, g, b]: [f32; 3]| if r == g && g == b { [r * r; 3] } else { [0.9, 0.1, 0.4] };
        let lut = read(&CubeLut::write("", 9, odd)).unwrap_or_else(|e| panic!("{e}"));
        for i in 0..=64 {
            let [r, g, b] = lut.apply([i as f32 / 64.0; 3]);
            assert!(r == g && g == b, "{i}");
        }
    }

    #[test]
    fn curves_ranges_comments_and_line_ends_are_read() {
        let text = "\u{feff}# made by hand\r\nTITLE \"x\"\r\nLUT_1D_SIZE 3\r\nDOMAIN_MIN -1 0 0\r\nDOMAIN_MAX 1 2 4\r\n\r\n\
                    0 0 0\r\n0.25 1 0.5 # middle\r\n1 2 1\r\n";
        let lut = read(text).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(lut.apply([0.0, 1.0, 1.0]), [0.25, 1.0, 0.25]);
        assert_eq!(lut.apply([0.5, 1.5, 3.0]), [0.625, 1.5, 0.75]);
        // A curve and a cube, as DaVinci Resolve writes them.
        let both = "LUT_1D_SIZE 2\nLUT_1D_INPUT_RANGE 0 2\nLUT_3D_SIZE 2\nLUT_3D_INPUT_RANGE 0.0 1.0\n0 0 0\n1 1 1\n\
                    0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 0 1\n1 0 1\n0 1 1\n1 1 1\n";
        let lut = read(both).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(lut.apply([2.0, 1.0, 0.5]), [1.0, 0.5, 0.25]);
    }

    #[test]
    fn broken_files_are_refused_by_line() {
        for (text, wanted) in [
            ("", "neither `LUT_1D_SIZE` nor `LUT_3D_SIZE`"),
            ("LUT_3D_SIZE 2\n0 0 0\n", "needs 8 entries, but has 1"),
            ("LUT_1D_SIZE 2\n0 0 0\n1 1\n", "line 3: a table entry needs three numbers"),
            ("LUT_1D_SIZE 2\n0 0 nan\n1 1 1\n", "line 2: a table entry needs finite numbers"),
            ("LUT_1D_SIZE 1\n0 0 0\n", "line 1: `LUT_1D_SIZE` needs a number from 2 to 65536"),
            ("LUT_3D_SIZE 9999\n", "line 1: `LUT_3D_SIZE` needs a number from 2 to 256"),
            ("LUT_1D_SIZE 2\nDOMAIN_MIN 1 1 1\n0 0 0\n1 1 1\n", "not below its upper end"),
            ("LUT_1D_SIZE 2\n0 0 0\nTITLE \"late\"\n1 1 1\n", "line 3: the keyword `TITLE` must come before"),
            ("LUT_1D_SIZE 2\nGAMMA 2\n", "line 2: the keyword `GAMMA` is unknown"),
        ] {
            let error = read(text).expect_err(text);
            assert!(error.contains(wanted), "{error}");
        }
        assert!(CubeLut::read("a.cube", &[0xff, 0xfe, 0x00]).is_err());
    }
}
