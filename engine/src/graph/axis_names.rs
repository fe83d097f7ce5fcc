//! Axis values in the names of files, and in node names on the command line.

use std::ops::Range;

use crate::value::files::plain_name;

/// Number of digits to which the values of an axis are padded in file names, so that the names sort in the order of
/// the values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Padding {
    /// Number of digits before the decimal point.
    whole: usize,
    /// Number of digits after the decimal point.
    fraction: usize,
}

/// Maximum number of digits after the decimal point. Longer fractions, such as 0.30000000000000004, come from
/// rounding errors; an axis that has them is not padded.
const MOST_FRACTION: usize = 6;
/// Maximum number of digits that a placeholder in a path may request.
const MOST_DIGITS: usize = 32;

impl Padding {
    /// The padding for a list of values. `None` (no padding) unless all values are non-negative numbers without an
    /// exponent and with at most [`MOST_FRACTION`] digits after the decimal point.
    pub fn of(values: &[String]) -> Option<Self> {
        let parts = values.iter().map(|value| digits(value)).collect::<Option<Vec<_>>>()?;
        let longest = |lengths: &dyn Fn(&(&str, &str)) -> usize| parts.iter().map(lengths).max().unwrap_or(0);
        let padding = Self {
            whole: longest(&|(whole, _)| whole.len()),
            fraction: longest(&|(_, fraction)| fraction.len()),
        };
        (padding.fraction <= MOST_FRACTION).then_some(padding)
    }
}

/// The digits before and after the decimal point. The fraction `.0` counts as empty. `None` if the value is not a
/// plain decimal number.
fn digits(value: &str) -> Option<(&str, &str)> {
    let (whole, fraction) = value.split_once('.').unwrap_or((value, ""));
    let all = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let fraction = if fraction == "0" { "" } else { fraction };
    (!whole.is_empty() && all(whole) && all(fraction)).then_some((whole, fraction))
}

/// The value of an axis as part of a file name. `width` is the number of digits before the decimal point, if the
/// placeholder in the path gives one.
pub(crate) fn file_text(value: &str, padding: Option<Padding>, width: Option<usize>) -> String {
    let text = value.trim_matches('"');
    let plain = || plain_name(text.strip_suffix(".0").unwrap_or(text));
    let (sign, number) = text.strip_prefix('-').map_or(("", text), |number| ("-", number));
    let wanted = match (padding, width) {
        (padding, Some(whole)) => Padding { whole, fraction: padding.map_or(0, |padding| padding.fraction) },
        (Some(padding), None) => padding,
        (None, None) => return plain(),
    };
    let Some((whole, fraction)) = digits(number) else { return plain() };
    let whole = format!("{sign}{whole:0>digits$}", digits = wanted.whole);
    match wanted.fraction.max(fraction.len()) {
        0 => whole,
        digits => format!("{whole}.{fraction:0<digits$}"),
    }
}

/// The placeholders of an axis in a path, such as `{frame}` or `{frame:4}`. For each: its byte range in the path,
/// and the number of digits that it gives, if any.
fn holders<'p>(path: &'p str, axis: &str) -> impl Iterator<Item = (Range<usize>, Option<usize>)> + 'p {
    let open = format!("{{{axis}");
    let length = open.len();
    let starts: Vec<usize> = path.match_indices(&open).map(|(at, _)| at).collect();
    starts.into_iter().filter_map(move |at| {
        let rest = &path[at + length..];
        let end = rest.find('}')?;
        let width = match rest[..end].strip_prefix(':') {
            None => (end == 0).then_some(None)?,
            Some(width) => Some(width.parse().ok().filter(|width| (1..=MOST_DIGITS).contains(width))?),
        };
        Some((at..at + length + end + 1, width))
    })
}

/// True if the path contains a placeholder for the axis.
pub(crate) fn is_held(path: &str, axis: &str) -> bool {
    holders(path, axis).next().is_some()
}

/// The path with each placeholder of an axis replaced by `text(digits)`, where `digits` is the number of digits
/// that the placeholder gives, if any.
pub(crate) fn with_value(path: &str, axis: &str, text: impl Fn(Option<usize>) -> String) -> String {
    let (mut out, mut end) = (String::new(), 0);
    for (place, width) in holders(path, axis) {
        out.push_str(&path[end..place.start]);
        out.push_str(&text(width));
        end = place.end;
    }
    out + &path[end..]
}

/// True if an axis value matches `asked`, the value written in a node name on the command line. `asked` is a number
/// such as `5` or `005`, an inclusive range such as `5..7`, or any other text equal to the value.
pub(crate) fn is_asked_for(value: &str, asked: &str) -> bool {
    if value == asked {
        return true;
    }
    let Ok(value) = value.parse::<f64>() else { return false };
    let number = |text: &str| text.trim().parse::<f64>().ok();
    match asked.split_once("..") {
        Some((low, high)) => {
            let ends = number(low).zip(number(high));
            ends.is_some_and(|(low, high)| (low..=high).contains(&value))
        }
        None => number(asked) == Some(value),
    }
}

/// Removes an axis and its value from the start of `values`, and returns the rest: `y=2` for `x=1/y=2` and the axis
/// `x`. Returns all of `values` if they do not begin with this axis and value. A value may contain slashes.
pub(crate) fn after_value<'v>(values: &'v str, axis: &str, value: &str) -> &'v str {
    let Some(asked) = values.strip_prefix(axis).and_then(|rest| rest.strip_prefix('=')) else {
        return values;
    };
    if let Some(after) = asked.strip_prefix(value)
        && let Some(after) = if after.is_empty() { Some(after) } else { after.strip_prefix('/') }
    {
        return after;
    }
    let (first, after) = asked.split_once('/').unwrap_or((asked, ""));
    if is_asked_for(value, first) { after } else { values }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_sort_as_the_values_do() {
        let names = |values: &[&str], path: &str| -> Vec<String> {
            let values: Vec<String> = values.iter().map(|value| (*value).to_owned()).collect();
            let padding = Padding::of(&values);
            values.iter().map(|v| with_value(path, "a", |width| file_text(v, padding, width))).collect()
        };
        assert_eq!(names(&["0.0", "60.0", "120.0"], "{a}"), ["000", "060", "120"]);
        assert_eq!(names(&["0.5", "10.25", "3.0"], "{a}.x"), ["00.50.x", "10.25.x", "03.00.x"]);
        assert_eq!(names(&["9", "10"], "{a}/{a:4}"), ["09/0009", "10/0010"]);
        assert_eq!(names(&["-5", "5"], "{a}_{a:3}"), ["-5_-005", "5_005"]);
        assert_eq!(names(&["0.1", "0.30000000000000004"], "{a}"), ["0.1", "0.30000000000000004"]);
        assert_eq!(names(&["\"a/b\"", "1e300"], "{a:3}{ab}{a:x}"), ["a_b{ab}{a:x}", "1e300{ab}{a:x}"]);
        assert!(is_held("{a:4}", "a") && !is_held("{ab} {a:} {a:0} {a:99}", "a"));
    }

    #[test]
    fn values_are_asked_for_by_number_and_by_range() {
        for (value, asked) in
            [("5", "5"), ("5", "005"), ("5", "5..7"), ("7", "5..7"), ("0.5", "0..1"), ("x", "x")]
        {
            assert!(is_asked_for(value, asked), "{value} {asked}");
        }
        for (value, asked) in [("8", "5..7"), ("x", "y"), ("x", "5..7"), ("5", "..7"), ("5", "")] {
            assert!(!is_asked_for(value, asked), "{value} {asked}");
        }
        assert_eq!(after_value("f=5..7/y=1", "f", "6"), "y=1");
        assert_eq!(after_value("f=a/b/y=1", "f", "a/b"), "y=1");
        assert_eq!(after_value("f=5", "g", "5"), "f=5");
        assert_eq!(after_value("f=55", "f", "5"), "f=55");
    }
}
