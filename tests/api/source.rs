//! Modules of a crate as source text: their items, and the files that they re-export.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use syn::{Item, UseTree, Visibility};

/// The files of a crate, parsed.
type Sources = Vec<(PathBuf, syn::File)>;

thread_local! {
    /// The files of the crates that were read, by the folder of their sources.
    static CRATES: RefCell<BTreeMap<PathBuf, Rc<Sources>>> = RefCell::default();
}

/// A module: its file, and the folder with the files of its modules.
#[derive(Clone)]
pub struct Module {
    /// All files of the crate.
    pub files: Rc<Vec<(PathBuf, syn::File)>>,
    src: PathBuf,
    path: PathBuf,
    folder: PathBuf,
}

/// All files below a folder, except unit tests.
fn files_below(folder: &Path, found: &mut Vec<(PathBuf, syn::File)>) {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && name != "tests" {
            files_below(&path, found);
        } else if path.extension().is_some_and(|end| end == "rs") && name != "tests" {
            let text = std::fs::read_to_string(&path).unwrap();
            let file = syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            found.push((path, file));
        }
    }
}

impl Module {
    /// The crate whose sources are in the folder `src`.
    pub fn root(src: &Path) -> Self {
        let files = CRATES.with_borrow_mut(|known| {
            let parsed = known.entry(src.to_owned()).or_insert_with(|| {
                let mut files = Vec::new();
                files_below(src, &mut files);
                Rc::new(files)
            });
            parsed.clone()
        });
        Self { files, src: src.to_owned(), path: src.join("lib.rs"), folder: src.to_owned() }
    }

    fn at(&self, path: PathBuf, folder: PathBuf) -> Option<Self> {
        self.files.iter().any(|(known, _)| *known == path).then(|| Self { path, folder, ..self.clone() })
    }

    /// A module of this module that has a file of its own.
    pub fn child(&self, name: &str) -> Option<Self> {
        let folder = self.folder.join(name);
        self.at(folder.with_extension("rs"), folder.clone())
            .or_else(|| self.at(folder.join("mod.rs"), folder))
    }

    /// The content of the file.
    pub fn file(&self) -> &syn::File {
        &self.files.iter().find(|(path, _)| *path == self.path).expect("the module has a file").1
    }

    /// The public names of the module, those of functions, types, traits and constants, sorted.
    pub fn public(&self) -> Vec<String> {
        let mut names = BTreeSet::new();
        for item in &self.file().items {
            match item {
                Item::Use(item) if is_public(&item.vis) => {
                    names.extend(paths_of(&item.tree).into_iter().filter_map(|mut path| path.pop()));
                }
                other => names.extend(name_of(other)),
            }
        }
        names.into_iter().collect()
    }

    /// The module that defines a public item of this module, and the name there. Macros belong to the whole crate.
    pub fn find(&self, name: &str) -> Option<(Self, String)> {
        if let Some(macro_name) = name.strip_suffix('!') {
            let is_it = |item: &Item| matches!(item, Item::Macro(item) if item.ident.as_ref().is_some_and(|i| i == macro_name));
            let (path, _) = self.files.iter().find(|(_, file)| file.items.iter().any(is_it))?;
            return Some((self.at(path.clone(), path.with_extension(""))?, macro_name.to_owned()));
        }
        for item in &self.file().items {
            if name_of(item).as_deref() == Some(name) {
                return Some((self.clone(), name.to_owned()));
            }
            let Item::Use(item) = item else { continue };
            let paths = paths_of(&item.tree);
            let Some(path) = paths.iter().find(|path| path.last().is_some_and(|last| last == name)) else {
                continue;
            };
            if !is_public(&item.vis) {
                continue;
            }
            let (modules, _) = path.split_at(path.len() - 1);
            let mut place = self.clone();
            for part in modules {
                place = if part == "crate" { Self::root(&self.src) } else { place.child(part)? };
            }
            return place.find(name);
        }
        None
    }
}

fn is_public(vis: &Visibility) -> bool {
    matches!(vis, Visibility::Public(_))
}

/// The name of a public item.
fn name_of(item: &Item) -> Option<String> {
    let (vis, ident) = match item {
        Item::Const(item) => (&item.vis, &item.ident),
        Item::Enum(item) => (&item.vis, &item.ident),
        Item::Fn(item) => (&item.vis, &item.sig.ident),
        Item::Struct(item) => (&item.vis, &item.ident),
        Item::Trait(item) => (&item.vis, &item.ident),
        Item::Type(item) => (&item.vis, &item.ident),
        _ => return None,
    };
    is_public(vis).then(|| ident.to_string())
}

/// The paths that a `use` names, each as its parts.
fn paths_of(tree: &UseTree) -> Vec<Vec<String>> {
    let below = |first: String, tree: &UseTree| {
        paths_of(tree).into_iter().map(|path| [vec![first.clone()], path].concat()).collect()
    };
    match tree {
        UseTree::Path(path) => below(path.ident.to_string(), &path.tree),
        UseTree::Group(group) => group.items.iter().flat_map(paths_of).collect(),
        UseTree::Name(name) if name.ident == "self" => vec![vec![]],
        UseTree::Name(name) => vec![vec![name.ident.to_string()]],
        UseTree::Rename(name) => vec![vec![name.rename.to_string()]],
        UseTree::Glob(_) => vec![vec!["*".to_owned()]],
    }
}

/// The paths that the `use` items of a file name.
pub fn imports(path: &Path) -> Vec<String> {
    let file = syn::parse_file(&std::fs::read_to_string(path).unwrap()).unwrap();
    let uses =
        file.items.iter().filter_map(|item| if let Item::Use(item) = item { Some(item) } else { None });
    uses.flat_map(|item| paths_of(&item.tree)).map(|path| path.join("::")).collect()
}
