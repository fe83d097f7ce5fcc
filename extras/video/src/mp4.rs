//! The MP4 container of a film, by `shiguredo_mp4`: one track of AV1, with its index before the data, so that browsers
//! start before the whole file is there.

use std::num::NonZeroU32;

use shiguredo_mp4::boxes::{Av01Box, Av1cBox, SampleEntry, UnknownBox, VisualSampleEntryFields};
use shiguredo_mp4::mux::{
    Mp4FileMuxer, Mp4FileMuxerOptions, Sample as Entry, estimate_maximum_moov_box_size,
};
use shiguredo_mp4::{BoxSize, BoxType, TrackKind, Uint};

use crate::VideoError;
use crate::av1::{Encoding, Sample, description};
use crate::planes::Chroma;

/// Level index for streams without a limit of size and rate (AV1 specification, annex A).
const UNLIMITED: u8 = 31;
/// OBU type of sequence headers.
const SEQUENCE_HEADER: u8 = 1;

/// Writes a film as an MP4 file.
///
/// # Errors
/// If the first frame has no sequence header, or if the library refuses the film.
pub fn write(encoding: &Encoding, samples: &[Sample]) -> Result<Vec<u8>, VideoError> {
    let refused = |error: &dyn std::fmt::Display| VideoError::Container(error.to_string());
    let timescale = NonZeroU32::new(encoding.fps.0).ok_or_else(|| refused(&"the frame rate is 0"))?;
    let header = samples.first().and_then(|sample| sequence_header(&sample.data));
    let header = header.ok_or_else(|| refused(&"the film does not begin with a sequence header"))?;
    let options = Mp4FileMuxerOptions {
        reserved_moov_box_size: estimate_maximum_moov_box_size(&[samples.len()]),
        ..Mp4FileMuxerOptions::default()
    };
    let mut muxer = Mp4FileMuxer::with_options(options).map_err(|e| refused(&e))?;
    let mut file = muxer.initial_boxes_bytes().to_vec();
    for (index, sample) in samples.iter().enumerate() {
        let entry = Entry {
            track_kind: TrackKind::Video,
            sample_entry: (index == 0).then(|| SampleEntry::Av01(sample_entry(encoding, header))),
            keyframe: sample.is_key,
            timescale,
            duration: encoding.fps.1,
            composition_time_offset: None,
            data_offset: file.len() as u64,
            data_size: sample.data.len(),
        };
        file.extend(&sample.data);
        muxer.append_sample(&entry).map_err(|e| refused(&e))?;
    }
    let boxes = muxer.finalize().map_err(|e| refused(&e))?;
    for (offset, bytes) in boxes.offset_and_bytes_pairs() {
        let (start, end) = (offset as usize, offset as usize + bytes.len());
        if file.len() < end {
            file.resize(end, 0);
        }
        file[start..end].copy_from_slice(bytes);
    }
    Ok(file)
}

fn sample_entry(encoding: &Encoding, header: &[u8]) -> Av01Box {
    let coding = encoding.coding;
    let half = u8::from(coding.chroma == Chroma::Half);
    Av01Box {
        visual: VisualSampleEntryFields {
            data_reference_index: VisualSampleEntryFields::DEFAULT_DATA_REFERENCE_INDEX,
            width: encoding.size.0 as u16,
            height: encoding.size.1 as u16,
            horizresolution: VisualSampleEntryFields::DEFAULT_HORIZRESOLUTION,
            vertresolution: VisualSampleEntryFields::DEFAULT_VERTRESOLUTION,
            frame_count: VisualSampleEntryFields::DEFAULT_FRAME_COUNT,
            compressorname: VisualSampleEntryFields::NULL_COMPRESSORNAME,
            depth: VisualSampleEntryFields::DEFAULT_DEPTH,
        },
        av1c_box: Av1cBox {
            // Main, or High for full chroma.
            seq_profile: Uint::new(1 - half),
            seq_level_idx_0: Uint::new(UNLIMITED),
            seq_tier_0: Uint::new(0),
            high_bitdepth: Uint::new(u8::from(coding.bits > 8)),
            twelve_bit: Uint::new(0),
            monochrome: Uint::new(0),
            chroma_subsampling_x: Uint::new(half),
            chroma_subsampling_y: Uint::new(half),
            // Left, as `ChromaSamplePosition::Vertical` of the stream.
            chroma_sample_position: Uint::new(half),
            initial_presentation_delay_minus_one: None,
            config_obus: header.to_vec(),
        },
        unknown_boxes: vec![colour_box(encoding)],
    }
}

/// The box `colr` with the code points of ITU-T H.273 (ISO/IEC 14496-12, section 12.1.5).
fn colour_box(encoding: &Encoding) -> UnknownBox {
    let colours = description(encoding.coding);
    let mut payload = b"nclx".to_vec();
    payload.extend((colours.color_primaries as u16).to_be_bytes());
    payload.extend((colours.transfer_characteristics as u16).to_be_bytes());
    payload.extend((colours.matrix_coefficients as u16).to_be_bytes());
    // Limited range.
    payload.push(0);
    let size = BoxSize::U32(8 + payload.len() as u32);
    UnknownBox { box_type: BoxType::Normal(*b"colr"), box_size: size, payload }
}

/// The sequence header at the start of a key frame, with its own header and size (AV1 specification, section 5.3).
fn sequence_header(data: &[u8]) -> Option<&[u8]> {
    let first = *data.first()?;
    let (kind, has_extension, has_size) = (first >> 3 & 15, first >> 2 & 1 == 1, first >> 1 & 1 == 1);
    if kind != SEQUENCE_HEADER || !has_size {
        return None;
    }
    let start = 1 + usize::from(has_extension);
    let (mut length, mut at) = (0_usize, start);
    loop {
        let byte = *data.get(at)?;
        length |= usize::from(byte & 0x7f) << (7 * (at - start));
        at += 1;
        if byte & 0x80 == 0 {
            return data.get(..at.checked_add(length)?);
        }
        if at - start == 8 {
            return None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sequence_header_is_cut_out() {
        let data = [0x0a, 0x02, 7, 8, 0x32, 0x01, 9];
        assert_eq!(sequence_header(&data), Some(&data[..4]));
        assert_eq!(sequence_header(&[0x32, 0x01, 9]), None, "a frame");
        assert_eq!(sequence_header(&[0x0a, 0x05, 7]), None, "cut off");
        assert_eq!(sequence_header(&[0x0a, 0x80]), None, "a cut-off size");
        assert_eq!(sequence_header(&[]), None);
    }
}
