//! The steps of a reconstruction.

use std::ffi::OsString;

use engine::{Context, NodeError};

use super::choices::{Lens, Matching};
use super::tool::Tool;
use crate::program::{Call, ProgramError, WorkFolder, fraction_in, run};

/// Settings of a reconstruction.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    pub lens: Lens,
    pub matching: Matching,
    pub same_camera: bool,
    pub largest_side_px: u32,
}

/// A reconstruction in a folder that contains the photographs.
pub struct Steps<'a> {
    pub options: Options,
    pub tool: &'a Tool,
    pub folder: &'a WorkFolder,
    /// Number of photographs.
    pub photographs: usize,
    pub cx: &'a Context,
}

/// Which of several separate reconstructions is used.
pub struct Chosen {
    /// Number of the others.
    pub others: usize,
}

/// The program of a step with `pycolmap`.
const PYTHON: &str = include_str!("steps.py");
/// A program with windows must not look for a display.
const ENVIRONMENT: &[(&str, &str)] = &[("QT_QPA_PLATFORM", "offscreen"), ("PYTHONUNBUFFERED", "1")];

impl Steps<'_> {
    /// The version of the program, as it states it.
    pub fn version(&self) -> Result<String, NodeError> {
        let (arguments, prefix) = match self.tool {
            Tool::Program(_) => (vec!["help"], ""),
            Tool::Python { .. } => (vec!["-c", "import pycolmap; print(pycolmap.__version__)"], "pycolmap "),
        };
        let mut version = None;
        self.call("version", arguments, &mut |line| {
            version.get_or_insert_with(|| {
                let short = line.split(" -- ").next().unwrap_or(line);
                format!("{prefix}{short}")
            });
        })?;
        Ok(version.unwrap_or_else(|| "unknown".to_owned()))
    }

    /// Finds features, matches, poses and points, and undistorts the photographs.
    ///
    /// # Errors
    /// If a step fails, or if no two photographs overlap.
    pub fn reconstruct(&self) -> Result<Chosen, NodeError> {
        self.features()?;
        self.matches()?;
        self.folder.create("sparse")?;
        self.mapping()?;
        let (largest, others) = self.largest_model().ok_or_else(nothing_found)?;
        self.undistort(&largest)?;
        Ok(Chosen { others })
    }

    fn features(&self) -> Result<(), NodeError> {
        let lens = match self.options.lens {
            Lens::SimpleRadial => "SIMPLE_RADIAL",
            Lens::OpenCv => "OPENCV",
            Lens::OpenCvFisheye => "OPENCV_FISHEYE",
            Lens::Pinhole => "PINHOLE",
        };
        let same = if self.options.same_camera { "1" } else { "0" };
        let gpu = self.gpu_option("feature_extractor", ["FeatureExtraction", "SiftExtraction"])?;
        let program = vec![
            "feature_extractor",
            "--database_path",
            "database.db",
            "--image_path",
            "photos",
            "--ImageReader.camera_model",
            lens,
            "--ImageReader.single_camera",
            same,
            &gpu,
            "0",
        ];
        self.step("features", lens, program, None, [0.02, 0.2])
    }

    fn matches(&self) -> Result<(), NodeError> {
        let matcher = match self.options.matching {
            Matching::Exhaustive => "exhaustive_matcher",
            Matching::Sequential => "sequential_matcher",
        };
        let gpu = self.gpu_option(matcher, ["FeatureMatching", "SiftMatching"])?;
        let program = vec![matcher, "--database_path", "database.db", &gpu, "0"];
        self.step("matches", "", program, None, [0.2, 0.5])
    }

    fn mapping(&self) -> Result<(), NodeError> {
        let program = vec![
            "mapper",
            "--database_path",
            "database.db",
            "--image_path",
            "photos",
            "--output_path",
            "sparse",
        ];
        match self.step("mapping", "", program, None, [0.5, 0.9]) {
            // COLMAP 3 fails without a reason if it finds no first pair.
            Err(error) if !error.is_cancelled() && self.largest_model().is_none() => {
                Err(NodeError::new(format!("{}: {error}", nothing_found())).at("path").hint(OVERLAP))
            }
            other => other,
        }
    }

    fn undistort(&self, model: &str) -> Result<(), NodeError> {
        let (path, side) = (format!("sparse/{model}"), self.options.largest_side_px.to_string());
        let program = vec![
            "image_undistorter",
            "--image_path",
            "photos",
            "--input_path",
            &path,
            "--output_path",
            "out",
            "--output_type",
            "COLMAP",
            "--max_image_size",
            &side,
        ];
        self.step("undistortion", "", program, Some(&path), [0.9, 0.97])
    }

    /// The folder of the model with the most photographs below `sparse`, and the number of other models.
    fn largest_model(&self) -> Option<(String, usize)> {
        let folders = std::fs::read_dir(self.folder.path().join("sparse")).ok()?;
        let images = |path: std::path::PathBuf| {
            let name = path.file_name()?.to_str()?.to_owned();
            let bytes = std::fs::read(path.join("images.bin")).ok()?;
            Some((bytes.first_chunk().map_or(0, |count| u64::from_le_bytes(*count)), name))
        };
        let mut models: Vec<(u64, String)> = folders.filter_map(|entry| images(entry.ok()?.path())).collect();
        models.sort_by(|a, b| b.0.cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
        let (count, name) = models.first()?.clone();
        (count > 0).then(|| (name, models.len() - 1))
    }

    /// The option that switches the GPU off, whose name depends on the version.
    fn gpu_option(&self, command: &str, names: [&str; 2]) -> Result<String, NodeError> {
        let mut newer = false;
        if let Tool::Program(_) = self.tool {
            let first = format!("{}.use_gpu", names[0]);
            self.call(command, vec![command, "--help"], &mut |line| newer |= line.contains(&first))?;
        }
        Ok(format!("--{}.use_gpu", names[usize::from(!newer)]))
    }

    /// Runs a step, which takes the range `span` of the node's progress.
    fn step(
        &self,
        name: &str,
        lens: &str,
        program: Vec<&str>,
        model: Option<&str>,
        span: [f32; 2],
    ) -> Result<(), NodeError> {
        let side = self.options.largest_side_px.to_string();
        let arguments = match self.tool {
            Tool::Program(_) => program,
            Tool::Python { .. } => {
                let same = if self.options.same_camera { "1" } else { "0" };
                let matching = match self.options.matching {
                    Matching::Exhaustive => "exhaustive",
                    Matching::Sequential => "sequential",
                };
                let mut arguments = vec!["-c", PYTHON, name, lens, same, matching, &side];
                arguments.extend(model);
                arguments
            }
        };
        let (mut done, mut placed) = (0.0_f32, 0_usize);
        self.cx.progress(span[0]);
        self.call(name, arguments, &mut |line| {
            // The mapper states each photograph that it places; the other steps state a fraction.
            if line.contains("Registering image") {
                placed += 1;
                done = placed as f32 / self.photographs as f32;
            } else if name != "mapping" && line.contains('[') {
                done = fraction_in(line).map_or(done, |fraction| done.max(fraction));
            }
            self.cx.progress(span[0] + (span[1] - span[0]) * done.min(1.0));
        })
        .map(|_| ())
    }

    /// Calls the program. Returns the last lines of its output.
    fn call(
        &self,
        step: &str,
        arguments: Vec<&str>,
        line: &mut dyn FnMut(&str),
    ) -> Result<String, NodeError> {
        let program = match self.tool {
            Tool::Program(path) => path,
            Tool::Python { python, .. } => python,
        };
        let call = Call {
            name: &format!("COLMAP ({step})"),
            program,
            arguments: arguments.into_iter().map(OsString::from).collect(),
            environment: ENVIRONMENT,
        };
        run(call, self.folder, self.cx, line).map_err(|error| {
            let hint = matches!(error, ProgramError::Failed { .. }).then_some(
                "check that the photographs open in a viewer; COLMAP 3.8 and pycolmap 4.2 are tested",
            );
            let error = NodeError::from(error).at("path");
            match hint {
                Some(hint) => error.hint(hint),
                None => error,
            }
        })
    }
}

const OVERLAP: &str =
    "photographs of one place must overlap by more than half, from different positions, and be sharp";

fn nothing_found() -> NodeError {
    NodeError::new("COLMAP found no two photographs that show the same points from different positions")
        .at("path")
        .hint(OVERLAP)
}
