//! `run-program`: splats or a mesh from another program.

mod arguments;
mod inputs;
#[cfg(all(test, unix))]
mod tests;

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, Digest, InputFile, Kind, NodeError, Notes, SourceFile, SourceRoot, Wired,
};
use scene::io::splats::{Frame, from_bytes};
use scene::io::surface::{clean, from_ply};
use scene::types::{Mesh, Photos, Splats};

use crate::program::{Call, WorkFolder, find, fraction_in, run, stays_inside};

engine::params! {
    /// Runs an installed program, such as a trainer of splats, and reads the splats or the mesh that it writes.
    ///
    /// The program runs in a temporary folder of its own, which contains the inputs that are connected:
    ///
    /// - `photos`: a folder with `images/NAME.png`, a binary COLMAP model in `sparse/0`, and `masks/NAME.png` for
    ///   photographs with masked pixels (black).
    /// - `splats.ply`: splats as INRIA PLY.
    /// - `mesh.ply`: a mesh as binary PLY, without the gloss of `set-gloss`.
    /// - `files`: copies of `files`.
    /// - `out`: an empty folder for the outputs.
    ///
    /// Coordinates are those of the scene, in both directions. `arguments` is a list, which no shell reads. In each
    /// argument, `{photos}`, `{splats}`, `{mesh}`, `{files}` and `{out}` are replaced by the absolute paths of these
    /// files and folders; `{{` and `}}` stand for braces.
    ///
    /// The result is stored like any other, with a key that contains the content of the program's file and of all
    /// inputs. But no program is expected to give the same bytes twice, or on another machine: the node is never
    /// computed elsewhere, its result is not shared, and `verify` reports it as `external`. A graph from others cannot
    /// run programs.
    pub struct RunProgram {
        /// The program: a name that is searched in `PATH`, or a path with a `/`, relative to the graph file.
        program: String, other("\"./stand-in-b.sh\"");
        /// The arguments of the program.
        arguments: Vec<String> = Vec::new(), other("[\"{photos}\", \"{out}\", \"other\"]");
        /// The file of splats that the program writes: a path in the folder `out`. Any format that `load-splats` reads
        /// from a single file.
        splats_file: Option<String> = None, other("Some(\"other.ply\")");
        /// The file of a mesh that the program writes, as PLY: a path in the folder `out`.
        mesh_file: Option<String> = None, other("Some(\"other-mesh.ply\")");
        /// BLAKE3 digest that the file of splats must have, in hexadecimal. A note of each run states the digest.
        splats_digest: Option<String> = None, inert("a digest is only compared");
        /// BLAKE3 digest that the file of the mesh must have.
        mesh_digest: Option<String> = None, inert("a digest is only compared");
        /// Further files that the program reads, such as settings or weights. Their names must differ.
        files: Vec<InputFile> = Vec::new(), other("[\"env.exr\"]");
        /// Version of the program, if its file does not contain all of it: a Python script, for example, uses
        /// packages. A new version makes the program run again.
        version: String = String::new(), other("\"2\""), inert("the version only enters the key");
    }
}
engine::inputs! {
    /// Inputs of [`RunProgram`].
    pub struct In {
        /// Photographs with cameras and points.
        photos: Option<Arc<Photos>>,
        /// Splats, to continue or to convert.
        splats: Option<Arc<Splats>>,
        /// A mesh.
        mesh: Option<Arc<Mesh>>,
    }
}
engine::outputs! {
    /// Outputs of [`RunProgram`].
    pub struct Out {
        /// The splats of `splats_file`.
        splats: Arc<Splats>,
        /// The mesh of `mesh_file`.
        mesh: Arc<Mesh>,
    }
}

impl Kind for RunProgram {
    const NAME: &'static str = "run-program";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const PROFILE: &'static str = "external";
    const RUNS_PROGRAMS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.program.trim().is_empty() {
            return Err(NodeError::new("`program` is empty").at("program"));
        }
        arguments::check(&p.arguments).map_err(|e| e.at("arguments"))?;
        if p.splats_file.is_none() && p.mesh_file.is_none() {
            return Err(NodeError::new("the node has no output")
                .at("program")
                .hint("set `splats_file` or `mesh_file` to the file that the program writes in `{out}`"));
        }
        for (field, file, pin, digest) in [
            ("splats_file", &p.splats_file, "splats_digest", &p.splats_digest),
            ("mesh_file", &p.mesh_file, "mesh_digest", &p.mesh_digest),
        ] {
            if let Some(file) = file.as_ref().filter(|file| !stays_inside(file)) {
                let what = format!("the output `{file}` is not a path inside the folder `out`");
                let hint = "write a relative path without `..`, such as `result/splats.ply`";
                return Err(NodeError::new(what).at(field).hint(hint));
            }
            if let Some(text) = digest {
                if Digest::from_hex(text).is_none() {
                    let what = format!("`{text}` is not a BLAKE3 digest, which has 64 hexadecimal digits");
                    return Err(NodeError::new(what).at(pin));
                }
                if file.is_none() {
                    return Err(
                        NodeError::new(format!("there is no `{field}` that could have this digest")).at(pin)
                    );
                }
            }
        }
        inputs::names(&p.files).map(|_| ())
    }

    fn check_wires(p: &Self, wired: &Wired) -> Result<(), NodeError> {
        for port in ["photos", "splats", "mesh"] {
            let (is_used, is_wired) = (arguments::uses(&p.arguments, port), !wired.of(port).is_empty());
            if is_used && !is_wired {
                let what =
                    format!("an argument contains `{{{port}}}`, but the input `{port}` is not connected");
                return Err(NodeError::new(what).at("arguments"));
            }
            if is_wired && !is_used {
                let what = format!("the input `{port}` is connected, but no argument contains `{{{port}}}`");
                return Err(NodeError::new(what)
                    .at(port)
                    .hint("remove the wire, or pass the path to the program"));
            }
        }
        Ok(())
    }

    fn check_output(p: &Self, output: &'static str) -> Result<(), NodeError> {
        let (file, field) = match output {
            "splats" => (&p.splats_file, "splats_file"),
            _ => (&p.mesh_file, "mesh_file"),
        };
        if file.is_some() {
            return Ok(());
        }
        let what = format!("the node has no output `{output}`, since its `{field}` is not set");
        Err(NodeError::new(what)
            .hint(format!("set `{field}` to the file that the program writes in `{{out}}`")))
    }

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let find = || find(&p.program, root.folder()).map_err(missing);
        let mut sources = vec![root.program(&p.program, find)?];
        sources.extend(p.files.iter().map(|file| root.file(file)));
        Ok(sources)
    }

    fn estimate(_: &Self, inputs: &In) -> Cost {
        // One picture at a time; splats and meshes as whole files.
        let photos = inputs.photos.iter().flat_map(|photos| &photos.photos);
        let pixels = photos.map(|photo| photo.pixels.len() as u64 * 12).max().unwrap_or(0);
        let splats = inputs.splats.as_ref().map_or(0, |splats| splats.len() as u64 * 300);
        let mesh = inputs.mesh.as_ref().map_or(0, |mesh| mesh.positions.len() as u64 * 60);
        Cost { bytes: pixels.saturating_add(splats).saturating_add(mesh) }
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let folder = WorkFolder::new()?;
        let given = inputs::Given {
            photos: inputs.photos.as_deref(),
            splats: inputs.splats.as_deref(),
            mesh: inputs.mesh.as_deref(),
            files: &p.files,
        };
        inputs::write(&given, &folder, cx)?;
        drop(inputs);
        cx.progress(0.05);
        let program = find(&p.program, cx.root().folder()).map_err(missing)?;
        let call = Call {
            name: &p.program,
            program: &program,
            arguments: arguments::filled(&p.arguments, folder.path()),
            environment: &[],
        };
        let mut done = 0.0_f32;
        let last = run(call, &folder, cx, &mut |line| {
            // Programs have several bars; the progress of the node does not go back.
            done = fraction_in(line).map_or(done, |fraction| done.max(fraction));
            cx.progress(0.05 + 0.85 * done);
        })
        .map_err(|e| NodeError::from(e).at("program"))?;
        let mut notes = Notes::none();
        let read =
            |field: &'static str, file: &Option<String>, digest: &Option<String>, notes: &mut Notes| {
                let Some(file) = file else { return Ok(None) };
                let bytes =
                    folder.output(file, &p.program, &last).map_err(|e| NodeError::from(e).at(field))?;
                pinned(field, file, &bytes, digest.as_deref(), notes)?;
                Ok::<_, NodeError>(Some((file.clone(), bytes)))
            };
        let splats = match read("splats_file", &p.splats_file, &p.splats_digest, &mut notes)? {
            Some((file, bytes)) => {
                let (splats, found) =
                    from_bytes(&file, &bytes, Frame::ByFormat, cx).map_err(|e| e.at("splats_file"))?;
                notes = notes.iter().chain(found.iter()).cloned().collect();
                if splats.is_empty() {
                    notes.degraded("no-splats", "the scene contains no splat that can be drawn");
                }
                splats
            }
            None => Splats::empty(),
        };
        let mesh = match read("mesh_file", &p.mesh_file, &p.mesh_digest, &mut notes)? {
            Some((file, bytes)) => {
                let mesh = from_ply(&file, &bytes, cx, &mut notes)
                    .and_then(|raw| clean(&file, raw, true, cx, &mut notes));
                mesh.map_err(|e| e.at("mesh_file"))?
            }
            None => Mesh::default(),
        };
        cx.count("splats", splats.len() as u64);
        cx.count("triangles", mesh.triangles.len() as u64);
        Ok((Out { splats: Arc::new(splats), mesh: Arc::new(mesh) }, notes))
    }
}

fn missing(error: crate::program::ProgramError) -> NodeError {
    NodeError::from(error)
        .at("program")
        .hint("install it, or write its path with a `/`: `program: \"/opt/brush/brush\"`")
}

/// Compares an output file with the digest that the graph states, and reports its digest.
fn pinned(
    field: &'static str,
    file: &str,
    bytes: &[u8],
    digest: Option<&str>,
    notes: &mut Notes,
) -> Result<(), NodeError> {
    let (found, pin) = (Digest::of(bytes), field.replace("_file", "_digest"));
    match digest.and_then(Digest::from_hex) {
        Some(stated) if stated != found => {
            let what = format!("the output `{file}` has the digest {found}, but `{pin}` is {stated}");
            Err(NodeError::new(what).at(field).hint(
                "few programs give the same bytes again; to accept the new result, remove the digest or replace it",
            ))
        }
        Some(_) => Ok(()),
        None => {
            let text =
                format!("`{file}` has the digest {found}; `{pin}: Some(\"..\")` accepts only this result");
            notes.decision("output-digest", text);
            Ok(())
        }
    }
}
