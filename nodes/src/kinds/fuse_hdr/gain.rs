//! The form of the prediction.

engine::choices! {
    /// The form of the prediction that is fused.
    pub enum Gain {
        /// The gain map in floats; it has no upper limit.
        Direct,
        /// The list of exposures, as in the paper. The recovered light is limited by the white level of the darkest
        /// exposure.
        Brackets,
    }
}
