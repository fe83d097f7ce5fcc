//! Parameters, inputs and outputs of `path-trace`.

use std::sync::Arc;

use scene::types::{Environment, Images, Mesh, Placed, Report, Rig, Splats};

use super::surroundings::Surroundings;

engine::params! {
    /// Path-traces the receiver without and with the objects, and the objects themselves.
    ///
    /// `with` is `without` plus the change due to the objects, so their ratio is exactly 1 where nothing changes.
    /// In `with`, the objects are hidden only from the camera. `object` is premultiplied; its alpha is the share of
    /// the pixel that the objects cover, without the part that the receiver hides. In a closed room the mesh would
    /// block light that the panorama already shows, so `surroundings` sets how the mesh and the panorama together
    /// model the place, by default automatically.
    pub struct PathTrace {
        /// Number of paths per pixel. With `max_error` it is the maximum number, and at least 4 paths are traced.
        samples: u32 = 256, range(1, 1_048_576), other("3"), knob(Samples, "4", "16", "64", "1024");
        /// Number of samples to leave out before the first. Renders of the moments of a shutter take different samples, so
        /// that their average has the noise of all of them: 0, 16, 32, .. with `samples: 16`. The average of a scene that
        /// does not move is then the picture with all samples, to rounding or, for `with`, to noise.
        skip_samples: u32 = 0, range(0, 1_048_576), other("4");
        /// Target standard error of each tile of 8 by 8 pixels, as a root mean square over the pixels whose error
        /// is not 0. It applies to `object`, relative to the mean of `object`, and to the ratio `with / without`
        /// where the receiver is visible. Where the ratio is certainly above 1, its error is relative to the ratio.
        /// Pixels where `without` is below a thousandth of its median are ignored. After the first 4 samples,
        /// blocks of 32 by 32 pixels take more chunks of samples until they reach the target error or the maximum
        /// `samples`. Notes report the result. `None` takes `samples` everywhere, and so does a `coarse_px` above 1.
        max_error: Option<f64> = None, range(1e-6, 1.0), other("0.5"), knob(Cutoff, "", "", "", "None");
        /// Standard error, defined as in `max_error`, at which a block of pixels takes no more samples. It saves
        /// samples where the picture is already accurate. Unlike `max_error` it is not required: a block that
        /// ends above it has `samples` samples, as without it, and nothing is degraded. The sixteenth of the pixels
        /// of a tile with the largest errors of the ratio does not count: these are single bright dots, which
        /// `Denoise` removes. `max_error` replaces it.
        /// `None` takes `samples` everywhere, and so does a `coarse_px` above 1.
        noise_threshold: Option<f64> = None, range(1e-6, 1.0), other("0.5"), knob(Cutoff, "", "", "", "None");
        /// Maximum number of bounces after the first; 0 is direct light only.
        max_bounces: u32 = 8, range(0, 64), other("0"), knob(Depth, "2", "4", "8", "32");
        /// How the receiver mesh and the panorama together model the place around the objects. `bounces` sets
        /// whether the mesh reflects light; if the panorama already shows the reflected light, that light would
        /// count twice. Reflections in objects show the panorama if its point of capture is known or the mesh lets
        /// its light pass, otherwise the mesh.
        surroundings: Surroundings = Surroundings::Auto, other("Transparent");
        /// Maximum radiance of a contribution after the first vertex of a path; 0 for no limit. Removes bright
        /// outliers of glossy reflections, and some of their light.
        clamp_indirect: f64 = 0.0, range(0.0, 1e9), other("0.01"), knob(Limit, "", "", "", "0.0");
        /// Error of the mesh, in metres, where objects rest. Camera hits on the mesh within this distance of the
        /// base of an object, or of a side that rests on a wall, are moved to it. Otherwise, a mesh that is too low
        /// would show a black gap under the object, and a mesh that is too high would hide its foot. `None`
        /// measures the roughness of the mesh at each object and leaves smooth meshes unchanged; 0 leaves any mesh
        /// unchanged.
        contact_metres: Option<f64> = None, range(0.0, 10.0), unit("m"), other("0.5");
        /// Traces only the change of the receiver, for graphs that need only the shadow. `object` is empty; depth
        /// and normals are those of the receiver.
        shadow_only: bool = false, other("true");
        /// Side, in pixels, of the square blocks into which the image is divided. One pixel of each block is
        /// traced, and its value fills the block, as in the first preview of `watch`. 1 traces every pixel.
        coarse_px: u32 = 1, range(1, 64), unit("px"), other("2");
        /// Maximum relative change of light at which a tile of 8 by 8 pixels is cropped. In a cropped tile no ray
        /// is traced for the change due to the objects, and `with` equals `without`. The change is an upper bound,
        /// not an estimate, so shadows, surfaces near bright objects and reflections off walls are kept. 0 traces
        /// everywhere.
        crop: f64 = 0.001, range(0.0, 0.1), other("0.1"), knob(Cutoff, "0.004", "0.002", "0.001", "0.0");
    }
}

engine::inputs! {
    /// Inputs of [`PathTrace`].
    pub struct In {
        /// The mesh of the captured place, with its vertex colours as albedo. It is matte unless `set-gloss` makes a part
        /// of it glossy.
        receiver: Arc<Mesh>,
        /// The inserted objects.
        objects: Vec<Arc<Placed>>,
        /// The cameras.
        rig: Arc<Rig>,
        /// The environment light.
        env: Arc<Environment>,
        /// Splats that lie on the receiver. If they are given, the pixels of `without` and `with` are not those of the
        /// camera in `rig`, but one for each splat, for `bake-shadow`.
        points: Option<Arc<Splats>>,
    }
}

engine::outputs! {
    /// Outputs of [`PathTrace`].
    pub struct Out {
        /// The receiver without objects (R0), and the environment where there is no receiver.
        without: Arc<Images>,
        /// The receiver with the objects, which are hidden from the camera (R1).
        with: Arc<Images>,
        /// The objects: linear RGB, premultiplied, and alpha.
        object: Arc<Images>,
        /// Planar depth of the front surface, object or receiver, at the centre of each pixel; +inf where there is
        /// no surface. A blended surface counts if its coverage is above one half.
        depth: Arc<Images>,
        /// Planar depth of the nearest object that is visible anywhere in the pixel, however little of it. If no object
        /// is visible there, the depth at which the ray is a tenth of the diagonal of the largest object above the
        /// receiver. Used by `splat-render(limit:)`: splats in front of it are in front of the objects and of their
        /// shadow, and splats that lie on the ground are shadowed with it.
        nearest: Arc<Images>,
        /// Unit normal of the front surface in world axes, towards the camera; 0 where there is no surface.
        normal: Arc<Images>,
        /// Variance of the mean over samples, in four channels: the luminance of `without`, of `with` and of
        /// `object`, and the ratio of luminances `with / without`. It is computed as for independent samples, which
        /// overestimates the variance of stratified samples. 0 for a single sample.
        variance: Arc<Images>,
        /// Decisions, means, standard errors and ray counts.
        report: Arc<Report>,
    }
}
