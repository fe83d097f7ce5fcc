//! Self-contained HTML pages: tables, plots and pictures in one file.

use std::fmt::Write as _;

use base64::prelude::{BASE64_STANDARD, Engine as _};
use scene::io::png::{self, Raster};
use scene::math::color::srgb_from_linear;
use scene::types::{Cell, Picture, Report};

use crate::escape::escaped;

/// A page that is being built. Its parts appear in the order in which they were added.
#[derive(Default)]
pub struct Page {
    body: String,
}

const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#1f2328;--dim:#59636e;--paper:#fff;--line:#dfe3e8;--head:#f4f6f8;--on:#1668b8;\
--off:#b9c0c8;--bound:#c33}\
@media(prefers-color-scheme:dark){:root{--ink:#dfe3e8;--dim:#98a2ad;--paper:#15181c;--line:#30363d;--head:#1d2127;\
--on:#6cb2f5;--off:#565f69;--bound:#f07070}}\
body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:var(--ink);\
background:var(--paper)}\
h1{font-size:1.5em;overflow-wrap:anywhere}h2{font-size:1.15em;margin-top:2.2em;border-bottom:1px solid var(--line)}\
h3{font-size:1em;margin:1.4em 0 0}p{max-width:48em}\
.wide{overflow-x:auto}table{border-collapse:collapse;margin:.6em 0;font-variant-numeric:tabular-nums;font-size:.9em}\
th,td{padding:.25em .7em;border-bottom:1px solid var(--line);text-align:right;vertical-align:top}\
.t{text-align:left}td.t{min-width:6em}td:not(.t){white-space:nowrap}th{font-weight:600;background:var(--head)}\
.facts{display:flex;flex-wrap:wrap;gap:.6em;margin:1em 0;padding:0}\
.facts div{flex:1 1 8em;background:var(--head);border-radius:6px;padding:.5em .9em}\
.facts dt{font-size:.8em;color:var(--dim)}.facts dd{margin:0;font-size:1.25em;overflow-wrap:anywhere}\
.row{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(30%,240px),1fr));gap:.8em;margin:.8em 0}\
.row.plots{grid-template-columns:repeat(auto-fit,minmax(min(100%,460px),1fr))}.small{image-rendering:pixelated}\
figure{margin:0}figcaption{font-size:.85em;color:var(--dim)}img{width:100%;display:block;border-radius:3px}\
svg{max-width:100%;height:auto}.frame{fill:none;stroke:var(--off)}.grid{stroke:var(--line)}\
.tick{font-size:11px;fill:var(--dim)}.axis{font-size:12px;fill:var(--ink)}\
.front{fill:none;stroke:var(--on);stroke-width:1.5}.dot{fill:var(--off)}.dot.on{fill:var(--on)}\
.name{font-size:11px;fill:var(--ink)}.bound{stroke:var(--bound);stroke-dasharray:5 4}\
pre{background:var(--head);padding:.8em;overflow:auto}code,pre{font-size:.92em}";

impl Page {
    /// Adds a heading.
    pub fn heading(&mut self, text: &str) {
        // Writing to a string cannot fail, here and below.
        let _ = writeln!(self.body, "<h2>{}</h2>", escaped(text));
    }

    /// Adds a paragraph. Text between two backticks is formatted as code.
    pub fn words(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", marked(text));
    }

    /// Adds preformatted text, such as an overlay.
    pub fn code(&mut self, text: &str) {
        let _ = writeln!(self.body, "<pre>{}</pre>", escaped(text));
    }

    /// Adds a few values in large letters, each with its name.
    pub fn facts(&mut self, facts: &[(&str, String)]) {
        self.body.push_str("<dl class=\"facts\">");
        for (name, value) in facts {
            let _ = write!(self.body, "<div><dt>{}</dt><dd>{}</dd></div>", escaped(name), escaped(value));
        }
        self.body.push_str("</dl>\n");
    }

    /// Adds a table. Columns of text are aligned to the left, and columns of numbers to the right.
    pub fn table(&mut self, columns: &[&str], rows: &[Vec<String>]) {
        let class = |column: usize| {
            let mut cells = rows.iter().filter_map(|row| row.get(column)).filter(|cell| !cell.is_empty());
            if !rows.is_empty() && cells.all(|cell| is_number(cell)) { "" } else { " class=\"t\"" }
        };
        let classes: Vec<&str> = (0..columns.len()).map(class).collect();
        self.body.push_str("<div class=\"wide\"><table><tr>");
        for (column, class) in columns.iter().zip(&classes) {
            let _ = write!(self.body, "<th{class}>{}</th>", escaped(column));
        }
        self.body.push_str("</tr>\n");
        for row in rows {
            self.body.push_str("<tr>");
            for (cell, class) in row.iter().zip(&classes) {
                let _ = write!(self.body, "<td{class}>{}</td>", marked(cell));
            }
            self.body.push_str("</tr>\n");
        }
        self.body.push_str("</table></div>\n");
    }

    /// Adds the tables of a node's report.
    pub fn report(&mut self, name: &str, report: &Report) {
        for table in &report.tables {
            let _ = writeln!(self.body, "<h3>{}: {}</h3>", escaped(name), escaped(&table.name));
            let columns: Vec<&str> = table.columns.iter().map(String::as_str).collect();
            let rows: Vec<Vec<String>> =
                table.rows.iter().map(|row| row.iter().map(cell_text).collect()).collect();
            self.table(&columns, &rows);
        }
    }

    /// Adds pictures side by side, as many per row as fit. Pictures wider than `widest` pixels are reduced in size.
    pub fn pictures(&mut self, pictures: &[(&Picture, String)], widest: usize) {
        self.body.push_str("<div class=\"row\">\n");
        for (picture, caption) in pictures {
            let raster = if let Picture::Data(_) = picture { heat(picture) } else { shown(picture) };
            let Some(raster) = raster.map(|raster| halved(raster, widest)) else { continue };
            // A small picture is enlarged with visible pixels, since interpolation would blur it.
            let class = if raster.width < 240 { " class=\"small\"" } else { "" };
            let Ok(bytes) = png::write(&raster, true, &[]) else { continue };
            let _ = writeln!(
                self.body,
                "<figure><img{class} alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption></figure>",
                escaped(caption),
                BASE64_STANDARD.encode(&bytes)
            );
        }
        self.body.push_str("</div>\n");
    }

    /// Adds pictures in files side by side, each with its path relative to the page and its caption. The browser loads
    /// a picture when it is scrolled into view.
    pub fn linked(&mut self, pictures: &[(String, String)]) {
        self.body.push_str("<div class=\"row\">\n");
        for (path, caption) in pictures {
            let _ = writeln!(
                self.body,
                "<figure><img loading=\"lazy\" alt=\"{1}\" src=\"{0}\"><figcaption>{1}</figcaption></figure>",
                escaped(path),
                escaped(caption)
            );
        }
        self.body.push_str("</div>\n");
    }

    /// Adds plots side by side, as many per row as fit.
    pub fn plots(&mut self, plots: &[(&str, String)]) {
        self.body.push_str("<div class=\"row plots\">\n");
        for (name, svg) in plots {
            let _ = writeln!(self.body, "<figure><figcaption>{}</figcaption>{svg}</figure>", escaped(name));
        }
        self.body.push_str("</div>\n");
    }

    /// Returns the content of the HTML file.
    pub fn finish(self, title: &str) -> String {
        let title = escaped(title);
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width\"><title>{title}</title>\
             <style>{STYLE}</style></head>\n<body><h1>{title}</h1>\n{}</body></html>\n",
            self.body
        )
    }
}

/// Escapes text for HTML and formats text between two backticks as code.
fn marked(text: &str) -> String {
    let parts: Vec<&str> = text.split('`').collect();
    // A backtick without a second one is kept as it is.
    if parts.len().is_multiple_of(2) {
        return escaped(text);
    }
    let part = |(at, part): (usize, &&str)| match at % 2 {
        0 => escaped(part),
        _ => format!("<code>{}</code>", escaped(part)),
    };
    parts.iter().enumerate().map(part).collect()
}

/// True if a cell contains a number, such as `1.2 M` or `40 dB`, or a text that replaces a number, such as `not
/// computed`.
fn is_number(cell: &str) -> bool {
    let (first, rest) = cell.split_once(' ').unwrap_or((cell, ""));
    let unit = matches!(rest, "" | "k" | "M" | "G" | "%" | "dB");
    (unit && first.parse::<f64>().is_ok()) || matches!(cell, "not computed" | "not measured")
}

fn cell_text(cell: &Cell) -> String {
    match cell {
        Cell::Text(text) => text.clone(),
        Cell::Count(n) => n.to_string(),
        Cell::Number(value) => crate::plot::tick_text(*value),
        Cell::Missing => "not computed".to_owned(),
    }
}

fn raster(width: usize, height: usize, codes: Vec<u16>) -> Raster {
    Raster { width, height, channels: 3, largest: 255, codes, ignored: Vec::new(), colour: None }
}

fn code(value: f32) -> u16 {
    u16::from(scene::math::color::code8(value))
}

/// Converts a picture to 8-bit display values, over a black background.
fn shown(picture: &Picture) -> Option<Raster> {
    let (width, height, channels) = picture.size();
    let linear = matches!(picture, Picture::Linear(_));
    let value = |v: &f32| code(if linear { srgb_from_linear(*v) } else { *v });
    let pixels = picture.samples().chunks_exact(channels.max(1));
    (channels >= 3).then(|| {
        raster(width, height, pixels.flat_map(|p| p[..3].iter().map(value).collect::<Vec<_>>()).collect())
    })
}

/// Converts values to colours, from black at 0 through red and yellow to white at 1. Colours are chosen by the
/// square root of the value, so that small values are visible.
fn heat(picture: &Picture) -> Option<Raster> {
    let (width, height, channels) = picture.size();
    let pixels = picture.samples().chunks_exact(channels.max(1));
    let colour = |p: &[f32]| {
        let v = 3.0 * p[0].clamp(0.0, 1.0).sqrt();
        [code(v), code(v - 1.0), code(v - 2.0)]
    };
    (channels >= 1).then(|| raster(width, height, pixels.flat_map(colour).collect()))
}

/// Reduces a picture by averaging blocks of pixels, so that it is at most `widest` pixels wide.
fn halved(of: Raster, widest: usize) -> Raster {
    // A picture of little height stays wider, so that at least one row remains.
    let step = of.width.div_ceil(widest.max(1)).min(of.height).max(1);
    if step == 1 {
        return of;
    }
    let (width, height) = (of.width / step, of.height / step);
    let mut codes = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            for c in 0..3 {
                let mut sum = 0;
                for row in y * step..(y + 1) * step {
                    for column in x * step..(x + 1) * step {
                        sum += usize::from(of.codes[(row * of.width + column) * 3 + c]);
                    }
                }
                codes.push((sum / (step * step)) as u16);
            }
        }
    }
    raster(width, height, codes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;
    use scene::types::{Data, Image, Linear};

    #[test]
    fn a_page_needs_nothing_beside_it_and_quotes_what_users_named() {
        let mut page = Page::default();
        page.table(&["a<b", "n"], &[vec!["<script>".to_owned(), "1.5".to_owned()]]);
        let picture = Image::<Linear>::from_samples(5, 2, 3, vec![0.2; 30]).into();
        let map = Image::<Data>::from_samples(2, 1, 1, vec![0.0, 1.0]).into();
        page.pictures(&[(&picture, "p\"q".to_owned()), (&map, "map".to_owned())], 2);
        let text = page.finish("t");
        assert!(!text.contains("<script>") && text.contains("&lt;script&gt;") && !text.contains("http"));
        assert_eq!(text.matches("data:image/png;base64,").count(), 2);
    }

    #[test]
    fn columns_of_numbers_stand_on_the_right() {
        for cell in ["1.2 M", "-3", "0.5", "inf dB", "40 dB", "12 %", "not computed", "inf"] {
            assert!(is_number(cell), "{cell}");
        }
        for cell in ["64 nodes", "draft", "0 of 10", ""] {
            assert!(!is_number(cell), "{cell}");
        }
        let mut page = Page::default();
        page.table(&["what", "n"], &[vec!["64 nodes".to_owned(), "2".to_owned()]]);
        assert!(page.body.contains("<th class=\"t\">what</th><th>n</th>"), "{}", page.body);
        let texts = ["a `b<` c", "it`s", "`x`"].map(marked);
        assert_eq!(texts, ["a <code>b&lt;</code> c", "it`s", "<code>x</code>"]);
    }

    #[test]
    fn maps_go_from_black_to_white_and_pictures_shrink_by_means() {
        let map = heat(&Image::<Data>::from_samples(2, 1, 1, vec![0.0, 1.0]).into()).unwrap();
        assert_eq!(map.codes, [0, 0, 0, 255, 255, 255]);
        let small = halved(raster(4, 2, (0..24).map(|v| v * 10).collect()), 2);
        assert_eq!((small.width, small.height, small.codes[0]), (2, 1, 75));
    }
}
