//! Axes. An axis turns one node of the file into several nodes, one for each value of the axis.
//!
//! `axes: (yaw: List([0.0, 15.0]))` defines an axis and its values, and a field such as `yaw_deg: Axis("yaw")`
//! reads the axis. Each `Axis` call is replaced with the text of a value. The fields are read once for each
//! combination of axis values. Such a combination is called a *point*; see `expand`.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;

use ron::value::RawValue;
use serde::Deserialize;

use crate::graph::axis_names::Padding;
use crate::text::diag::{Diagnostic, nearest, shown};
use crate::text::document::RawField;
use crate::text::subgraph::calls;
use crate::text::values::parse_value;

/// A named list of values.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Axis<'t> {
    pub name: &'t str,
    /// Values as RON.
    pub values: Vec<String>,
    /// Number of digits to which the values are padded in file names; `None` if they are not padded.
    pub padding: Option<Padding>,
}

/// Maximum number of values of an axis.
const MOST_VALUES: usize = 100_000;

/// Syntax of the values of an axis.
#[derive(Deserialize)]
enum Values<'t> {
    /// Start, end (exclusive) and step (1 by default).
    Range(f64, f64, #[serde(default)] Option<f64>),
    /// A list of values.
    #[serde(borrow)]
    List(Vec<&'t RawValue>),
    /// The indices, from 0, of the cameras that the node with this name outputs.
    Cameras(#[serde(borrow)] Cow<'t, str>),
}

impl<'t> Axis<'t> {
    /// Parses an entry of the `axes` block. `cameras_of` maps the name of a node to the number of its cameras. It
    /// returns `None` if that node has a mistake that is reported elsewhere.
    pub fn read(
        field: &RawField<'t>,
        cameras_of: impl FnOnce(&str) -> Result<Option<usize>, Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let wrong = |message: String| {
            Diagnostic::new(field.span.clone(), message).hint(
                "an axis is written `Range(0, 12)`, `Range(0.0, 360.0, 30.0)`, `List([0.0, 15.0])` or \
                 `Cameras(\"rig\")`",
            )
        };
        if field.name == "view" {
            let clash = Diagnostic::new(field.name_span.clone(), "an axis cannot be named `view`");
            return Err(clash.label("`{view}` in paths stands for the name of a view"));
        }
        let values = match parse_value::<Values<'_>>(field.text) {
            Ok(Values::List(values)) => {
                values.iter().map(|value| value.get_ron().trim().to_owned()).collect()
            }
            Ok(Values::Range(from, to, step)) => range(from, to, step.unwrap_or(1.0))
                .map_err(|why| wrong(format!("`{}` {why}", field.name)))?,
            Ok(Values::Cameras(node)) => match cameras_of(&node)? {
                Some(count) => (0..count.min(MOST_VALUES + 1)).map(|index| index.to_string()).collect(),
                None => return Ok(Self::broken(field.name)),
            },
            Err(_) => {
                return Err(wrong(format!(
                    "`{}` is not an axis, since its value is `{}`",
                    field.name,
                    shown(field.text)
                )));
            }
        };
        let values: Vec<String> = values;
        if values.is_empty() || values.len() > MOST_VALUES {
            return Err(wrong(format!(
                "`{}` has {} values; an axis needs 1 to {MOST_VALUES}",
                field.name,
                values.len()
            )));
        }
        let mut seen = BTreeSet::new();
        if let Some(twice) = values.iter().find(|value| !seen.insert(value.as_str())) {
            return Err(wrong(format!("`{}` has the value {} twice", field.name, shown(twice))));
        }
        Ok(Self::new(field.name, values))
    }

    /// A placeholder for an axis that could not be parsed. It makes the name known, so that uses of the axis are
    /// not reported as mistakes too.
    pub fn broken(name: &'t str) -> Self {
        Self { name, values: Vec::new(), padding: None }
    }

    /// True if the axis could be parsed.
    pub fn is_whole(&self) -> bool {
        !self.values.is_empty()
    }

    fn new(name: &'t str, values: Vec<String>) -> Self {
        let padding = Padding::of(&values);
        Self { name, values, padding }
    }
}

/// The values of a range, from `from` to `to` (exclusive), as text. They are written as whole numbers if `from` and
/// `step` are whole.
fn range(from: f64, to: f64, step: f64) -> Result<Vec<String>, String> {
    if ![from, to, step].iter().all(|number| number.is_finite()) || step == 0.0 {
        return Err("is not a valid range: its numbers must be finite and its step must not be 0".to_owned());
    }
    let count = ((to - from) / step).ceil();
    if count < 1.0 {
        return Err(format!("has no values: steps of {step} from {from} do not approach {to} (exclusive)"));
    }
    if count > MOST_VALUES as f64 {
        return Err(format!("has more than {MOST_VALUES} values, the maximum for an axis"));
    }
    let whole = [from, step].iter().all(|number| number.fract() == 0.0 && number.abs() < 1e15);
    let text = |index: usize| {
        let value = from + index as f64 * step;
        if whole { format!("{value:.0}") } else { format!("{value:?}") }
    };
    Ok((0..count as usize).map(text).collect())
}

/// A call in the text of a field. Each call is replaced with a value.
#[derive(Deserialize)]
enum Call<'t> {
    /// The value of the named axis.
    Axis(#[serde(borrow)] Cow<'t, str>),
    /// A value that depends on the value of the named axis, or on the sum of the values of several axes, interpolated
    /// between keys. The keys are in ascending order of axis value. Each key is a pair of an axis value and either one
    /// number or several numbers in parentheses.
    Track(#[serde(borrow)] Names<'t>, #[serde(borrow)] Vec<(f64, &'t RawValue)>),
}

/// The name of an axis, or a list of names.
#[derive(Deserialize)]
#[serde(untagged)]
enum Names<'t> {
    One(#[serde(borrow)] Cow<'t, str>),
    Sum(#[serde(borrow)] Vec<Cow<'t, str>>),
}

impl Call<'_> {
    /// The names of the axes that the call reads.
    fn names(&self) -> &[Cow<'_, str>] {
        match self {
            Call::Axis(name) | Call::Track(Names::One(name), _) => std::slice::from_ref(name),
            Call::Track(Names::Sum(names), _) => names,
        }
    }
}

/// Names of the calls in [`Call`].
const CALLS: [&str; 2] = ["Axis", "Track"];

/// True if the text of a field contains an `Axis` or `Track` call.
pub(crate) fn reads_axis(text: &str) -> bool {
    !calls(text, &CALLS).is_empty()
}

/// The indices of the axes to which the calls in a field refer. Returns an error if a call has a mistake. `span` is
/// the byte range of the field.
pub(crate) fn axes_read(
    text: &str,
    span: &Range<usize>,
    axes: &[Axis<'_>],
) -> Result<Vec<usize>, Diagnostic> {
    let mut read = Vec::new();
    for call in calls(text, &CALLS) {
        // If parameters were replaced by values, the text itself is not in the file.
        let as_written = text.len() == span.len();
        let place = if as_written { span.start + call.start..span.start + call.end } else { span.clone() };
        let text = &text[call];
        let call = parse_value::<Call<'_>>(text).map_err(|_| {
            Diagnostic::new(place.clone(), format!("`{}` is not a valid use of an axis", shown(text)))
                .hint("write `Axis(\"yaw\")`, or `Track(\"frame\", [(0, 1.0), (11, 2.5)])`")
        })?;
        if call.names().is_empty() {
            let mistake = Diagnostic::new(place, "`Track` needs the name of an axis");
            return Err(mistake.hint("write `Track(\"frame\", [(0, 1.0), (11, 2.5)])`"));
        }
        let twice = call.names().iter().enumerate().find(|(at, name)| call.names()[..*at].contains(name));
        if let Some((_, name)) = twice {
            let mistake = Diagnostic::new(place, format!("`Track` names the axis `{}` twice", shown(name)));
            return Err(mistake.hint("`Track` reads the sum of the axes; name each of them once"));
        }
        for name in call.names() {
            let index = axes.iter().position(|axis| axis.name == name);
            let index = index.ok_or_else(|| unknown(name, place.clone(), axes))?;
            if let Call::Track(_, keys) = &call
                && axes[index].is_whole()
            {
                let first = axes[index].values.first().map_or("", String::as_str);
                let fits = number(first).and_then(|value| track(keys, value));
                fits.map_err(|why| Diagnostic::new(place.clone(), why))?;
            }
            read.push(index);
        }
    }
    Ok(read)
}

/// The mistake of a name that no axis has.
fn unknown(name: &str, place: Range<usize>, axes: &[Axis<'_>]) -> Diagnostic {
    let mistake = Diagnostic::new(place, format!("the graph has no axis `{}`", shown(name)));
    match nearest(name, axes.iter().map(|axis| axis.name)) {
        Some(near) => mistake.hint(format!("did you mean `{near}`?")),
        None => mistake.hint("axes are declared next to `nodes`: `axes: (yaw: List([0.0, 15.0]))`"),
    }
}

/// Replaces each call in a field with its value at a point. `at` maps the index of an axis to the index of the
/// value that this axis has at the point.
pub(crate) fn at_point<'t>(text: &'t str, axes: &[Axis<'_>], at: impl Fn(usize) -> usize) -> Cow<'t, str> {
    let calls = calls(text, &CALLS);
    if calls.is_empty() {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    let mut end = 0;
    for span in calls {
        out.push_str(&text[end..span.start]);
        end = span.end;
        // Mistakes in calls were reported by `axes_read`.
        let value = parse_value::<Call<'_>>(&text[span]).ok().and_then(|call| {
            let value = |name: &Cow<'_, str>| {
                let index = axes.iter().position(|axis| axis.name == name)?;
                axes[index].values.get(at(index))
            };
            match &call {
                Call::Axis(name) => value(name).cloned(),
                Call::Track(_, keys) => {
                    let each = call.names().iter().map(|name| number(value(name)?).ok());
                    track(keys, each.sum::<Option<f64>>()?).ok()
                }
            }
        });
        out.push_str(&value.unwrap_or_default());
    }
    out.push_str(&text[end..]);
    Cow::Owned(out)
}

/// The value of a track at the axis value `place`, as text. It is interpolated linearly between the keys, and
/// constant before the first and after the last key.
fn track(keys: &[(f64, &RawValue)], place: f64) -> Result<String, String> {
    let keys: Vec<(f64, Vec<f64>)> = keys
        .iter()
        .map(|(at, value)| Some((*at, numbers(value.get_ron())?)))
        .collect::<Option<_>>()
        .ok_or("each key of `Track` is written `(axis value, number)` or `(axis value, (number, ..))`")?;
    if keys.is_empty()
        || keys.windows(2).any(|pair| pair[0].0 >= pair[1].0 || pair[0].1.len() != pair[1].1.len())
    {
        return Err(
            "the keys of `Track` must be in ascending order, and their values must be all numbers or all lists of the same length".to_owned()
        );
    }
    let after = keys.partition_point(|(at, _)| *at <= place);
    let values = match (after.checked_sub(1).map(|before| &keys[before]), keys.get(after)) {
        (Some((_, only)), None) | (None, Some((_, only))) => only.clone(),
        (Some((from, a)), Some((to, b))) => {
            let share = (place - from) / (to - from);
            a.iter().zip(b).map(|(a, b)| exact(a + (b - a) * share, a.abs().max(b.abs()))).collect()
        }
        (None, None) => Vec::new(),
    };
    // Whole numbers are valid for integer and float fields.
    let whole = |value: &f64| value.fract() == 0.0 && value.abs() < 1e15;
    let text = |value: &f64| if whole(value) { format!("{value:.0}") } else { format!("{value:?}") };
    let texts: Vec<String> = values.iter().map(text).collect();
    Ok(if texts.len() == 1 { texts.concat() } else { format!("({})", texts.join(", ")) })
}

/// The whole number that a value would be without rounding errors, or the value. `size` is the size of the numbers from
/// which it was interpolated. A whole parameter, such as a number of samples, needs it.
fn exact(value: f64, size: f64) -> f64 {
    if (value - value.round()).abs() <= 1e-12 * size { value.round() } else { value }
}

/// The value of an axis of numbers.
fn number(value: &str) -> Result<f64, String> {
    value.parse().map_err(|_| format!("`Track` needs an axis of numbers, but `{value}` is not a number"))
}

/// Parses one number, or several numbers in parentheses.
fn numbers(text: &str) -> Option<Vec<f64>> {
    let text = text.trim();
    let finite = |numbers: &Vec<f64>| !numbers.is_empty() && numbers.iter().all(|number| number.is_finite());
    match text.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')) {
        Some(inside) => parse_value::<Vec<f64>>(&format!("[{inside}]")).ok().filter(|n| n.len() > 1),
        None => parse_value::<f64>(text).ok().map(|number| vec![number]),
    }
    .filter(finite)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(text: &str) -> RawField<'_> {
        RawField { span: 5..5 + text.len(), ..RawField::plain("yaw", text) }
    }

    fn values(text: &str) -> Result<Vec<String>, String> {
        Axis::read(&field(text), |_| Ok(Some(3))).map(|axis| axis.values).map_err(|mistake| mistake.message)
    }

    /// Steps such as 0.1 are not exact. This test fails if `exact` returns `value`.
    #[test]
    fn tracks_reach_whole_numbers_at_inexact_places() {
        let keys: Vec<(f64, &RawValue)> =
            parse_value("[(0.05, 0), (0.45, 64)]").unwrap_or_else(|e| panic!("{e:?}"));
        let at = |index: u32| track(&keys, 0.05 + f64::from(index) * 0.1);
        let values: Vec<String> = (0..5).filter_map(|index| at(index).ok()).collect();
        assert_eq!(values, ["0", "16", "32", "48", "64"]);
        assert!(track(&keys, 0.11).is_ok_and(|value| value.starts_with("9.")), "not a whole number");
        let small: Vec<(f64, &RawValue)> =
            parse_value("[(0, 0), (1, 3e-13)]").unwrap_or_else(|e| panic!("{e:?}"));
        assert_eq!(track(&small, 0.5).as_deref(), Ok("1.5e-13"));
    }

    #[test]
    fn ranges_leave_their_end_out_and_stay_whole() {
        assert_eq!(values("Range(0, 3)"), Ok(vec!["0".into(), "1".into(), "2".into()]));
        assert_eq!(values("Range(-1, 1, 2)"), Ok(vec!["-1".into()]));
        assert_eq!(
            values("Range(0, 1, 0.25)"),
            Ok(["0.0", "0.25", "0.5", "0.75"].map(String::from).to_vec())
        );
        assert_eq!(values("Range(1, 0, -0.5)"), Ok(vec!["1.0".into(), "0.5".into()]));
        assert_eq!(values("List([ 0.0, \"a, b\", (1, 2) ])").map(|list| list.len()), Ok(3));
        assert_eq!(values("Cameras(\"rig\")"), values("Range(0, 3)"));
    }

    #[test]
    fn what_is_no_axis_says_so() {
        for (text, wanted) in [
            ("Range(0, 0)", "has no values: steps of 1 from 0 do not approach 0 (exclusive)"),
            ("Range(4, 0)", "has no values"),
            ("Range(0, 1e9)", "has more than 100000 values"),
            ("Range(0, NaN)", "is not a valid range"),
            ("Range(0, 1, 0)", "its step must not be 0"),
            ("Range(0, inf, 1)", "its numbers must be finite"),
        ] {
            assert!(values(text).is_err_and(|why| why.contains(wanted)), "{text}");
        }
        for text in ["3", "Range(0)", "List(1)", "Rnge(0, 3)"] {
            assert!(values(text).is_err_and(|why| why.contains("is not an axis")), "{text}");
        }
        assert!(values("List([])").is_err_and(|why| why.contains("has 0 values")));
        assert!(values("List([1, 2, 1])").is_err_and(|why| why.contains("has the value 1 twice")));
    }

    fn axes() -> Vec<Axis<'static>> {
        let axis = |name, values: &[&str]| Axis::new(name, values.iter().map(|&v| v.to_owned()).collect());
        vec![axis("yaw", &["0.0", "15.0"]), axis("frame", &["0", "1", "2"]), axis("file", &["\"a.hdr\""])]
    }

    #[test]
    fn values_take_the_place_of_calls_and_of_nothing_else() {
        let at = |text, point: [usize; 3]| at_point(text, &axes(), |axis| point[axis]).into_owned();
        assert_eq!(at("Axis(\"yaw\")", [1, 0, 0]), "15.0");
        assert_eq!(at("(1.0, Axis ( \"yaw\" ), Axis(\"frame\"))", [1, 2, 0]), "(1.0, 15.0, 2)");
        assert_eq!(at("Axis(\"file\")", [0, 0, 0]), "\"a.hdr\"");
        assert_eq!(at("\"Axis(\\\"yaw\\\")\"", [1, 0, 0]), "\"Axis(\\\"yaw\\\")\"", "text is text");
        assert_eq!(at("Track(\"frame\", [(0, 1), (2, 2)])", [0, 1, 0]), "1.5");
        assert_eq!(at("Track(\"frame\", [(1, (0, 1, 2)), (2, (1, 1, 1))])", [0, 0, 0]), "(0, 1, 2)");
        assert_eq!(at("Track(\"frame\", [(0, 1), (1, 4)])", [0, 2, 0]), "4");
        assert_eq!(at("Track([\"frame\"], [(0, 1), (1, 4)])", [0, 2, 0]), "4");
        assert_eq!(at("Track([\"frame\", \"yaw\"], [(0, 0), (20, 40)])", [1, 2, 0]), "34", "2 + 15.0");
    }

    #[test]
    fn the_axes_of_a_field_are_found_or_what_is_wrong_is_reported_in_its_place() {
        let read = |text: &str| axes_read(text, &(5..5 + text.len()), &axes());
        assert_eq!(read("(Axis(\"frame\"), Axis(\"yaw\"))"), Ok(vec![1, 0]));
        assert_eq!(read("\"plain\""), Ok(vec![]));
        assert_eq!(read("Track([\"frame\", \"yaw\"], [(0, 1)])"), Ok(vec![1, 0]));
        let wrong = |text| read(text).expect_err(text);
        assert!(wrong("Track([\"frame\", \"yow\"], [(0, 1)])").hints[0].contains("did you mean `yaw`?"));
        assert!(wrong("Track([\"frame\", \"file\"], [(0, 1)])").message.contains("needs an axis of numbers"));
        let twice = wrong("Track([\"frame\", \"frame\"], [(0, 1)])").message;
        assert_eq!(twice, "`Track` names the axis `frame` twice");
        assert!(wrong("Track([], [(0, 1)])").message.contains("needs the name of an axis"));
        assert_eq!(wrong("(1, Axis(\"yow\"))").span, 9..20);
        assert!(wrong("Axis(\"yow\")").hints[0].contains("did you mean `yaw`?"));
        assert!(wrong("Axis(yaw)").message.contains("is not a valid use of an axis"));
        assert!(wrong("Track(\"file\", [(0, 1)])").message.contains("needs an axis of numbers"));
        assert!(wrong("Track(\"frame\", [])").message.contains("ascend"));
        assert!(wrong("Track(\"frame\", [(1, 1), (1, 2)])").message.contains("ascend"));
        assert!(wrong("Track(\"frame\", [(0, 1), (1, (1, 2))])").message.contains("of the same length"));
        assert!(wrong("Track(\"frame\", [(0, \"a\")])").message.contains("written"));
    }
}
