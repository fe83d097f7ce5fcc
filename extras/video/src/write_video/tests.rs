use engine::{Scene, Up};
use scene::types::{Image, Srgb};
use shiguredo_mp4::demux::{Input, Mp4FileDemuxer};

use super::*;

const SIZE: (usize, usize) = (50, 34);

/// A disc that moves over a gradient.
fn frame(index: usize, size: (usize, usize)) -> Arc<Images> {
    let mut samples = Vec::with_capacity(3 * size.0 * size.1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let (dx, dy) = (x as f32 - 10.0 - index as f32, y as f32 - 15.0);
            let is_inside = dx * dx + dy * dy < 64.0;
            let ramp = (x + y) as f32 / (size.0 + size.1) as f32;
            samples.extend(if is_inside {
                [0.9, 0.3, 0.1]
            } else {
                [0.2 + 0.5 * ramp, 0.4, 0.6 - 0.3 * ramp]
            });
        }
    }
    Arc::new(Images::single("v", Image::<Srgb>::from_samples(size.0, size.1, 3, samples)))
}

fn film(count: usize) -> Vec<Arc<Images>> {
    (0..count).map(|index| frame(index, SIZE)).collect()
}

fn params() -> WriteVideo {
    WriteVideo {
        path: OutputFile("a.mp4".into()),
        fps: 25.0,
        rate: Rate::Quality(80.0),
        bits: 8,
        chroma: Chroma::Half,
        speed: 10,
        segment: 4,
        view: View::Standard,
        exposure: 0.0,
        space: DisplaySpace::Srgb,
    }
}

fn write(p: &WriteVideo, frames: Vec<Arc<Images>>) -> Result<(Vec<u8>, String), String> {
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    WriteVideo::check(p).map_err(|e| e.to_string())?;
    let (out, notes) =
        WriteVideo::run(p, In { frames }, &Context::detached(scene, ".")).map_err(|e| e.to_string())?;
    Ok((out.files.0[0].bytes.clone(), format!("{notes:?}")))
}

/// Time, duration and key of a frame.
type Frame = (u64, u32, bool);

/// The frames, the size of the picture and the unit of times, as a reader of MP4 sees them.
fn read(file: &[u8]) -> (Vec<Frame>, (u16, u16), u32) {
    let mut reader = Mp4FileDemuxer::new();
    while let Some(wanted) = reader.required_input() {
        let start = wanted.position as usize;
        let end = wanted.size.map_or(file.len(), |size| start + size).min(file.len());
        reader.handle_input(Input { position: wanted.position, data: &file[start..end] });
    }
    let (mut frames, mut size, mut scale) = (Vec::new(), (0, 0), 0);
    while let Some(sample) = reader.next_sample().unwrap_or_else(|e| panic!("{e}")) {
        if let Some(shiguredo_mp4::boxes::SampleEntry::Av01(entry)) = sample.sample_entry {
            size = (entry.visual.width, entry.visual.height);
            assert!(entry.unknown_boxes.iter().any(|part| part.box_type.as_bytes() == b"colr"));
            assert_eq!(entry.av1c_box.config_obus.first(), Some(&0x0a), "a sequence header");
        }
        scale = sample.track.timescale.get();
        frames.push((sample.timestamp, sample.duration, sample.keyframe));
    }
    (frames, size, scale)
}

/// Ten frames in segments of four.
#[test]
fn every_frame_is_in_the_file_at_its_time() {
    let (file, notes) = write(&params(), film(10)).unwrap_or_else(|e| panic!("{e}"));
    let (frames, size, scale) = read(&file);
    assert_eq!((size, scale), ((50, 34), 25));
    let wanted: Vec<_> = (0..10_u64).map(|i| (i, 1, i % 4 == 0)).collect();
    assert_eq!(frames, wanted);
    assert!(notes.contains("10 frames, 0.40 s"), "{notes}");
    assert_eq!(
        file,
        write(&params(), film(10)).map(|made| made.0).unwrap_or_default(),
        "the same bytes each time"
    );
    // The index comes before the data.
    let at = |name: &[u8]| file.windows(4).position(|part| part == name).unwrap_or(usize::MAX);
    assert!(at(b"moov") < at(b"mdat"));
}

/// The luma that decoders see differs from that of the frames by as much as the quality permits. This test fails if
/// planes are transposed or frames change places.
#[test]
fn quality_costs_bytes() {
    let mut last = (f64::INFINITY, 0);
    for quality in [40.0, 80.0, 96.0] {
        let p = WriteVideo { rate: Rate::Quality(quality), ..params() };
        let frames = film(6);
        let cx = testing::context();
        let planes = p.planes(&frames, "v", SIZE, &mut Notes::none(), &cx).unwrap_or_else(|e| panic!("{e}"));
        let segment = p.encoding(SIZE).segment(&planes, &|| true).unwrap_or_else(|e| panic!("{e}"));
        let bytes: usize = segment.samples.iter().map(|sample| sample.data.len()).sum();
        assert!(
            segment.squared_error < last.0 && bytes > last.1,
            "{quality}: {} {bytes}",
            segment.squared_error
        );
        last = (segment.squared_error, bytes);
    }
    let mean = last.0 / (6 * SIZE.0 * SIZE.1) as f64;
    assert!(10.0 * num::f64::log10(255.0 * 255.0 / mean) > 45.0, "{mean}");
}

#[test]
fn every_coding_is_written() {
    for (bits, chroma) in [(10, Chroma::Half), (8, Chroma::Full), (10, Chroma::Full)] {
        for space in [DisplaySpace::DisplayP3, DisplaySpace::Rec709, DisplaySpace::Rec2020] {
            let p = WriteVideo { bits, chroma, space, rate: Rate::Mbps(0.2), ..params() };
            let odd = (0..3).map(|index| frame(index, (33, 17))).collect();
            let (file, _) = write(&p, odd).unwrap_or_else(|e| panic!("{bits} {chroma:?} {space:?}: {e}"));
            assert_eq!(read(&file).0.len(), 3);
        }
    }
}

#[test]
fn mistakes_are_reported() {
    let reported = |p: &WriteVideo, frames| write(p, frames).err().unwrap_or_default();
    assert!(reported(&params(), Vec::new()).contains("no frame"));
    let mut mixed = film(2);
    mixed.push(frame(2, (48, 34)));
    assert!(reported(&params(), mixed).contains("frame 0 has 50x34 pixels, but frame 2 has 48x34"));
    assert!(reported(&params(), vec![frame(0, (15, 40))]).contains("16 pixels or more"));
    let other = WriteVideo { path: OutputFile("a.mov".into()), ..params() };
    assert!(reported(&other, film(1)).contains("`.mov`"));
    assert!(reported(&WriteVideo { bits: 9, ..params() }, film(1)).contains("8 or 10"));
    assert!(reported(&WriteVideo { rate: Rate::Quality(0.0), ..params() }, film(1)).contains("1 to 100"));
}

#[test]
fn a_stopped_film_ends() {
    let p = params();
    let planes = p
        .planes(&film(3), "v", SIZE, &mut Notes::none(), &testing::context())
        .unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(p.encoding(SIZE).segment(&planes, &|| false), Err(VideoError::Stopped));
}

#[test]
fn rates_of_television_are_exact() {
    assert_eq!(
        [24.0, 23.976, 29.97, 59.94, 12.5, 0.1, 1000.0].map(rational),
        [(24, 1), (24_000, 1001), (30_000, 1001), (60_000, 1001), (12_500, 1000), (100, 1000), (1000, 1)]
    );
}
