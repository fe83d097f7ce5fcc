//! `join-reports`: joins the tables of many reports.

use std::sync::Arc;

use engine::{Context, ContextField, Kind, NodeError, Notes};
use scene::types::{Cell, Report, Table};

engine::params! {
    /// Concatenates the tables of many reports. If the reports come from a `Gather`, each row starts with the
    /// values of the axes of the `Gather`.
    ///
    /// Tables with the same name must have the same columns.
    pub struct JoinReports {}
}
engine::inputs! {
    /// Reports to join.
    pub struct In {
        /// The reports, in order.
        reports: Vec<Arc<Report>>,
    }
}
engine::outputs! {
    /// The joined report.
    pub struct Out {
        /// One table per table name, with a leading column per axis.
        report: Arc<Report>,
    }
}

impl Kind for JoinReports {
    const NAME: &'static str = "join-reports";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Points];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(_params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let points = cx.points("reports");
        let mut axes: Vec<&str> = Vec::new();
        for (name, _) in points.iter().flatten() {
            if !axes.contains(&name.as_str()) {
                axes.push(name);
            }
        }
        let mut joined: Vec<Table> = Vec::new();
        for (index, report) in inputs.reports.iter().enumerate() {
            cx.check()?;
            let point = points.get(index).map_or(&[][..], Vec::as_slice);
            let place = |axis: &&str| {
                let value = point.iter().find(|(name, _)| name == axis).map(|(_, value)| value);
                value.map_or(Cell::Missing, |value| cell(value))
            };
            let places: Vec<Cell> = axes.iter().map(place).collect();
            for table in &report.tables {
                let columns =
                    || axes.iter().map(|axis| (*axis).to_owned()).chain(table.columns.iter().cloned());
                let rows = table.rows.iter().map(|row| places.iter().chain(row).cloned().collect());
                match joined.iter_mut().find(|known| known.name == table.name) {
                    None => joined.push(Table {
                        name: table.name.clone(),
                        columns: columns().collect(),
                        rows: rows.collect(),
                    }),
                    Some(known) if known.columns.iter().cloned().eq(columns()) => known.rows.extend(rows),
                    Some(_) => {
                        let text = format!(
                            "the columns of the table `{}` in report {index} differ from its columns in earlier reports",
                            table.name
                        );
                        return Err(NodeError::new(text).at("reports"));
                    }
                }
            }
        }
        let title = inputs.reports.first().map(|report| report.title.clone()).unwrap_or_default();
        Ok((Out { report: Arc::new(Report { title, tables: joined }) }, Notes::none()))
    }
}

/// Cell with the value of an axis: a number if the text is a number, and the text otherwise.
fn cell(value: &str) -> Cell {
    match (value.parse::<u64>(), value.parse::<f64>()) {
        (Ok(count), _) => Cell::Count(count),
        (_, Ok(number)) if number.is_finite() => Cell::Number(number),
        _ => Cell::Text(value.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(columns: &[&str], value: f64) -> Arc<Report> {
        let columns: Vec<String> = columns.iter().map(|&name| name.to_owned()).collect();
        let rows = vec![columns.iter().map(|_| Cell::Number(value)).collect()];
        Arc::new(Report { title: "t".into(), tables: vec![Table { name: "a".into(), columns, rows }] })
    }

    fn join(reports: Vec<Arc<Report>>) -> Result<Report, String> {
        let cx = testing::context();
        let joined = JoinReports::run(&JoinReports {}, In { reports }, &cx).map_err(|e| e.to_string())?;
        Ok((*joined.0.report).clone())
    }

    #[test]
    fn rows_stand_below_each_other_in_order() {
        let joined = join(vec![report(&["x"], 1.0), report(&["x"], 2.0)]).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(joined.tables[0].rows, [[Cell::Number(1.0)], [Cell::Number(2.0)]]);
        assert!(
            join(vec![report(&["x"], 1.0), report(&["y"], 2.0)])
                .is_err_and(|e| e.contains("differ from its columns"))
        );
        assert_eq!(join(vec![]).map(|joined| joined.tables.len()), Ok(0));
    }

    #[test]
    fn values_of_axes_are_numbers_where_they_can_be() {
        assert_eq!(
            [cell("3"), cell("15.0"), cell("a.hdr"), cell("NaN")],
            [Cell::Count(3), Cell::Number(15.0), Cell::Text("a.hdr".into()), Cell::Text("NaN".into())]
        );
    }
}
