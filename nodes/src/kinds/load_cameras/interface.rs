//! Parameters of `load-cameras`.

use engine::InputFile;
use scene::io::gltf::animation::AfterEnd;
use scene::types::pick::Pick;

engine::choices! {
    /// Treatment of lens distortion.
    pub enum Distortion {
        /// A camera with distortion is an error.
        Refuse,
        /// Rays and splats follow the lens, so that renders fit the photographs as they are.
        Apply,
        /// Distortion is ignored, and the result is marked as degraded.
        Ignore,
    }
}
engine::params! {
    /// Loads cameras from JSON, COLMAP, nerfstudio, INRIA or glTF files.
    ///
    /// The format is detected by content:
    ///
    /// - Lightharmony's own JSON: `{"views": [{"name": "view_0", "w": 512, "h": 384, "fx": 491.8, "fy": 491.8, "cx": 256.0,
    ///   "cy": 192.0, "c2w_opencv": [[..4], [..4], [..4], [..4]]}]}`. `c2w_opencv` has the rows of the matrix from
    ///   camera to world, for a camera with x right, y down and z forward. With `c2w_opengl` instead, y is up and z
    ///   backward.
    /// - A COLMAP model, as text or binary. Give its folder, or a folder that contains `sparse/0`.
    /// - `transforms.json` of nerfstudio, or `camera_path.json` of its viewer. A frame without a size has the size
    ///   of its picture.
    /// - `cameras.json` of INRIA, with the principal point `cx`, `cy` in pixels that some programs add.
    /// - The perspective cameras of a glTF or GLB scene. They are converted from the glTF frame (y up, metres) to
    ///   the world in the same way as objects. Their pictures are 1080 * `resolution` pixels high. With `clip`, an
    ///   animation of the file places them.
    ///
    /// Pixel centres are at +0.5 in all formats. Distortion (`k1`, `p1`, ..) is read in all JSON formats and COLMAP: radial
    /// and tangential (OpenCV), fisheye, field of view and division models. Distortion that moves no point of the picture
    /// by more than a twentieth of a pixel is ignored. A view is named after its picture, without folder and extension. If several
    /// pictures have the same name, their names include as many folders as are needed to distinguish them, for
    /// example `day1_IMG_0001`.
    pub struct LoadCameras {
        /// The cameras file, or the folder of a COLMAP model.
        path: InputFile, other("\"b.json\"");
        /// Cameras to load, in this order. An entry is the name or the path of a picture, with the wildcards `*`
        /// and `?`; a range of indices from 0, such as `2..5`, or `0..400..8` for every eighth camera; or a single
        /// index. The default is all cameras. To render one camera after the other, so that memory is bounded
        /// whatever their number, load all cameras and pick one with `pick-cameras`.
        pick: Vec<Pick> = Vec::new(), other("[\"0..1\"]");
        /// Name of the list in lightharmony's own JSON format.
        list: String = "views".to_owned(), other("\"cube_faces\""), inert("only lightharmony's own JSON has lists");
        /// Factor by which the width and height of the pictures are multiplied.
        resolution: f64 = 1.0, range(0.001, 64), other("0.5");
        /// Treatment of lens distortion.
        distortion: Distortion = Distortion::Refuse, other("Ignore"), inert("most files have no distortion");
        /// The file `dataparser_transforms.json` of a training run in nerfstudio, for splats exported from this
        /// run. It converts the cameras from the coordinates of the capture to the coordinates of the splats.
        /// COLMAP models and `transforms.json` need it; `camera_path.json` is already in the coordinates of the
        /// splats.
        dataparser: Option<InputFile> = None, other("Some(\"dataparser_transforms.json\")");
        /// Rotation, uniform scale and translation of the cameras: a 4x4 matrix in row-major order, as in
        /// `load-splats`.
        matrix: Option<[f64; 16]> = None, other("Some((0.0, -1.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))");
        /// Name of the animation of a glTF file that places its cameras. An animation without a name is named by its
        /// index, such as `"0"`. If not given, the cameras are placed as stored in the file.
        clip: Option<String> = None, other("Some(\"walk\")"), inert("most files have no animation");
        /// Time in the animation. Before its first key, the animation has the pose of this key.
        time_s: f64 = 0.0, range(0, 86400), unit("s"), other("0.5"), inert("needs `clip`");
        /// Treatment of times after the end of the animation.
        after_end: AfterEnd = AfterEnd::Refuse, other("Hold"), inert("needs `clip`");
    }
}
