//! Reports: typed tables of results.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};
use serde::Serialize;

/// A value of a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Cell {
    /// Text.
    Text(String),
    /// A whole number, such as a count.
    Count(u64),
    /// A finite measurement. The heading of the column gives its meaning and unit.
    Number(f64),
    /// A value that was not computed. It is never printed as 0.
    Missing,
}

/// A table with headings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Table {
    /// Stable name in kebab-case: `emitters`.
    pub name: String,
    /// Heading of each column, with its unit: `solid angle (sr)`.
    pub columns: Vec<String>,
    /// Rows, each with one cell per column.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// A table with this name and these columns.
    pub fn new(
        name: &str,
        columns: impl IntoIterator<Item = impl Into<String>>,
        rows: Vec<Vec<Cell>>,
    ) -> Self {
        Self { name: name.to_owned(), columns: columns.into_iter().map(Into::into).collect(), rows }
    }
}

/// Results of a node, as tables. Port type `report`.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Report {
    /// Title in one line.
    pub title: String,
    /// The tables, in order.
    pub tables: Vec<Table>,
}

impl Artifact for Report {
    const TYPE: &'static str = "report";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.str(&self.title);
        to.u64(self.tables.len() as u64);
        for table in &self.tables {
            to.str(&table.name);
            to.u64(table.columns.len() as u64);
            table.columns.iter().for_each(|column| to.str(column));
            to.u64(table.rows.len() as u64);
            for cell in table.rows.iter().flatten() {
                match cell {
                    Cell::Missing => to.u8(0),
                    Cell::Text(text) => {
                        to.u8(1);
                        to.str(text);
                    }
                    Cell::Count(n) => {
                        to.u8(2);
                        to.u64(*n);
                    }
                    Cell::Number(x) => {
                        to.u8(3);
                        to.f64(*x);
                    }
                }
            }
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let title = from.str()?;
        let mut tables = Vec::new();
        for _ in 0..from.length(24)? {
            let name = from.str()?;
            let width = from.length(8)?;
            let columns = (0..width).map(|_| from.str()).collect::<Result<Vec<_>, _>>()?;
            let height = from.length(width.max(1))?;
            let cell = |from: &mut Decoder<'_>| {
                Ok(match from.u8()? {
                    0 => Cell::Missing,
                    1 => Cell::Text(from.str()?),
                    2 => Cell::Count(from.u64()?),
                    3 => Cell::Number(from.f64()?),
                    other => return Err(Corrupt(format!("a cell has the unknown type {other}"))),
                })
            };
            let rows = (0..height)
                .map(|_| (0..width).map(|_| cell(from)).collect::<Result<Vec<_>, _>>())
                .collect::<Result<Vec<_>, _>>()?;
            tables.push(Table { name, columns, rows });
        }
        Ok(Self { title, tables })
    }

    fn bytes(&self) -> usize {
        self.tables.iter().map(|table| 64 + table.columns.len() * 32 * (1 + table.rows.len())).sum()
    }

    fn difference(&self, other: &Self) -> Difference {
        for (a, b) in self.tables.iter().zip(&other.tables) {
            for (row, (x, y)) in a.rows.iter().zip(&b.rows).enumerate() {
                if x != y {
                    return Difference::of(format!("row {row} of the table `{}` differs", a.name));
                }
            }
        }
        if self == other { Difference::none() } else { Difference::of("the titles or the tables differ") }
    }
}
