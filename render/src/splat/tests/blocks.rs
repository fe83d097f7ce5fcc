//! Tests that skipping blocks does not change a bit of the picture, and that harmonics are evaluated only if they
//! are needed.

use super::block::{BLOCK, Block, Blocks};
use super::*;

/// Splats in clumps all around the origin, one block per clump.
pub(super) fn clumps(count: usize, seed: u64, spread: f64) -> Splats {
    let mut splats = cloud(count, seed);
    let mut random = Random(seed + 1);
    for clump in splats.means.chunks_mut(BLOCK) {
        let middle = [0; 3].map(|_| random.within(-9.0, 9.0));
        for mean in clump {
            *mean = middle.map(|v| (v + random.within(-spread, spread)) as f32);
        }
    }
    splats
}

pub(super) fn turned(camera: Camera, turn: DMat3, eye: DVec3) -> Camera {
    let matrix = DMat4::from_mat3(turn) * DMat4::from_cols_array(&camera.world_from_camera);
    Camera { world_from_camera: (DMat4::from_translation(eye) * matrix).to_cols_array(), ..camera }
}

pub(super) fn draw_by_blocks(splats: &Splats, camera: &Camera, settings: Settings) -> Rendered {
    let cx = context();
    let blocks = settings.skip_unseen.then(|| Blocks::of(splats, &cx).expect("goes on"));
    render_with(splats, blocks.as_ref(), camera, None, &settings, &cx).expect("renders")
}

/// Draws the same picture with and without blocks, checks that both have the same bits, and returns the work counts
/// with blocks.
pub(super) fn both(draw: impl Fn(bool) -> Rendered) -> Work {
    let (with, without) = (draw(true), draw(false));
    assert_eq!(bits(&with), bits(&without));
    assert_eq!(without.work.skipped, 0);
    assert_eq!(with.work.skipped + with.work.visited, without.work.visited);
    assert_eq!(Work { skipped: 0, visited: without.work.visited, ..with.work }, without.work);
    with.work
}

/// Skipping blocks does not change a bit of the picture. This test fails if `* self.steepest` is removed from
/// `Pinhole::misses`, or if `size.dot(half)` is halved in `Block::most`.
#[test]
fn blocks_that_are_left_out_change_no_bit() {
    let mut random = Random(5);
    let mut skipped = 0;
    for case in 0..24_u32 {
        let mut splats = clumps(3000, u64::from(case), if case % 3 == 0 { 3.0 } else { 0.2 });
        // Some giant splats, which are visible although their centres are not.
        splats.scales.iter_mut().step_by(97).for_each(|s| *s = [random.within(0.5, 4.0) as f32, 0.1, 0.3]);
        let turn = DMat3::from_rotation_y(random.within(-3.0, 3.0))
            * DMat3::from_rotation_x(random.within(-1.5, 1.5));
        // Worlds far from their origin, whose centres have a part that f32 loses.
        let offset = if case % 2 == 0 { DVec3::ZERO } else { DVec3::new(1e6 + 0.3, -2e5, 7e3) };
        if case % 2 == 1 {
            let exact: Vec<DVec3> = (0..splats.len()).map(|i| splats.mean(i) + offset).collect();
            splats.means = exact.iter().map(|mean| mean.to_array().map(|v| v as f32)).collect();
            let low = |mean: &DVec3| mean.to_array().map(|v| (v - f64::from(v as f32)) as f32);
            splats.means_low = exact.iter().map(low).collect();
        }
        let eye = offset + DVec3::from([0; 3].map(|_| random.within(-2.0, 2.0)));
        let camera = turned(camera(48, 32, [20.0, 70.0, 150.0][case as usize % 3]), turn, eye);
        for (bounds, alpha_cut) in
            [(Bounds::Exact, 1.0 / 255.0), (Bounds::Exact, 1e-5), (Bounds::Inria, 1.0 / 255.0)]
        {
            let of =
                |skip_unseen| Settings { bounds, alpha_cut, near: 0.05, skip_unseen, ..Settings::default() };
            skipped += both(|skip| draw_by_blocks(&splats, &camera, of(skip))).skipped;
        }
        let around = PanoramaCamera { eye, up: engine::Up::PlusZ, width_px: 64 };
        skipped += both(|skip_unseen| {
            let settings = Settings { skip_unseen, ..Settings::default() };
            panorama(&splats, &around, None, &settings, &context()).expect("renders")
        })
        .skipped;
    }
    // 24 scenes of 3000 splats in six pictures each: three of a camera, two caps, and the belt, where nothing is
    // skipped.
    let visits = 24 * 3000 * 6;
    assert!(skipped * 3 > visits, "{skipped} of {visits}");
}

// With `bounds: None`, only splats behind the camera are left out.
#[test]
fn without_bounds_only_what_is_behind_is_left_out() {
    let splats = clumps(640, 9, 0.2);
    let settings = |skip_unseen| Settings { bounds: Bounds::None, skip_unseen, ..F64 };
    let work = both(|skip| draw_by_blocks(&splats, &camera(8, 8, 60.0), settings(skip)));
    let ahead = splats.means.iter().filter(|mean| mean[2] > 0.2).count() as u64;
    assert!(work.skipped > 0 && work.skipped <= 640 - ahead, "{work:?}");
}

/// The bound of a block is never below the value that it bounds, for any direction and for coordinates of any
/// magnitude.
#[test]
fn a_block_bounds_its_splats() {
    let mut random = Random(11);
    for size in [1e-6, 1.0, 1e6] {
        for count in [1, 3, 4, 63, 64] {
            let mut splats = cloud(count, 3);
            splats.means.iter_mut().flatten().for_each(|v| *v = (random.within(-1.0, 1.0) * size) as f32);
            splats.means_low =
                vec![[0.4 * f32::EPSILON * size as f32, 0.0, -0.4 * f32::EPSILON * size as f32]; count];
            let eye = DVec3::from([0; 3].map(|_| random.within(-2.0, 2.0) * size));
            let block = Block::of(&splats, 0..count).seen_from(eye);
            let longest = splats.scales.iter().flatten().fold(0.0_f32, |most, v| most.max(*v));
            assert_eq!(block.longest, f64::from(longest));
            for _ in 0..50 {
                let (along, constant) =
                    (DVec3::from([0; 3].map(|_| random.within(-1.0, 1.0))), random.within(-1.0, 1.0) * size);
                let bound = block.most(along, constant);
                for i in 0..count {
                    let value = along.dot(splats.mean(i) - eye) + constant;
                    assert!(value <= bound, "{value} {bound}");
                }
                // And it is tight: for one splat, almost exact.
                let slack = if count == 1 { 1e-6 * size } else { 6.1 * size };
                assert!(bound <= along.dot(splats.mean(0) - eye) + constant + slack);
            }
        }
    }
}

/// For a scene of degree 0, no direction and no harmonics are evaluated. Forcing the evaluation of all harmonics,
/// for a scene of any degree, does not change a bit of the picture. This test fails if the zeros in
/// `sh::colour_of_all` are replaced with 1e-3.
#[test]
fn harmonics_that_are_left_out_change_no_bit() {
    let colourful = cloud(400, 2);
    let constant = colourful.sh.iter().step_by(16).copied().collect();
    let plain = Splats { sh_degree: 0, sh: constant, ..colourful.clone() };
    for (splats, sh_degree, directed) in [(&plain, 4, false), (&colourful, 0, false), (&colourful, 2, true)] {
        let [left_out, forced] = [true, false].map(|skip_harmonics| {
            let settings = Settings { sh_degree, skip_harmonics, ..Settings::default() };
            draw(splats, &camera(40, 30, 60.0), settings)
        });
        assert!(left_out.work.projected > 50);
        assert_eq!(left_out.work.directed, if directed { left_out.work.projected } else { 0 });
        assert_eq!(forced.work.directed, forced.work.projected);
        assert!(bits(&forced) == bits(&left_out));
    }
}
