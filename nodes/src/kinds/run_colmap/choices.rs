//! Choices of `run-colmap`.

engine::choices! {
    /// The pairs of photographs that are compared.
    pub enum Matching {
        /// All pairs. The time grows with the square of the number of photographs; up to some 300 it is the best choice.
        Exhaustive,
        /// Each photograph and the next ones in the order of their names, for the frames of a video.
        Sequential,
    }
}
engine::choices! {
    /// The lens model that is fitted, in the names of COLMAP.
    pub enum Lens {
        /// One focal length and one coefficient of radial distortion, which suits most cameras and phones.
        SimpleRadial,
        /// Two focal lengths, and four coefficients of distortion, for wide lenses.
        OpenCv,
        /// A fisheye lens.
        OpenCvFisheye,
        /// No distortion, for photographs that are undistorted already.
        Pinhole,
    }
}
