//! Conversion of a panorama to linear light, with counts of its invalid samples.

use scene::math::color::linear_from_srgb;
use scene::math::num;
use scene::types::Picture;

engine::choices! {
    /// Transfer curve from display values to linear light.
    pub enum Transfer {
        /// The sRGB curve (IEC 61966-2-1), which splat renders and photographs use.
        Srgb,
        /// A pure power of 2.4, as in the HDR fusion of the LightHarmony3D paper. Unclipped light becomes about a
        /// tenth darker than with `Srgb`.
        Gamma24,
    }
}

impl Transfer {
    /// Linear light of a display value; values below 0 give 0.
    pub fn linear(self, encoded: f32) -> f32 {
        match self {
            _ if encoded <= 0.0 => 0.0,
            Transfer::Srgb => linear_from_srgb(encoded),
            Transfer::Gamma24 => num::powf(encoded, 2.4),
        }
    }
}

/// Linear RGB of every pixel, finite and at least 0.
pub struct LinearPixels {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub rgb: Vec<[f32; 3]>,
    /// Number of samples that were NaN or infinite. They are replaced with 0.
    pub broken: u64,
    /// Number of samples below 0. They are replaced with 0.
    pub negative: u64,
    /// True if samples may be clipped at white. This is the case for display values, which end at white, and for
    /// linear light without any sample above white.
    pub ceiling: bool,
}

/// Linear light above this value exceeds white by more than noise can.
const ABOVE_WHITE: f32 = 1.05;

/// Linear light of a 3-channel picture. A linear picture is used unchanged.
pub fn linear_pixels(picture: &Picture, transfer: Transfer) -> LinearPixels {
    let (width, height, channels) = picture.size();
    let (mut broken, mut negative) = (0, 0);
    let display = matches!(picture, Picture::Srgb(_));
    let rgb: Vec<[f32; 3]> = picture
        .samples()
        .chunks_exact(channels.max(1))
        .map(|pixel| {
            std::array::from_fn(|c| {
                let sample = pixel.get(c).copied().unwrap_or(0.0);
                if !sample.is_finite() {
                    broken += 1;
                    return 0.0;
                }
                negative += u64::from(sample < 0.0);
                if display { transfer.linear(sample) } else { sample.max(0.0) }
            })
        })
        .collect();
    let ceiling = display || rgb.iter().all(|rgb| max3(*rgb) <= ABOVE_WHITE);
    LinearPixels { width, height, rgb, broken, negative, ceiling }
}

/// The largest component.
pub fn max3(rgb: [f32; 3]) -> f32 {
    rgb[0].max(rgb[1]).max(rgb[2])
}
