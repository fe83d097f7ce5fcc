//! `.ksplat` (mkkellogg/GaussianSplats3D, `SplatBuffer.js`): a header of 4096 bytes, 1024 bytes per section, then
//! the sections, each with its buckets and rows. Level 0 stores 32-bit floats. Levels 1 and 2 store centres as
//! 16-bit offsets from the centre of their bucket and other fields as 16-bit floats, except that level 2 stores
//! harmonics as bytes.

use engine::{NodeError, Notes};

use super::bytes::{f16_at, f32_at, range, u8_at, u16_at, u32_at};
use super::loaded::Loaded;
use super::parts::RowChunk;
use super::reading::Reading;
use super::rows::{Row, RowFault, SH_C0, sh_rest};
use crate::error::Error;

const HEADER: usize = 4096;
const SECTION_HEADER: usize = 1024;
/// Size in bytes of the smallest row.
pub(super) const LEAST_ROW: u64 = 24;
/// Harmonics that are stored as bytes range from minus this value to this value if the file does not define a range
/// (`Constants.js`).
const HALF_RANGE: f64 = 1.5;

/// Layout of a row at a level of compression.
struct RowLayout {
    real: usize,
    harmonic: usize,
    scale: usize,
    rotation: usize,
    colour: usize,
    harmonics: usize,
    /// Number of steps from the centre of a bucket to its side, for sections that do not define this number.
    steps: u32,
}

const LEVELS: [RowLayout; 3] = [
    RowLayout { real: 4, harmonic: 4, scale: 12, rotation: 24, colour: 40, harmonics: 44, steps: 1 },
    RowLayout { real: 2, harmonic: 2, scale: 6, rotation: 12, colour: 20, harmonics: 24, steps: 32_767 },
    RowLayout { real: 2, harmonic: 1, scale: 6, rotation: 12, colour: 20, harmonics: 24, steps: 32_767 },
];

/// True if the bytes begin like a `.ksplat` file, even a truncated one: the version is at least 0.1, the level is
/// known, there is at least one section, and the numbers of sections and splats in use do not exceed the maximum
/// numbers (some writers omit the maximum number of splats).
pub(super) fn is_ksplat(bytes: &[u8]) -> bool {
    let [sections, used_sections, room, used] = [4, 8, 12, 16].map(|at| u32_at(bytes, at));
    bytes.len() >= 22
        && u8_at(bytes, 0) == 0
        && u8_at(bytes, 1) >= 1
        && u16_at(bytes, 2) == 0
        && u16_at(bytes, 20) <= 2
        && sections >= 1
        && used_sections <= sections
        && (room == 0 || used <= room)
}

/// A section: its rows, and the centres of its buckets. The position of a row is relative to the centre of its
/// bucket.
struct Section<'a> {
    count: usize,
    degree: u32,
    stride: usize,
    rows: &'a [u8],
    centres: &'a [u8],
    bucket_size: usize,
    full: usize,
    /// For each partially filled bucket, the index of the row after its last row.
    ends: Vec<usize>,
    steps: f64,
    step: f64,
}

impl<'a> Section<'a> {
    /// Reads the section whose header is `head`. Its data start at `at`, which is advanced to the end of the data.
    fn read(
        file: &str,
        bytes: &'a [u8],
        head: &[u8],
        level: &RowLayout,
        at: &mut usize,
    ) -> Result<Self, Error> {
        let (count, room) = (u32_at(head, 0) as usize, u32_at(head, 4) as usize);
        let (bucket_size, buckets) = (u32_at(head, 8) as usize, u32_at(head, 12) as usize);
        let (block, storage) = (f64::from(f32_at(head, 16)), u16_at(head, 20) as usize);
        let steps = match u32_at(head, 24) {
            0 => level.steps,
            steps => steps,
        };
        let (full, partial) = (u32_at(head, 32) as usize, u32_at(head, 36) as usize);
        let degree = u32::from(u16_at(head, 40));
        if degree > 3 {
            return Err(Error::format(
                file,
                format!("the degree of the spherical harmonics is {degree}, not 0 to 3"),
            ));
        }
        if count > room {
            return Err(Error::format(
                file,
                format!("a section has space for {room} splats but claims to hold {count}"),
            ));
        }
        if storage != 0 && storage < 12 {
            return Err(Error::format(
                file,
                format!("buckets of {storage} bytes are too small for a centre"),
            ));
        }
        let stride = level.harmonics + sh_rest(degree) * 3 * level.harmonic;
        let sizes = range(file, bytes, *at, partial.saturating_mul(4), "the sizes of buckets")?;
        *at += sizes.len();
        let centres = range(file, bytes, *at, buckets.saturating_mul(storage), "the centres of buckets")?;
        *at += centres.len();
        let rows = range(file, bytes, *at, room.saturating_mul(stride), "the splats of a section")?;
        *at += rows.len();
        let mut end = full.saturating_mul(bucket_size);
        let ends = sizes.as_chunks::<4>().0.iter().map(|size| {
            end = end.saturating_add(u32::from_le_bytes(*size) as usize);
            end
        });
        Ok(Self {
            count,
            degree,
            stride,
            rows,
            centres,
            bucket_size,
            full,
            ends: ends.collect(),
            steps: f64::from(steps),
            step: block / 2.0 / f64::from(steps),
        })
    }

    /// The centre of the bucket that row `index` belongs to.
    fn centre(&self, index: usize) -> Result<[f64; 3], RowFault> {
        let bucket = match index.checked_div(self.bucket_size) {
            Some(bucket) if bucket < self.full => bucket,
            _ => self.full + self.ends.partition_point(|end| *end <= index),
        };
        let centre = self.centres.get(bucket.saturating_mul(12)..).filter(|rest| rest.len() >= 12);
        let centre = centre.ok_or(RowFault::NoSuchEntry)?;
        Ok([0, 4, 8].map(|at| f64::from(f32_at(centre, at))))
    }
}

/// Loads a file.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let head = range(file, bytes, 0, HEADER, "the header")?;
    let (major, minor) = (u8_at(head, 0), u8_at(head, 1));
    if major != 0 || minor < 1 {
        return Err(Error::unsupported(file, format!("version {major}.{minor} of .ksplat")).into());
    }
    let (sections, promised) = (u32_at(head, 4) as usize, u32_at(head, 16) as usize);
    let Some(level) = LEVELS.get(u16_at(head, 20) as usize) else {
        return Err(Error::format(
            file,
            format!("the compression level is {}, not 0, 1 or 2", u16_at(head, 20)),
        )
        .into());
    };
    let limit = |at: usize, otherwise: f64| match f64::from(f32_at(head, at)) {
        0.0 => otherwise,
        reported => reported,
    };
    let (low, high) = (limit(36, -HALF_RANGE), limit(40, HALF_RANGE));
    let heads =
        range(file, bytes, HEADER, sections.saturating_mul(SECTION_HEADER), "the headers of sections")?;
    let mut at = HEADER + heads.len();
    let read = heads
        .as_chunks::<SECTION_HEADER>()
        .0
        .iter()
        .map(|head| Section::read(file, bytes, head, level, &mut at));
    let sections = read.collect::<Result<Vec<_>, _>>()?;
    super::loaded::left_over(file, bytes.len() - at, notes);
    let count: usize = sections.iter().map(|section| section.count).sum();
    if count != promised {
        let what = format!("the header promises {promised} splats, but the sections hold {count}");
        return Err(Error::format(file, what).into());
    }
    let degree = sections.iter().map(|section| section.degree).max().unwrap_or(0);
    let turn = reading.turn(file, None, false, notes);
    let mut parts: Vec<RowChunk> = Vec::new();
    let mut first = 0;
    for section in &sections {
        let (own, widest) = (sh_rest(section.degree), sh_rest(degree));
        parts.extend(reading.rows_from(first, section.count, turn.as_ref(), |index, sh| {
            let row = section.rows.get(index * section.stride..).unwrap_or_default();
            let real = |at: usize| match level.real {
                4 => f64::from(f32_at(row, at)),
                _ => f16_at(row, at),
            };
            let mean = if level.real == 4 {
                [0, 4, 8].map(real)
            } else {
                let centre = section.centre(index)?;
                [0, 1, 2].map(|i| (f64::from(u16_at(row, i * 2)) - section.steps) * section.step + centre[i])
            };
            let scale = [0, 1, 2].map(|i| real(level.scale + i * level.real));
            let quat = [0, 1, 2, 3].map(|i| real(level.rotation + i * level.real));
            let [r, g, b, opacity] = [0, 1, 2, 3].map(|i| f64::from(u8_at(row, level.colour + i)) / 255.0);
            sh.push([r, g, b].map(|c| ((c - 0.5) / SH_C0) as f32));
            // Band by band, within a band channel by channel.
            let start = sh.len();
            for l in 1..=section.degree as usize {
                let band = (l * l - 1) * 3;
                for i in 0..2 * l + 1 {
                    sh.push([0, 1, 2].map(|channel| {
                        let at = level.harmonics + (band + channel * (2 * l + 1) + i) * level.harmonic;
                        match level.harmonic {
                            1 => (low + f64::from(u8_at(row, at)) / 255.0 * (high - low)) as f32,
                            _ => real(at) as f32,
                        }
                    }));
                }
            }
            debug_assert_eq!(sh.len() - start, own);
            sh.extend(std::iter::repeat_n([0.0; 3], widest - own));
            Row::checked(mean, quat, scale, opacity, reading.max_extent)
        })?);
        first += section.count;
    }
    Ok(Loaded::new(parts, count, degree))
}
