//! Values of fields, parsed by `ron`, and diagnostics for values of the wrong form.

use std::ops::Range;

use ron::extensions::Extensions;

use crate::text::diag::{Code, Diagnostic, nearest, shown};
use crate::text::scan::Scanner;

fn options() -> ron::Options {
    ron::Options::default().with_default_extension(Extensions::IMPLICIT_SOME)
}

/// Parses a value of a known type.
pub(crate) fn parse_value<'t, T: serde::Deserialize<'t>>(text: &'t str) -> Result<T, ron::Error> {
    options().from_str(text).map_err(|error| error.code)
}

/// The form of a value in plain words, such as "a list".
pub(crate) fn form_of(text: &str) -> &'static str {
    match text.bytes().next().unwrap_or_default() {
        b'"' => "text",
        b'\'' => "a letter",
        b'[' => "a list",
        b'(' => "a group in ( )",
        b'{' => "a group in { }",
        b'+' | b'-' | b'.' | b'0'..=b'9' => "a number",
        _ if matches!(text, "true" | "false") => "true or false",
        _ => "a word",
    }
}

/// Adds an article: `a number`, `an integer`. Other descriptions are returned unchanged.
pub(crate) fn with_article(described: &str) -> String {
    let article = match described.bytes().next() {
        Some(b'a' | b'e' | b'i' | b'o' | b'u') => "an ",
        Some(b'a'..=b'z') if !described.starts_with("text") && !described.contains(" | ") => "a ",
        _ => "",
    };
    format!("{article}{described}")
}

/// Encloses numbers separated by commas in the brackets that the described type needs. `None` if `text` is not a
/// list of such numbers.
fn numbers_without_brackets(described: &str, text: &str) -> Option<String> {
    let numbers: Vec<&str> = text.split(',').map(str::trim).collect();
    let all =
        numbers.len() > 1 && numbers.iter().all(|number| number.parse::<f64>().is_ok_and(f64::is_finite));
    let numbers = all.then(|| numbers.join(", "))?;
    if described.contains(" numbers in ( )") {
        Some(format!("({numbers})"))
    } else {
        (described.starts_with('[') && described.contains("number")).then(|| format!("[{numbers}]"))
    }
}

/// Describes a mistake inside a group or list of numbers: a wrong number of items, or an item that is not a number.
fn wrong_items(described: &str, text: &str) -> Option<String> {
    let (numbers, sort) = (described.contains("number"), form_of(text));
    let wanted: Option<usize> =
        described.split_once(" numbers in ( )").and_then(|(count, _)| count.parse().ok());
    if !numbers || sort != if wanted.is_some() { "a group in ( )" } else { "a list" } {
        return None;
    }
    let mut scan = Scanner::new(&text[..text.len() - 1]);
    scan.at = 1;
    let mut items = Vec::new();
    loop {
        scan.skip_space();
        if scan.is_at_end() {
            break;
        }
        items.push(&scan.text[scan.value()?]);
        scan.skip_space();
        if !scan.eat(b',') && !scan.is_at_end() {
            return None;
        }
    }
    if let Some(item) = items.iter().find(|item| parse_value::<f64>(item).is_err()) {
        return Some(format!("but `{}` is not a number", shown(item)));
    }
    let wanted = wanted.filter(|wanted| *wanted != items.len())?;
    Some(match items.len() {
        0 => "but the list is empty".to_owned(),
        found if found < wanted => format!("not only {found}"),
        found => format!("not {found}"),
    })
}

/// True if a text starts like a choice with fields: with its name and a bracket.
fn begins(choice: &str, text: &str) -> bool {
    choice.split_once('(').is_some_and(|(name, _)| {
        text.strip_prefix(name).is_some_and(|rest| rest.trim_start().starts_with('('))
    })
}

/// The diagnostic for a parameter whose text cannot be parsed. `range` is the label for a number that is out of
/// range.
pub(crate) fn value_mistake(
    name: &str,
    described: &str,
    text: &str,
    error: &ron::Error,
    span: Range<usize>,
    range: Option<String>,
) -> Diagnostic {
    let described = described.strip_suffix(" (optional)").unwrap_or(described);
    let wanted = with_article(described);
    let mistake = |message: String| Diagnostic::of(Code::WrongValue, span.clone(), message);
    match error {
        ron::Error::NoSuchEnumVariant { found, expected, .. } => {
            mistake(format!("`{}` is not one of the choices of `{name}`", shown(found)))
                .label(format!("one of {wanted}"))
                .suggest(found, expected.iter().copied())
        }
        ron::Error::NoSuchStructField { found, expected, .. } => {
            mistake(format!("`{name}` has no field `{}`", shown(found)))
                .suggest(found, expected.iter().copied())
                .hint(format!("its fields are {}", expected.join(", ")))
        }
        ron::Error::MissingStructField { field, .. } => {
            mistake(format!("`{name}` needs `{field}`")).label(format!("expected {wanted}"))
        }
        ron::Error::ExceededRecursionLimit => mistake(format!("`{name}` has too many nested brackets")),
        ron::Error::Message(why) => mistake(format!("`{name}`: {why}")).label(format!("expected {wanted}")),
        ron::Error::IntegerOutOfBounds => mistake(format!("`{name}` is out of range: {}", shown(text)))
            .label(range.unwrap_or_else(|| format!("expected {wanted}"))),
        ron::Error::ExpectedIdentifier
        | ron::Error::InvalidIdentifier(_)
        | ron::Error::SuggestRawIdentifier(_)
            if let Some(choice) = described.split(" | ").find(|choice| begins(choice, text)) =>
        {
            mistake(format!("`{name}`: fields in the brackets need names"))
                .label(format!("expected {choice}"))
        }
        _ if let Some(what) = wrong_items(described, text) => {
            mistake(format!("`{name}` takes {wanted}, {what}"))
        }
        // The choice is valid, but its content is not.
        _ if described.split(" | ").any(|choice| begins(choice, text)) => {
            let why = error.to_string();
            let (first, rest) = why.split_at(why.chars().next().map_or(0, char::len_utf8));
            mistake(format!("`{name}`: {}{rest}", first.to_lowercase())).label(format!("expected {wanted}"))
        }
        _ => {
            let sort = form_of(text);
            let is_number = sort == "a number";
            let found = if is_number { shown(text) } else { sort.into() };
            let mistake = mistake(format!("`{name}` takes {wanted}, not {found}"));
            let inner = text.trim_matches('"');
            let choices = described.contains(" | ").then(|| described.split(" | "));
            let choices = choices.into_iter().flatten().filter_map(|choice| choice.split('(').next());
            let choice = nearest(inner, choices).filter(|_| sort == "text");
            let whole = text.parse().ok().filter(|n: &f64| n.fract() == 0.0 && (0.0..1e15).contains(n));
            match (sort, whole) {
                ("a number", Some(whole)) => mistake.label(format!("write {whole}")),
                _ if let Some(choice) = choice => mistake.label(format!("write {choice} without quotes")),
                ("text", _) if let Some(list) = numbers_without_brackets(described, inner) => {
                    mistake.label(format!("write {list} without quotes"))
                }
                ("text", _) if inner.parse::<f64>().is_ok() => {
                    mistake.label(format!("write {inner} without quotes"))
                }
                ("a word", _) if described.starts_with("text") || described.starts_with("path") => {
                    mistake.label(format!("write \"{}\"", shown(text)))
                }
                _ => mistake,
            }
        }
    }
}
