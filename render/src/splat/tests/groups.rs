//! Tests of groups of tiles, which are used when the lists of all tiles together need too much memory.

use super::*;

/// Splats that each cover a large part of the picture.
fn wide(count: usize) -> Splats {
    let mut splats = cloud(count, 77);
    splats.scales.iter_mut().for_each(|scale| *scale = scale.map(|s| s * 8.0));
    splats
}

const SIZE: (u32, u32) = (150, 100);

fn projected(splats: &Splats, settings: &Settings) -> Projected {
    let camera_model = Pinhole::new(&camera(SIZE.0, SIZE.1, 70.0));
    project::project(splats, None, &camera_model, (settings, None), &context(), Level::new())
        .expect("projects")
}

// This test fails if `clip` does not shift its result, if the columns of a group are not clipped, or if the strip
// of a row is looked up by its index in the group.
#[test]
fn groups_change_no_bit() {
    let splats = wide(300);
    for settings in [F64, Settings { precision: Precision::F32, bounds: Bounds::Inria, ..F64 }] {
        let all = draw(&splats, &camera(SIZE.0, SIZE.1, 70.0), settings);
        let around = PanoramaCamera { eye: DVec3::ZERO, up: engine::Up::PlusY, width_px: 144 };
        let everything = |settings| panorama(&splats, &around, None, &settings, &context()).expect("renders");
        let panorama = everything(settings);
        // A tile at a time, some columns of a row, some rows.
        for list_bytes in [0, 4000, 60_000] {
            let few = Settings { list_bytes, ..settings };
            let parts = draw(&splats, &camera(SIZE.0, SIZE.1, 70.0), few);
            assert_eq!((bits(&parts), parts.work), (bits(&all), all.work), "{list_bytes}");
            let parts = everything(few);
            assert_eq!((bits(&parts), parts.work), (bits(&panorama), panorama.work), "{list_bytes}");
        }
    }
}

// This test fails if a row that alone exceeds the limit is not divided.
#[test]
fn lists_held_together_are_bounded() {
    let splats = wide(300);
    let tiles = (10, 7);
    let mut counts = Vec::new();
    for list_bytes in [0, 4000, 60_000, 1 << 20] {
        let settings = Settings { list_bytes, ..F64 };
        let projected = projected(&splats, &settings);
        let groups = bin::groups(&projected, tiles, &settings);
        let (mut pairs, mut seen) = (0, vec![0; tiles.0 * tiles.1]);
        for group in &groups {
            let sorted = bin::sort(&projected, group, &settings, &context()).expect("sorts");
            let lists = bin::bin(&projected, &sorted, group, tiles.0, &settings, &context()).expect("bins");
            // At least one tile, which may list each splat once.
            assert!(lists.pairs() * 4 <= list_bytes.max(4 * 300), "{} at {list_bytes}", lists.pairs());
            pairs += lists.pairs();
            for tile in 0..lists.tiles() {
                let (_, column, row) = lists.tile(tile);
                seen[row * tiles.0 + column] += 1;
            }
        }
        assert!(seen.iter().all(|times| *times == 1), "{list_bytes}: {seen:?}");
        counts.push((groups.len(), pairs));
    }
    assert!(counts.iter().all(|(_, pairs)| *pairs == counts[0].1), "{counts:?}");
    assert!(counts[0].0 == 70 && counts[1].0 < 70 && counts[2].0 <= 7 && counts[3].0 == 1, "{counts:?}");
}

// The estimate of a kind follows the picture while it is small, and is bounded once the lists are held in groups.
#[test]
fn what_is_announced_is_bounded() {
    assert!(most_bytes(1000, (160, 90)) < 1_000_000);
    assert!(most_bytes(300_000, (3840, 2160)) < 200 << 20);
    assert!(most_bytes(300_000, (3840, 2160)) > settings::LIST_BYTES);
    let _ = most_bytes(u64::MAX, (1 << 19, 1 << 19));
}
