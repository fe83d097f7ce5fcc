//! Parallel reading of the rows of all formats.

use engine::{Context, NodeError};

use super::frame::Turn;
use super::rows::{Row, RowFault};

/// Number of rows per job.
const CHUNK: usize = 16_384;

/// A part of a scene: the rows of one job.
#[derive(Default)]
pub struct RowChunk {
    /// The rows that were not dropped.
    pub rows: Vec<Row>,
    /// Colours of the rows. Each row has as many RGB triples as the degree of the file requires.
    pub sh: Vec<[f32; 3]>,
    /// Number of dropped rows, by reason.
    pub dropped: [u64; RowFault::ALL.len()],
    /// Index in the file of the first dropped row, and its reason.
    pub first_fault: Option<(usize, RowFault)>,
    /// True if f32 cannot hold a centre exactly.
    pub finer: bool,
    /// True if only the first triple of each colour was kept, which is the mean over all directions.
    pub plain: bool,
}

/// True if no value is NaN or infinite. Compares the bits of the largest magnitude, which can be vectorised,
/// whereas a search cannot.
fn all_finite(values: &[f32]) -> bool {
    values.iter().fold(0, |most, value| (value.to_bits() & 0x7fff_ffff).max(most)) < 0x7f80_0000
}

/// Reads `count` rows in parallel with `read(index, sh)`, which returns a row and appends its colour to `sh`. If it
/// returns an error, it may have appended a part of the colour. `first` is the index of the first row in the file.
/// If `plain` is true, only the first triple of each colour is kept.
pub fn read_rows(
    first: usize,
    count: usize,
    turn: Option<&Turn>,
    (plain, cx): (bool, &Context),
    read: impl Fn(usize, &mut Vec<[f32; 3]>) -> Result<Row, RowFault> + Send + Sync,
) -> Result<Vec<RowChunk>, NodeError> {
    cx.for_each_tile(count.div_ceil(CHUNK), |chunk| {
        let rows = chunk * CHUNK..((chunk + 1) * CHUNK).min(count);
        let mut part = RowChunk { rows: Vec::with_capacity(rows.len()), plain, ..RowChunk::default() };
        let count = rows.len();
        for index in rows {
            let start = part.sh.len();
            if part.rows.len() == 1 && part.sh.capacity() < start * count {
                // The first row determines the size of the colour of each row.
                part.sh.reserve_exact(start * count - start);
            }
            let row = read(index, &mut part.sh).and_then(|mut row| {
                let own = part.sh.get_mut(start..).unwrap_or_default();
                if let Some(turn) = turn {
                    turn.apply(&mut row, own);
                }
                let finite =
                    all_finite(own.as_flattened()) && all_finite(&row.mean) && all_finite(&row.scale);
                if finite { Ok(row) } else { Err(RowFault::NotFinite) }
            });
            match row {
                Ok(row) => {
                    if plain {
                        part.sh.truncate(start + 1);
                    }
                    part.finer |= row.mean_low != [0.0; 3];
                    part.rows.push(row);
                }
                Err(fault) => {
                    part.sh.truncate(start);
                    part.dropped[fault as usize] += 1;
                    part.first_fault.get_or_insert((first + index, fault));
                }
            }
        }
        part
    })
}
