//! `run-ocio`: colours converted by an installed OpenColorIO.

mod pixels;
#[cfg(all(test, unix))]
mod tests;
mod tool;

use std::ffi::OsString;
use std::sync::Arc;

use engine::{Context, Cost, InputFile, Kind, NodeError, Notes, SourceFile, SourceRoot, ViewCount};
use scene::types::{Images, NamedImage};
use serde::Deserialize;

use crate::program::{Call, ProgramError, WorkFolder, run};
use pixels::{Encoded, bytes_of, picture_of};
use tool::Tool;

engine::params! {
    /// Converts the colours of pictures with OpenColorIO, which must be installed as a Python package.
    ///
    /// The conversion is the one of a configuration: from one of its spaces to another, or to a view of a display. `from`
    /// and `to` are the working space, linear Rec.709, unless they name a space of the configuration. With a `display`, the
    /// result is display-encoded, and `write-image` writes its codes into a PNG as they are; a display whose codes are
    /// those of sRGB gives the colours of the view. With `to: None` the result is linear light. With another `to` it is
    /// data, and `write-exr` writes its numbers as they are.
    ///
    /// Load a plate in a space that `load-image` does not know with `encoding: Data`, and name its space in `from`, which
    /// data needs. Files state sRGB for every display, so a display and view without `sRGB` in their names give a warning.
    /// Numbers are those that OpenColorIO computes in 32-bit floats without its lossy optimisations. Alpha stays as it
    /// is; colours are divided by it before the conversion and multiplied by it afterwards.
    ///
    /// OpenColorIO runs in a process and a temporary folder of its own, without the variables of the environment. A
    /// configuration that needs other files, such as lookup tables, must be an archive (`.ocioz`, made by the program
    /// `ocioarchive`). The result is stored like any other, with a key that contains the configuration and the content of
    /// the library. But OpenColorIO is not expected to give the same bits on another machine: the node is never computed
    /// elsewhere, its result is not shared, and `verify` reports it as `external`. A graph from others cannot run programs.
    pub struct RunOcio {
        /// The configuration: an `.ocio` file, or an `.ocioz` archive with all files that it needs. `None` uses `builtin`.
        config: Option<InputFile> = None, other("Some(\"other.ocio\")"), inert("the program reads it");
        /// Address of a configuration that OpenColorIO contains.
        builtin: String = "ocio://cg-config-v2.1.0_aces-v1.3_ocio-v2.3".to_owned(), other("\"ocio://default\""), inert("the program reads it");
        /// The space of the pictures: a name, an alias or a role of the configuration. `None` is linear Rec.709, and
        /// display-encoded pictures are decoded first.
        from: Option<String> = None, other("Some(\"ACEScg\")"), inert("the program converts");
        /// The space of the result: a name, an alias or a role of the configuration. `None` is linear Rec.709.
        to: Option<String> = None, other("Some(\"ACEScg\")");
        /// The display of the result, in place of `to`.
        display: Option<String> = None, other("Some(\"Other\")"), inert("the program converts");
        /// The view of the display. `None` is the default view of the display.
        view: Option<String> = None, other("Some(\"Other\")"), inert("the program converts");
        /// The Python instead of `python3`: a name or a path with a `/`, relative to the graph file.
        program: Option<String> = None, other("Some(\"./ocio-b.sh\")");
    }
}
engine::inputs! {
    /// Inputs of [`RunOcio`].
    pub struct In {
        /// The pictures.
        image: Arc<Images>,
    }
}
engine::outputs! {
    /// Outputs of [`RunOcio`].
    pub struct Out {
        /// The converted pictures.
        image: Arc<Images>,
    }
}

/// Report of OpenColorIO.
#[derive(Deserialize)]
struct Done {
    version: String,
    from: String,
    to: String,
}

/// A mistake that OpenColorIO found in the request.
#[derive(Deserialize)]
struct Mistake {
    field: String,
    message: String,
    near: Vec<String>,
}

/// The code that the Python runs.
const CODE: &str = include_str!("convert.py");

impl Kind for RunOcio {
    const NAME: &'static str = "run-ocio";
    const VERSION: u32 = 1;
    const PROFILE: &'static str = "external";
    const RUNS_PROGRAMS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.display.is_some() && p.to.is_some() {
            let what = "the result is either in the space `to` or for a `display`, not both";
            return Err(NodeError::new(what).at("to").hint("remove one of them"));
        }
        if p.view.is_some() && p.display.is_none() {
            return Err(NodeError::new("a `view` belongs to a `display`").at("view").hint("set `display`"));
        }
        if p.from.is_none() && p.to.is_none() && p.display.is_none() {
            return Err(NodeError::new("the node converts nothing: `from` and `to` are the same space")
                .at("to")
                .hint("name a space of the configuration in `from` or `to`, or set `display`"));
        }
        if !p.builtin.starts_with("ocio://") {
            let what = format!("`{}` is not the address of a built-in configuration", p.builtin);
            let hint = "write `ocio://` and its name; a file belongs in `config`";
            return Err(NodeError::new(what).at("builtin").hint(hint));
        }
        let is_named = |config: &InputFile| config.0.ends_with(".ocio") || config.0.ends_with(".ocioz");
        if let Some(config) = p.config.as_ref().filter(|config| !is_named(config)) {
            let what = format!("`{}` is not an OpenColorIO configuration", config.0);
            return Err(NodeError::new(what).at("config").hint("its name must end in `.ocio` or `.ocioz`"));
        }
        Ok(())
    }

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let find = || Tool::find(p.program.as_deref(), root).map(|tool| tool.identity);
        let mut sources = vec![root.program("opencolorio", find)?];
        sources.extend(p.config.iter().map(|file| root.file(file)));
        Ok(sources)
    }

    fn views(_: &Self, _: &SourceRoot) -> ViewCount {
        ViewCount::As(&["image"])
    }

    fn estimate(_: &Self, inputs: &In) -> Cost {
        // The bytes for the program and from it, in both processes, and the result.
        Cost::of(inputs.image.0.iter().map(|view| (view.picture.samples().len() as u64, 20)))
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let folder = WorkFolder::new()?;
        let mut files = Vec::with_capacity(inputs.image.0.len());
        for (number, view) in inputs.image.0.iter().enumerate() {
            cx.check()?;
            let file = format!("{number}.f32");
            folder.write(&file, &bytes_of(&view.picture, p.from.is_none())?)?;
            files.push(file);
        }
        let last = p.convert(&files, &folder, cx)?;
        let mut notes = Notes::none();
        let read = |name: &str| {
            folder.output(name, "opencolorio", &last).map_err(|e| NodeError::from(e).at("program"))
        };
        let done: Done = serde_json::from_slice(&read("done.json")?)?;
        notes.decision("ocio", format!("OpenColorIO {}: {} to {}", done.version, done.from, done.to));
        // In some configurations, the name of the view states the display.
        if p.display.is_some() && !done.to.to_ascii_lowercase().contains("srgb") {
            let text = format!(
                "the codes may not be those of sRGB ({}), but files state sRGB: show them on that display without colour management, or tag them in another program",
                done.to
            );
            notes.warning("display-not-srgb", text);
        }
        let (mut views, mut broken) = (Vec::with_capacity(files.len()), 0);
        for (view, file) in inputs.image.0.iter().zip(&files) {
            cx.check()?;
            let (picture, lost) = picture_of(&view.picture, &read(file)?, p.encoded())?;
            broken += lost;
            views.push(NamedImage { name: view.name.clone(), picture });
        }
        if broken > 0 {
            notes.count("ocio-not-finite", broken, "of the converted numbers were not finite and count as 0");
        }
        Ok((Out { image: Arc::new(Images(views)) }, notes))
    }
}

impl RunOcio {
    /// Encoding of the result.
    fn encoded(&self) -> Encoded {
        match (&self.display, &self.to) {
            (Some(_), _) => Encoded::Display,
            (None, None) => Encoded::Linear,
            (None, Some(_)) => Encoded::Data,
        }
    }

    /// Runs OpenColorIO on files of the folder. Returns the last lines of its output.
    fn convert(&self, files: &[String], folder: &WorkFolder, cx: &Context) -> Result<String, NodeError> {
        let config = match &self.config {
            Some(file) => {
                let name = if file.0.ends_with('z') { "config.ocioz" } else { "config.ocio" };
                folder.write(name, &cx.read(file).map_err(|e| e.at("config"))?)?;
                name
            }
            None => &self.builtin,
        };
        let request = serde_json::json!({
            "config": config, "from": self.from, "to": self.to, "display": self.display, "view": self.view, "files": files,
        });
        let code = folder.write("convert.py", CODE.as_bytes())?;
        let request = folder.write("request.json", request.to_string().as_bytes())?;
        let tool = Tool::find(self.program.as_deref(), cx.root())?;
        let call = Call {
            name: "opencolorio",
            program: &tool.python,
            arguments: [code, request].map(OsString::from).into(),
            environment: &[],
        };
        let last = run(call, folder, cx, &mut |_| ()).map_err(|e| NodeError::from(e).at("program"))?;
        match folder.output("mistake.json", "opencolorio", &last) {
            Err(ProgramError::NoOutput { .. }) => Ok(last),
            Err(error) => Err(NodeError::from(error).at("program")),
            Ok(mistake) => Err(self.mistake(serde_json::from_slice(&mistake)?)),
        }
    }

    /// The error for a mistake.
    fn mistake(&self, Mistake { field, message, near }: Mistake) -> NodeError {
        let fields = ["from", "to", "display", "view", "builtin"];
        let place = fields.into_iter().find(|one| *one == field).unwrap_or("config");
        let error = NodeError::new(format!("OpenColorIO: {message}")).at(place);
        let names: Vec<String> = near.iter().map(|name| format!("`{name}`")).collect();
        match field.as_str() {
            "config" => error.hint("`ociocheck --iconfig` of OpenColorIO lists all mistakes of a configuration"),
            "files" => error.hint(
                "a configuration that needs other files must be an archive: `ocioarchive all --iconfig config.ocio` writes `all.ocioz`",
            ),
            "builtin" => error.hint("`ociocheck --help` of OpenColorIO lists the built-in configurations of the installed version"),
            "from" | "to" if near.is_empty() => error.hint(format!("name the space in `{field}`")),
            _ => error.hint(format!("write one of its names, such as {}", names.join(", "))),
        }
    }
}
