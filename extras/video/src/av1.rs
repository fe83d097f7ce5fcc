//! Encoding of segments of a film as AV1, by `rav1e`.

use rav1e::prelude::{
    CastFromPrimitive as _, ChromaSamplePosition, ChromaSampling, ColorDescription, ColorPrimaries, Config,
    Context, EncoderConfig, EncoderStatus, FrameType, MatrixCoefficients, Pixel, PixelRange, Rational,
    SceneDetectionSpeed, SpeedSettings, TransferCharacteristics,
};
use scene::io::quantise::DisplaySpace;

use crate::VideoError;
use crate::planes::{Chroma, Coding, Planes};
use crate::rate::Rate;

/// A temporal delimiter, which starts the data of each frame and is left out in MP4 (AV1 Codec ISO Media File Format
/// Binding, section 2.4).
const TEMPORAL_DELIMITER: [u8; 2] = [0x12, 0x00];
/// Largest quantizer of AV1.
const COARSEST: f64 = 255.0;

/// Settings of the encoder.
#[derive(Debug, Clone, Copy)]
pub struct Encoding {
    /// Width and height in pixels, 16 or more.
    pub size: (usize, usize),
    /// How colours are coded.
    pub coding: Coding,
    /// Frames per second, as numerator and denominator.
    pub fps: (u32, u32),
    /// Size in relation to quality.
    pub rate: Rate,
    /// Effort, from 0 (smallest file) to 10 (fastest).
    pub speed: u8,
    /// Number of frames of a segment.
    pub segment: usize,
}

/// An encoded frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    /// The data, without a temporal delimiter.
    pub data: Vec<u8>,
    /// True for a frame that does not depend on others.
    pub is_key: bool,
}

/// An encoded segment.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Its frames in order.
    pub samples: Vec<Sample>,
    /// Sum of the squared differences between the luma that is decoded and that of the frames, in codes.
    pub squared_error: f64,
}

impl Encoding {
    /// Encodes frames as a segment on the calling thread. `on_frame` is called for each frame, and returns whether to
    /// continue.
    ///
    /// # Errors
    /// If the encoder refuses the settings or fails, or if `on_frame` stopped it.
    pub fn segment(&self, frames: &[Planes], on_frame: &dyn Fn() -> bool) -> Result<Segment, VideoError> {
        if self.coding.bits == 8 {
            self.encode::<u8>(frames, on_frame)
        } else {
            self.encode::<u16>(frames, on_frame)
        }
    }

    fn encode<T: Pixel>(
        &self,
        frames: &[Planes],
        on_frame: &dyn Fn() -> bool,
    ) -> Result<Segment, VideoError> {
        let config = Config::new().with_encoder_config(self.config()).with_threads(1);
        let mut context: Context<T> =
            config.new_context().map_err(|error| VideoError::Settings(error.to_string()))?;
        let mut segment = Segment { samples: Vec::with_capacity(frames.len()), squared_error: 0.0 };
        let mut waiting = frames.iter();
        loop {
            match context.receive_packet() {
                Ok(packet) => {
                    let data = packet.data.strip_prefix(&TEMPORAL_DELIMITER).unwrap_or(&packet.data);
                    segment
                        .samples
                        .push(Sample { data: data.to_vec(), is_key: packet.frame_type == FrameType::KEY });
                    let (Some(decoded), Some(source)) = (&packet.rec, &packet.source) else {
                        return Err(VideoError::Encoder("a frame was not decoded for comparison".to_owned()));
                    };
                    segment.squared_error += self.squared_error(&decoded.planes[0], &source.planes[0]);
                    if !on_frame() {
                        return Err(VideoError::Stopped);
                    }
                }
                Err(EncoderStatus::NeedMoreData) => match waiting.next() {
                    Some(frame) => {
                        let frame = self.frame(frame, &context);
                        context.send_frame(frame).map_err(failed)?;
                    }
                    None => context.flush(),
                },
                Err(EncoderStatus::Encoded) => {}
                Err(EncoderStatus::LimitReached) => return Ok(segment),
                Err(status) => return Err(failed(status)),
            }
        }
    }

    fn config(&self) -> EncoderConfig {
        let mut speed = SpeedSettings::from_preset(self.speed);
        // Key frames are where segments begin, and nowhere else.
        speed.scene_detection_mode = SceneDetectionSpeed::None;
        let mut config = EncoderConfig {
            width: self.size.0,
            height: self.size.1,
            time_base: Rational::new(u64::from(self.fps.1), u64::from(self.fps.0)),
            bit_depth: self.coding.bits as usize,
            chroma_sampling: match self.coding.chroma {
                Chroma::Half => ChromaSampling::Cs420,
                Chroma::Full => ChromaSampling::Cs444,
            },
            chroma_sample_position: ChromaSamplePosition::Vertical,
            pixel_range: PixelRange::Limited,
            color_description: Some(description(self.coding)),
            speed_settings: speed,
            ..EncoderConfig::default()
        };
        config.set_key_frame_interval(self.segment as u64, self.segment as u64);
        match self.rate {
            Rate::Quality(quality) => {
                config.quantizer = (COARSEST * (1.0 - quality / 100.0)).round() as usize;
            }
            Rate::Mbps(rate) => config.bitrate = (rate * 1e6) as i32,
        }
        config
    }

    fn frame<T: Pixel>(&self, planes: &Planes, context: &Context<T>) -> rav1e::prelude::Frame<T> {
        let mut frame = context.new_frame();
        let chroma = match self.coding.chroma {
            Chroma::Half => self.size.0.div_ceil(2),
            Chroma::Full => self.size.0,
        };
        for (plane, (samples, width)) in
            frame.planes.iter_mut().zip(planes.samples.iter().zip([self.size.0, chroma, chroma]))
        {
            if self.coding.bits == 8 {
                let bytes: Vec<u8> = samples.iter().map(|code| *code as u8).collect();
                plane.copy_from_raw_u8(&bytes, width, 1);
            } else {
                let bytes: Vec<u8> = samples.iter().flat_map(|code| code.to_le_bytes()).collect();
                plane.copy_from_raw_u8(&bytes, 2 * width, 2);
            }
        }
        frame
    }

    fn squared_error<T: Pixel>(&self, a: &rav1e::prelude::Plane<T>, b: &rav1e::prelude::Plane<T>) -> f64 {
        let rows = a.rows_iter().zip(b.rows_iter()).take(self.size.1);
        let rows = rows.map(|(a, b)| {
            let squared = a.iter().zip(b).take(self.size.0).map(|(a, b)| {
                let [a, b]: [i64; 2] = [i32::cast_from(*a), i32::cast_from(*b)].map(i64::from);
                (a - b) * (a - b)
            });
            squared.sum::<i64>()
        });
        rows.sum::<i64>() as f64
    }
}

/// The colour space, by the code points of ITU-T H.273.
pub(crate) fn description(coding: Coding) -> ColorDescription {
    use ColorPrimaries as Primaries;
    use TransferCharacteristics as Transfer;
    let (color_primaries, transfer_characteristics, matrix_coefficients) = match coding.space {
        DisplaySpace::Srgb => (Primaries::BT709, Transfer::SRGB, MatrixCoefficients::BT709),
        DisplaySpace::DisplayP3 => (Primaries::SMPTE432, Transfer::SRGB, MatrixCoefficients::BT709),
        DisplaySpace::Rec709 => (Primaries::BT709, Transfer::BT709, MatrixCoefficients::BT709),
        DisplaySpace::Rec2020 => (Primaries::BT2020, Transfer::BT2020_10Bit, MatrixCoefficients::BT2020NCL),
    };
    ColorDescription { color_primaries, transfer_characteristics, matrix_coefficients }
}

fn failed(status: EncoderStatus) -> VideoError {
    VideoError::Encoder(status.to_string())
}
