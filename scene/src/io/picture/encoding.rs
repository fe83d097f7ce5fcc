//! Choices that a user has for a picture in a file.

use crate::math::color::space::Space;

engine::choices! {
    /// Meaning of the sample values in a picture file.
    pub enum FileEncoding {
        /// Follows the file: its colour profile (ICC), code points (cICP) or chromaticities. Files that say nothing
        /// are sRGB if they are PNG, JPEG or TIFF of integers, and linear Rec.709 if they are OpenEXR, Radiance or TIFF of
        /// floats.
        Auto,
        /// sRGB.
        Srgb,
        /// Linear light with the primaries of Rec.709.
        Linear,
        /// Data that are not colours: a mask, a depth, a ratio.
        Data,
        /// Rec.709 video, as shown on a display of BT.1886 (gamma 2.4).
        Rec709,
        /// Display P3.
        DisplayP3,
        /// Rec.2020 video, as shown on a display of BT.1886 (gamma 2.4).
        Rec2020,
        /// Linear light with the primaries of P3 and the white of D65.
        LinearP3,
        /// Linear light with the primaries of Rec.2020.
        LinearRec2020,
        /// ACEScg: linear light with the primaries AP1.
        AcesCg,
        /// ACES2065-1: linear light with the primaries AP0.
        Aces2065,
        /// ACEScct: logarithmic, with the primaries AP1.
        AcesCct,
        /// ARRI LogC3 for exposure index 800, with ARRI Wide Gamut 3.
        LogC3,
        /// ARRI LogC4 with ARRI Wide Gamut 4.
        LogC4,
        /// Sony S-Log3 with S-Gamut3.
        SLog3,
        /// Sony S-Log3 with S-Gamut3.Cine.
        SLog3Cine,
        /// Panasonic V-Log with V-Gamut.
        VLog,
        /// DaVinci Intermediate with DaVinci Wide Gamut.
        DaVinci,
    }
}

engine::choices! {
    /// Orientation of a picture whose metadata (EXIF) say that the camera was turned.
    pub enum Orientation {
        /// Turns the picture as its metadata say, so that it is upright.
        Upright,
        /// Keeps the rows and columns of the file.
        Stored,
    }
}

impl FileEncoding {
    /// The colour space that is declared; `None` for `Auto` and `Data`.
    pub(super) fn space(self) -> Option<Space> {
        Some(match self {
            FileEncoding::Auto | FileEncoding::Data => return None,
            FileEncoding::Srgb => Space::Srgb,
            FileEncoding::Linear => Space::LinearRec709,
            FileEncoding::Rec709 => Space::Rec709,
            FileEncoding::DisplayP3 => Space::DisplayP3,
            FileEncoding::Rec2020 => Space::Rec2020,
            FileEncoding::LinearP3 => Space::LinearP3,
            FileEncoding::LinearRec2020 => Space::LinearRec2020,
            FileEncoding::AcesCg => Space::AcesCg,
            FileEncoding::Aces2065 => Space::Aces2065,
            FileEncoding::AcesCct => Space::AcesCct,
            FileEncoding::LogC3 => Space::LogC3,
            FileEncoding::LogC4 => Space::LogC4,
            FileEncoding::SLog3 => Space::SLog3,
            FileEncoding::SLog3Cine => Space::SLog3Cine,
            FileEncoding::VLog => Space::VLog,
            FileEncoding::DaVinci => Space::DaVinci,
        })
    }
}
