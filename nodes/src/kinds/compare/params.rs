//! Parameters of `compare`.

use engine::InputFile;
use scene::math::metrics::PIXELS_PER_DEGREE;

engine::choices! {
    /// Encoding in which pictures are compared.
    pub enum Space {
        /// Display values with the sRGB curve, clamped to the range from 0 to 1, as papers do.
        Display,
        /// Linear light, not clamped. PSNR and SSIM still assume that white is 1. FLIP is replaced by HDR-FLIP over
        /// a range of exposures computed from the reference.
        Linear,
    }
}

engine::params! {
    /// Measures the difference between a picture and a reference.
    ///
    /// Pictures of colours are compared in the table `compare`, with one row per view, picture and region. The
    /// table has these columns:
    ///
    /// - PSNR.
    /// - SSIM as in the code of 3D Gaussian splatting (`ssim_3dgs_zero_pad`), and without the border (`ssim_valid`,
    ///   only for whole pictures).
    /// - FLIP, the difference that a viewer sees when the two pictures alternate: its mean and its 95th percentile.
    /// - CIEDE2000.
    /// - LPIPS, if weights are given.
    /// - The mean absolute error and the largest error.
    /// - The relative MSE in linear light, `mean((a - b)^2 / (b^2 + 0.01))`.
    ///
    /// Pictures of data, such as a shadow ratio, are compared in the table `ratio`. In addition to PSNR and errors
    /// it has the mean of `|ln a - ln b|`, for which values below 0.001 are raised to 0.001, and the intersection
    /// over union of the two shadows (pixels below 0.98). A value that cannot be computed is missing in its row,
    /// and is never given as 0.
    ///
    /// For a region, SSIM and FLIP are the means of their maps over the region. With `Linear`, FLIP is HDR-FLIP
    /// (`hdr-flip mean` and `hdr-flip p95`); CIEDE2000 and LPIPS are not computed, which is reported. An inserted
    /// object hardly changes the numbers of a whole picture, so compare them with the numbers of two baselines:
    /// wire `background` for the row "nothing inserted", and `no_shadow` for the row "no shadow". A baseline
    /// without a wire is not computed.
    ///
    /// Alpha itself is not compared. Transparent parts are composited on black in the encoding of the picture: in
    /// display values for a splat render, which is how the metrics of splat trainers treat it, and in linear light
    /// for the output of `composite`. `Linear` composites all pictures in linear light, so that a composite without
    /// objects equals its background.
    pub struct Compare {
        /// Encoding in which to compare. Pictures of data are compared unchanged.
        space: Space = Space::Display, other("Linear");
        /// True to round display values to 8 bits before they are compared, as in papers that compare PNG files.
        quantise: bool = true, other("false");
        /// Names of the regions, in the order of the wires. They must be unique, and none may be `whole`.
        names: Vec<String> = Vec::new(), other("[\"shadow\"]"), inert("without regions there is nothing to name");
        /// Factor applied to the difference picture.
        gain: f64 = 1.0, range(0, 1e6), other("4.0");
        /// Resolution as seen by the viewer, for FLIP.
        pixels_per_degree: f64 = PIXELS_PER_DEGREE, range(1, 1000), unit("1/deg"), other("32.0");
        /// Weights of LPIPS: a safetensors file of AlexNet or VGG16 and its five heads, with the tensor names of
        /// torchvision and of the `lpips` package. The weights are not included, because of their licences.
        lpips: Option<InputFile> = None, other("\"lpips.safetensors\"");
        /// Scores that another program gave to pictures for a required text and for a forbidden text: pairs
        /// (positive, negative) of numbers of at least 0. For each pair, the table `prompt` has the share `positive
        /// / (positive + negative)`. Its last two rows have the mean of these shares, and the share computed from
        /// the sums of all positive and all negative scores. Papers differ in which of the two they report.
        scores: Vec<[f64; 2]> = Vec::new(), range(0, 1e9), other("[(0.6, 0.2)]");
        /// True to scale the input of LPIPS to the range from -1 to 1, as its networks expect. The code of 3D
        /// Gaussian splatting uses the range from 0 to 1 and prints smaller numbers.
        lpips_scaled: bool = true, other("false"), inert("without weights there is no LPIPS");
    }
}
