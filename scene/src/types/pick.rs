//! Choice of cameras by name, pattern, range or index. An axis of numbers chooses cameras by index.

use std::collections::BTreeSet;

use engine::{NodeError, ParamType};
use serde::{Deserialize, Deserializer, Serialize};

/// Text that chooses cameras. A whole number `n` is the range `n..n+1`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Pick(pub String);

impl From<&str> for Pick {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl<'de> Deserialize<'de> for Pick {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;
        impl serde::de::Visitor<'_> for Either {
            type Value = Pick;
            fn expecting(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                to.write_str("text or the index of a camera")
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Pick, E> {
                Ok(Pick(text.to_owned()))
            }
            fn visit_u64<E: serde::de::Error>(self, index: u64) -> Result<Pick, E> {
                let end =
                    index.checked_add(1).ok_or_else(|| E::custom("the index of the camera is too large"))?;
                Ok(Pick(format!("{index}..{end}")))
            }
            fn visit_i64<E: serde::de::Error>(self, index: i64) -> Result<Pick, E> {
                let index = u64::try_from(index)
                    .map_err(|_| E::custom("the index of a camera must be at least 0"))?;
                self.visit_u64(index)
            }
        }
        deserializer.deserialize_any(Either)
    }
}

impl ParamType for Pick {
    fn describe() -> String {
        "text or index".to_owned()
    }
}

/// The path of a picture without extension.
pub fn stem(picture: &str) -> &str {
    match picture.rsplit_once('.') {
        Some((stem, ending))
            if !stem.is_empty()
                && !stem.ends_with(['/', '\\'])
                && ending.len() <= 4
                && !ending.chars().all(|c| c.is_ascii_digit())
                && !ending.contains(['/', '\\']) =>
        {
            stem
        }
        _ => picture,
    }
}

/// Number of chosen cameras; `None` unless all are chosen by index, since otherwise the number depends on the file.
pub fn count_of(wishes: &[Pick]) -> Option<usize> {
    let index = |Pick(wish): &Pick| range(wish).filter(|(start, end, _)| start.checked_add(1) == Some(*end));
    let indices: BTreeSet<usize> = wishes.iter().map(|wish| Some(index(wish)?.0)).collect::<Option<_>>()?;
    (!wishes.is_empty() && indices.len() == wishes.len()).then_some(wishes.len())
}

/// Returns the indices of the cameras that `wishes` choose, in the order of the patterns. Each index occurs once.
pub fn chosen(wishes: &[Pick], names: &[String], pictures: &[&str]) -> Result<Vec<usize>, NodeError> {
    if wishes.is_empty() {
        return Ok((0..names.len()).collect());
    }
    let (mut chosen, mut taken) = (Vec::new(), vec![false; names.len()]);
    for Pick(wish) in wishes {
        let found: Vec<usize> = match range(wish) {
            Some((start, end, step)) => (start..end.min(names.len())).step_by(step).collect(),
            None => {
                let fits = |i: &usize| {
                    [&names[*i], pictures[*i], stem(pictures[*i])].iter().any(|name| matches(wish, name))
                };
                (0..names.len()).filter(fits).collect()
            }
        };
        if found.is_empty() {
            let some = names.iter().take(5).map(String::as_str).collect::<Vec<_>>().join(", ");
            return Err(NodeError::new(format!(
                "`{wish}` picks none of the cameras (number: {})",
                names.len()
            ))
            .hint(format!("the names of the first cameras are {some}")));
        }
        chosen.extend(found.into_iter().filter(|index| !std::mem::replace(&mut taken[*index], true)));
    }
    Ok(chosen)
}

/// Parses a range such as `2..5`, `2..` or `0..400..8` to (start, end, step). `None` if the text is not a range.
fn range(wish: &str) -> Option<(usize, usize, usize)> {
    let parts: Vec<&str> = wish.split("..").collect();
    let (start, end, step) = match parts[..] {
        [start, end] => (start, end, "1"),
        [start, end, step] => (start, end, step),
        _ => return None,
    };
    let end = if end.is_empty() { usize::MAX } else { end.parse().ok()? };
    Some((start.parse().ok()?, end, step.parse().ok().filter(|step| *step > 0)?))
}

/// True if a name matches a pattern with the wildcards `*` and `?`.
pub fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let (mut p, mut n, mut retry) = (0, 0, None);
    while n < name.len() {
        match pattern.get(p) {
            Some('*') => {
                retry = Some((p, n));
                p += 1;
            }
            Some(&c) if c == '?' || c == name[n] => (p, n) = (p + 1, n + 1),
            _ => {
                let Some((star, from)) = retry else { return false };
                retry = Some((star, from + 1));
                (p, n) = (star + 1, from + 1);
            }
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}
