//! Parameters of `train-splats`.

engine::params! {
    /// Trains Gaussian splats from posed photographs, on the CPU, with the same result on every machine.
    ///
    /// The method is that of 3D Gaussian splatting (Kerbl et al. 2023): photographs are compared with renders in L1
    /// and D-SSIM, and Adam moves the splats that were visible. Splats that fade are moved, and new ones are added
    /// until there are `max_splats`, as in 3DGS-MCMC (Kheradmand et al. 2024). The renderer is that of
    /// `splat-render` with default parameters. Where a photograph clips to white, it only sets a minimum for the
    /// splats. Iterations are stored in ranges, so an interrupted training continues, and a training with more
    /// iterations continues one with fewer. All learning rates depend on the number of the iteration, not on
    /// `iterations`.
    pub struct TrainSplats {
        /// Number of iterations. Each renders one photograph.
        iterations: u32 = 7000, range(1, 1000000), other("3");
        /// Maximum number of splats.
        max_splats: u32 = 200000, range(1, 20000000), other("60");
        /// Maximum number of initial splats; ignored if `splats` is connected. One splat is placed at each point of
        /// the photographs. If there are more points than this, they are thinned to this number. If there are no
        /// points, this number of splats is placed at random positions around the cameras. The number is at most
        /// `max_splats`.
        start_splats: u32 = 50000, range(1, 20000000), other("120");
        /// Degree of the spherical harmonics.
        sh_degree: u32 = 3, range(0, 3), other("1");
        /// Number of iterations after which the degree in use rises by 1, beginning with 0.
        sh_every: u32 = 1000, range(1, 1000000), other("2");
        /// Number of iterations in which the learning rate of positions falls to 1 % of its initial value. Later it
        /// is constant.
        decay_iterations: u32 = 15000, range(1, 1000000), other("4");
        /// Number of iterations after which splats are no longer moved to other splats or added.
        grow_iterations: u32 = 12000, range(0, 1000000), other("600"), inert("splats are first added after 500 iterations");
        /// True to fit a factor on each colour channel of each photograph, for exposure and white balance that
        /// vary.
        exposure: bool = false, other("true");
        /// True to fit a colour behind all splats. The report states it; a render of the splats has black there.
        background: bool = false, other("true");
        /// True to compensate the opacity of small splats for the low-pass filter (Mip-Splatting). The splats carry
        /// a mark, so that `splat-render` compensates as well.
        antialiased: bool = false, other("true");
        /// Every photograph with an index divisible by this number, in the order of the cameras, is held out and
        /// only scored. 0 trains with all photographs, which leaves nothing to score.
        test_every: u32 = 8, range(0, 1000000), other("3");
    }
}
