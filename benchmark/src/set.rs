//! A set of cases: `set.json` and the folders of its cases, read and checked as a whole.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::nearest;
use serde_json::Value;

use crate::case::Case;
use crate::error::{Error, Mistakes};
use crate::fields::{Fields, finite, is_name};

/// Name of the file that describes a set.
pub const SET_FILE: &str = "set.json";

/// A set whose files are present and consistent.
#[derive(Debug, Clone, PartialEq)]
pub struct Set {
    /// Folder of the set, absolute.
    pub folder: PathBuf,
    /// Name of the set.
    pub name: String,
    /// Version of the set, as its author counts.
    pub version: String,
    /// Seed from which the set was made.
    pub seed: u64,
    /// Licence of the files.
    pub licence: String,
    /// Axis that points up: `+z`, `+y` or `-y`.
    pub up: String,
    /// Length of a unit in metres.
    pub metres_per_unit: f64,
    /// The cases, in the order of `set.json`.
    pub cases: Vec<Case>,
}

impl Set {
    /// Reads a set and the headers of its pictures. Digests are not compared; see [`crate::checksums`].
    ///
    /// # Errors
    /// [`Error::Set`] with all mistakes.
    pub fn load(folder: &Path) -> Result<Self, Error> {
        let mut mistakes = Mistakes::default();
        let whole = |mistakes| Error::Set { folder: folder.display().to_string(), mistakes };
        let absolute = match folder.canonicalize() {
            Ok(folder) => folder,
            Err(error) => {
                mistakes.add(
                    SET_FILE,
                    "",
                    format!("cannot be read: {error}; give the path of the folder that contains the set"),
                );
                return Err(whole(mistakes));
            }
        };
        let Some((mut set, names)) = head(&absolute, &mut mistakes) else { return Err(whole(mistakes)) };
        for name in names.iter().filter(|name| is_name(name)) {
            set.cases.extend(Case::load(&absolute, name, &mut mistakes));
        }
        let mut ids: BTreeMap<String, &str> = BTreeMap::new();
        for name in &names {
            if let Some(other) = ids.insert(name.replace('-', "_"), name)
                && other != name
            {
                let text = format!("`{name}` and `{other}` differ only in `-` and `_`; rename one of them");
                mistakes.add(SET_FILE, "cases", text);
            }
        }
        if mistakes.0.is_empty() { Ok(set) } else { Err(whole(mistakes)) }
    }

    /// Keeps only the named cases, in the order of the set. All cases are kept if `names` is empty.
    ///
    /// # Errors
    /// [`Error::NoCase`] for a name that the set does not have.
    pub fn only(mut self, names: &[String]) -> Result<Self, Error> {
        let known = || self.cases.iter().map(|case| case.name.as_str());
        for name in names {
            if !known().any(|case| case == name) {
                let near = nearest(name, known()).map(str::to_owned);
                let known = known().collect::<Vec<_>>().join(", ");
                return Err(Error::NoCase { name: name.clone(), near, known });
            }
        }
        self.cases.retain(|case| names.is_empty() || names.contains(&case.name));
        Ok(self)
    }
}

/// The fields of `set.json`, and the names of the cases.
fn head(folder: &Path, mistakes: &mut Mistakes) -> Option<(Set, Vec<String>)> {
    let mut fields = Fields::read(&folder.join(SET_FILE), SET_FILE, mistakes)?;
    fields.version("lightharmony_bench");
    let name = fields.name("name");
    let version = fields.text("version");
    let seed = fields.required("seed", "a whole number of at least 0", Value::as_u64);
    let licence = fields.text("licence");
    let axis = |value: &Value| value.as_str().filter(|up| ["+z", "+y", "-y"].contains(up)).map(str::to_owned);
    let up = fields.required("up", "\"+z\", \"+y\" or \"-y\"", axis);
    let metres = |value: &Value| finite(value).filter(|metres| *metres > 0.0);
    let metres_per_unit = fields.required("metres_per_unit", "a number above 0", metres);
    let names = fields.names("cases");
    fields.optional("about", "a text", |value| value.as_str().map(str::to_owned));
    fields.end();
    let set = Set {
        folder: folder.to_owned(),
        name: name.unwrap_or_default(),
        version: version.unwrap_or_default(),
        seed: seed.unwrap_or_default(),
        licence: licence.unwrap_or_default(),
        up: up.unwrap_or_default(),
        metres_per_unit: metres_per_unit.unwrap_or(1.0),
        cases: Vec::new(),
    };
    Some((set, names))
}
