//! A case: an object to insert at a place of a scene, cameras, and the truth of each view.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::error::Mistakes;
use crate::fields::{Fields, finite, texts, three};
use crate::views::sizes;

/// Name of the file that describes a case.
pub const CASE_FILE: &str = "case.json";

/// A case whose files are present and consistent. Paths are absolute.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Name of the case and of its folder.
    pub name: String,
    /// Name of the scene. Cases of one scene are not independent of each other.
    pub scene: String,
    /// Words that describe the case, such as `lamp`.
    pub tags: Vec<String>,
    /// The object, a GLB file.
    pub object: PathBuf,
    /// Position of the origin of the object's file, in world units.
    pub translation: [f64; 3],
    /// Rotation about the up axis in degrees, counter-clockwise seen from above.
    pub yaw_deg: f64,
    /// Uniform scale.
    pub scale: f64,
    /// Point where the true light was rendered, in world units.
    pub probe: [f64; 3],
    /// The cameras of the scored views.
    pub cameras: PathBuf,
    /// Mesh of the scene without the object, if the case has one.
    pub mesh: Option<PathBuf>,
    /// The scene as splats, if the case has them.
    pub splats: Option<PathBuf>,
    /// The cameras of the photographs, if the case has photographs.
    pub capture: Option<PathBuf>,
    /// The true light at `probe`.
    pub light: PathBuf,
    /// The views, in the order of the tables.
    pub views: Vec<View>,
    /// True if every view has a mask of the shadow.
    pub shadow_masks: bool,
    /// True if every view has a mask of the reflection.
    pub reflection_masks: bool,
}

/// A view of a case.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Name of the view.
    pub name: String,
    /// Folder of the true pictures.
    pub truth: PathBuf,
    /// Width and height of its pictures, in pixels.
    pub size: [u64; 2],
}

impl View {
    /// The true picture with this file name.
    pub fn file(&self, name: &str) -> PathBuf {
        self.truth.join(name)
    }
}

/// Pictures that each view must have.
const TRUTH: [&str; 4] = ["without.exr", "with.exr", "alpha.exr", "depth.exr"];
/// File name of the mask of the shadow.
pub const SHADOW: &str = "shadow.png";
/// File name of the mask of the reflection.
pub const REFLECTION: &str = "reflection.png";

impl Case {
    /// Name of the case in the names of nodes.
    pub fn id(&self) -> String {
        self.name.replace('-', "_")
    }

    /// Reads a case and the headers of its pictures; `None` if a mistake was reported.
    pub(crate) fn load(set: &Path, name: &str, mistakes: &mut Mistakes) -> Option<Self> {
        let before = mistakes.0.len();
        let file = format!("{name}/{CASE_FILE}");
        let mut fields = Fields::read(&set.join(&file), &file, mistakes)?;
        fields.version("version");
        if let Some(other) = fields.name("name").filter(|other| other != name) {
            fields.wrong("name", format!("is `{other}`, but the folder is `{name}`; both must be equal"));
        }
        let scene = fields.name("scene");
        let tags = fields.required("tags", "a list of texts, which may be empty", texts);
        let path = |fields: &mut Fields<'_>, field, required| {
            let read = |value: &Value| value.as_str().map(str::to_owned);
            let what = "the path of a file, relative to the folder of the case";
            let text = if required {
                fields.required(field, what, read)
            } else {
                fields.optional(field, what, read)
            }?;
            match inside(set, name, &text) {
                Ok(path) => Some(path),
                Err(why) => {
                    fields.wrong(field, why);
                    None
                }
            }
        };
        let object = path(&mut fields, "object", true);
        let (mut translation, mut yaw_deg, mut scale) = (None, None, None);
        if let Some(mut pose) = fields.object("pose") {
            translation = pose.required("translation", "3 numbers in [ ]", three);
            yaw_deg = pose.required("yaw_deg", "a number, in degrees", finite);
            let size = |value: &Value| finite(value).filter(|scale| *scale > 0.0);
            scale = pose.required("scale", "a number above 0", size);
            pose.end();
        }
        let probe = fields.required("probe", "3 numbers in [ ]", three);
        let names = fields.names("views");
        let mesh = path(&mut fields, "mesh", false);
        let splats = path(&mut fields, "splats", false);
        let capture = path(&mut fields, "capture", false);
        fields.end();

        let folder = set.join(name);
        let cameras = folder.join("views.json");
        let sizes = sizes(&cameras, &format!("{name}/views.json"), &names, mistakes);
        let light = folder.join("truth/light.exr");
        check_light(&light, &format!("{name}/truth/light.exr"), mistakes);
        let mut views = Vec::new();
        let mut masks = [0, 0];
        for (view, size) in names.iter().zip(sizes) {
            let truth = folder.join("truth").join(view);
            let shown = |file: &str| format!("{name}/truth/{view}/{file}");
            for file in TRUTH {
                check_picture(&truth.join(file), &shown(file), size, mistakes);
            }
            for (file, count) in [SHADOW, REFLECTION].into_iter().zip(&mut masks) {
                if truth.join(file).exists() {
                    *count += 1;
                    check_picture(&truth.join(file), &shown(file), size, mistakes);
                }
            }
            views.push(View { name: view.clone(), truth, size: size.unwrap_or_default() });
        }
        for (file, count) in [SHADOW, REFLECTION].into_iter().zip(masks) {
            if count > 0 && count < names.len() {
                let text = format!(
                    "some views have `{file}` and others do not ({count} of {}); give it for all views or for none",
                    names.len()
                );
                mistakes.add(&format!("{name}/truth"), "", text);
            }
        }
        if masks[0] == 0 && masks[1] > 0 {
            let text = format!(
                "has `{REFLECTION}` but no `{SHADOW}`; give both, since a derived shadow contains reflections"
            );
            mistakes.add(&format!("{name}/truth"), "", text);
        }
        let all = |count| count > 0 && count == names.len();
        (mistakes.0.len() == before).then_some(())?;
        Some(Self {
            name: name.to_owned(),
            scene: scene?,
            tags: tags?,
            object: object?,
            translation: translation?,
            yaw_deg: yaw_deg?,
            scale: scale?,
            probe: probe?,
            cameras,
            mesh,
            splats,
            capture,
            light,
            views,
            shadow_masks: all(masks[0]),
            reflection_masks: all(masks[1]),
        })
    }
}

/// The file with the path `text`, relative to the folder `case` of the set.
fn inside(set: &Path, case: &str, text: &str) -> Result<PathBuf, String> {
    let mut depth = 1_i32;
    for part in text.split('/') {
        match part {
            ".." => depth -= 1,
            "." | "" => {}
            _ => depth += 1,
        }
        if depth < 0 || text.starts_with('/') || text.contains('\\') || text.contains(':') {
            return Err(format!("`{text}` leads out of the set; write a relative path with `/`"));
        }
    }
    let path = set.join(case).join(text);
    if path.exists() {
        Ok(path)
    } else {
        Err(format!("`{text}` does not exist; add the file or correct the path"))
    }
}

fn check_picture(path: &Path, file: &str, size: Option<[u64; 2]>, mistakes: &mut Mistakes) {
    if !path.is_file() {
        return mistakes.add(file, "", "does not exist");
    }
    match (scene::io::picture::size(path), size) {
        (None, _) => mistakes.add(file, "", "is not a picture, or its header is damaged"),
        (Some([w, h]), Some([width, height])) if [w, h] != [width, height] => {
            let text = format!("has {w}x{h} pixels, but its camera in `views.json` has {width}x{height}");
            mistakes.add(file, "", text);
        }
        _ => {}
    }
}

fn check_light(path: &Path, file: &str, mistakes: &mut Mistakes) {
    if !path.is_file() {
        return mistakes.add(file, "", "does not exist");
    }
    match scene::io::picture::size(path) {
        None => mistakes.add(file, "", "is not a picture, or its header is damaged"),
        Some([width, height]) if width != 2 * height => {
            mistakes.add(
                file,
                "",
                format!("has {width}x{height} pixels; the width must be twice the height"),
            );
        }
        Some(_) => {}
    }
}
