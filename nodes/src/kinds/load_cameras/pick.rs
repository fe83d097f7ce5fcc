//! Choice of cameras: a name, a pattern, a range, or an index (which may come from an axis of numbers).

use engine::ParamType;
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
                to.write_str("text or an index from 0")
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Pick, E> {
                Ok(Pick(text.to_owned()))
            }
            fn visit_u64<E: serde::de::Error>(self, index: u64) -> Result<Pick, E> {
                let end = index.checked_add(1).ok_or_else(|| E::custom("no file has that many cameras"))?;
                Ok(Pick(format!("{index}..{end}")))
            }
            fn visit_i64<E: serde::de::Error>(self, index: i64) -> Result<Pick, E> {
                let index = u64::try_from(index).map_err(|_| E::custom("an index is at least 0"))?;
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
