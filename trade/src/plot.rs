//! A plot of error against cost, as SVG. No charting crate is used, since none supports both links and text on
//! hover.

use std::fmt::Write as _;

/// A point of a plot.
pub struct Dot {
    /// Cost, on the horizontal axis.
    pub cost: f64,
    /// Error, on the vertical axis.
    pub error: f64,
    /// Name of the point. It is shown on hover and, if `named` is true, next to the point.
    pub name: String,
    /// True if no other point has both a lower cost and a lower error.
    pub front: bool,
    /// True if the name is shown next to the point.
    pub named: bool,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 360.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 120.0;
const TOP: f64 = 20.0;
const BOTTOM: f64 = 46.0;

/// Draws a plot as SVG. `cost` and `error` are the labels of the axes, and `shown` formats an error. If `bound` is
/// given, a line is drawn at this error. Both axes are logarithmic. Errors of 0 are drawn on a separate line below
/// the smallest other error. Returns `None` if there is nothing to plot.
pub fn svg(
    dots: &[Dot],
    cost: &str,
    error: &str,
    shown: impl Fn(f64) -> String,
    bound: Option<f64>,
) -> Option<String> {
    let log = |value: f64| scene::math::num::f64::log10(value);
    let errors = dots.iter().map(|dot| dot.error).chain(bound).filter(|e| *e > 0.0 && e.is_finite());
    let least = errors.clone().reduce(f64::min).unwrap_or(1e-3);
    let floor = least / 3.0;
    let most = errors.reduce(f64::max)?;
    let costs = || dots.iter().map(|dot| dot.cost).filter(|c| *c > 0.0);
    let (cheap, dear) = (costs().reduce(f64::min)?, costs().reduce(f64::max)?);
    // Each side is extended by 8 % of the range.
    let widened = |low: f64, high: f64| {
        let (low, high) = (log(low), log(high));
        let more = (high - low).max(0.2) * 0.08;
        (low - more, high + more)
    };
    let (x0, x1) = widened(cheap, dear);
    let (y0, y1) = widened(floor, most);
    let x = |value: f64| LEFT + (log(value.max(cheap)) - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
    let y = |value: f64| TOP + (y1 - log(value.max(floor))) / (y1 - y0) * (HEIGHT - TOP - BOTTOM);
    let mut text = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\">\n\
         <rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{}\" height=\"{}\" class=\"frame\"/>\n",
        WIDTH - LEFT - RIGHT,
        HEIGHT - TOP - BOTTOM
    );
    // Writing to a string cannot fail.
    for value in ticks(x0, x1) {
        let at = x(value);
        let _ = writeln!(
            text,
            "<path d=\"M{at:.1} {TOP}V{}\" class=\"grid\"/><text x=\"{at:.1}\" y=\"{}\" class=\"tick\" \
             text-anchor=\"middle\">{}</text>",
            HEIGHT - BOTTOM,
            HEIGHT - BOTTOM + 16.0,
            tick_text(value)
        );
    }
    let exact = dots.iter().any(|dot| dot.error <= 0.0);
    // Between 0 and the smallest error, the axis has no scale.
    let values = ticks(y0, y1).into_iter().filter(|value| !exact || *value >= least);
    for value in values.chain(exact.then_some(0.0)) {
        let at = y(value);
        let _ = writeln!(
            text,
            "<path d=\"M{LEFT} {at:.1}H{}\" class=\"grid\"/><text x=\"{}\" y=\"{:.1}\" class=\"tick\" \
             text-anchor=\"end\">{}</text>",
            WIDTH - RIGHT,
            LEFT - 6.0,
            at + 4.0,
            shown(value)
        );
    }
    if let Some(bound) = bound.filter(|bound| *bound > 0.0) {
        let at = y(bound);
        let _ = writeln!(text, "<path d=\"M{LEFT} {at:.1}H{}\" class=\"bound\"/>", WIDTH - RIGHT);
    }
    let mut front: Vec<&Dot> = dots.iter().filter(|dot| dot.front).collect();
    front.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let way: Vec<String> = front.iter().map(|d| format!("{:.1},{:.1}", x(d.cost), y(d.error))).collect();
    let _ = writeln!(text, "<polyline points=\"{}\" class=\"front\"/>", way.join(" "));
    let mut names: Vec<[f64; 4]> = Vec::new();
    for dot in dots {
        let (cx, cy) = (x(dot.cost), y(dot.error));
        let class = if dot.front { "dot on" } else { "dot" };
        let (cost, error) = (tick_text(dot.cost), shown(dot.error));
        let title = crate::escape::escaped(&format!("{}: work {cost}, error {error}", dot.name));
        let _ = writeln!(
            text,
            "<circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"4\" class=\"{class}\"><title>{title}</title></circle>"
        );
        if dot.named {
            let name = crate::escape::escaped(&dot.name);
            let place = place_of_name(&dot.name, (cx, cy), &names);
            names.push(place);
            let _ = writeln!(
                text,
                "<text x=\"{:.1}\" y=\"{:.1}\" class=\"name\">{name}</text>",
                place[0], place[1]
            );
        }
    }
    let (middle_x, middle_y) = ((LEFT + WIDTH - RIGHT) / 2.0, (TOP + HEIGHT - BOTTOM) / 2.0);
    let _ = writeln!(
        text,
        "<text x=\"{middle_x}\" y=\"{}\" class=\"axis\" text-anchor=\"middle\">{cost}</text>\n\
         <text x=\"14\" y=\"{middle_y}\" class=\"axis\" text-anchor=\"middle\" \
         transform=\"rotate(-90 14 {middle_y})\">{error}</text>\n</svg>",
        HEIGHT - 8.0
    );
    Some(text)
}

/// The box of a dot's label: left, baseline, width and height. It lies to the right of the dot. Three heights are
/// possible. The first height at which the label overlaps no other label is used; if there is no such height, the
/// first of the three.
fn place_of_name(name: &str, (x, y): (f64, f64), others: &[[f64; 4]]) -> [f64; 4] {
    let at = |dy: f64| [x + 7.0, y + dy, 6.5 * name.len() as f64, 11.0];
    let apart =
        |a: [f64; 4], b: &[f64; 4]| a[0] + a[2] < b[0] || b[0] + b[2] < a[0] || (a[1] - b[1]).abs() > a[3];
    let free = [-5.0, 13.0, -18.0].map(at).into_iter().find(|a| others.iter().all(|b| apart(*a, b)));
    free.unwrap_or(at(-5.0))
}

/// Values of the ticks of an axis. `low` and `high` are the decimal logarithms of the ends of the axis. The ticks
/// are powers of ten times 1, 2 and 5, or only powers of ten if the range is wide.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let decades = low.floor() as i32..=high.ceil() as i32;
    let steps: &[f64] = if high - low < 2.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let all = decades.flat_map(|d| steps.iter().map(move |s| s * scene::math::num::pow(10.0, f64::from(d))));
    all.filter(|v| (low..=high).contains(&scene::math::num::f64::log10(*v))).collect()
}

/// Formats a number with few characters, such as `1.2 M`, `0.004` or `2e-6`.
pub fn tick_text(value: f64) -> String {
    let short = |value: f64, unit: &str| {
        let digits = if value < 9.995 {
            2
        } else if value < 99.95 {
            1
        } else {
            0
        };
        let text = format!("{value:.digits$}");
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        format!("{text}{unit}")
    };
    match value.abs() {
        0.0 => "0".to_owned(),
        v if !v.is_finite() => value.to_string(),
        v if v >= 1e9 => short(value / 1e9, " G"),
        v if v >= 1e6 => short(value / 1e6, " M"),
        v if v >= 1e4 => short(value / 1e3, " k"),
        v if v >= 1.0 => short(value, ""),
        v if v >= 1e-4 => {
            let text = format!("{value:.5}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        }
        _ => format!("{value:.0e}"),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let texts = [0.0, 2e-6, 0.004, 0.5, 1.0, 42.25, 640.0, 12_345.0, 1.25e6, 7e10].map(tick_text);
        assert_eq!([0.999_999_9, f64::INFINITY].map(tick_text), ["1", "inf"]);
        assert_eq!(texts, ["0", "2e-6", "0.004", "0.5", "1", "42.2", "640", "12.3 k", "1.25 M", "70 G"]);
    }

    #[test]
    fn every_dot_lies_in_the_frame_and_an_error_of_nothing_at_its_foot() {
        let dot = |cost, error| Dot { cost, error, name: "a<b".to_owned(), front: true, named: true };
        let svg =
            svg(&[dot(1.0, 0.5), dot(100.0, 0.01), dot(1000.0, 0.0)], "work", "error", tick_text, Some(0.1))
                .unwrap();
        let ys: Vec<f64> =
            svg.split("cy=\"").skip(1).map(|r| r.split('"').next().unwrap().parse().unwrap()).collect();
        assert!(ys.windows(2).all(|pair| pair[0] < pair[1]), "less error is lower: {ys:?}");
        assert!(ys.iter().all(|y| (TOP..=HEIGHT - BOTTOM).contains(y)) && !svg.contains("NaN"));
        assert!(svg.contains("a&lt;b") && svg.contains("class=\"bound\""));
        let foot = svg.split("text-anchor=\"end\">").filter(|rest| rest.starts_with("0<")).count();
        assert_eq!(foot, 1, "an axis that has a 0 says where it is");
        assert_eq!(super::svg(&[], "", "", tick_text, None), None);
    }
}
