//! The tests of `lightharmony` for every kind and parameter, on the kinds of this crate.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use kind_tests::Table;
use lightharmony::engine::{KindEntry, Registry};
use lightharmony::nodes::kinds::demo_scene::DemoScene;
use lightharmony::nodes::kinds::splat_render::SplatRender;
use own_kinds::draw_histogram::DrawHistogram;
use own_kinds::measure_histogram::MeasureHistogram;

/// A graph with a small node of each kind. It may use other kinds, too.
const FIXTURE: &str = r#"Graph(
    version: 1,
    scene: (up: "+z", seed: 5),
    nodes: (
        demo:    DemoScene(splats: 3000, width_px: 40, height_px: 24, truth_width_px: 32, capture: 4),
        view:    SplatRender(splats: "demo.splats", rig: "demo.rig"),
        measure: MeasureHistogram(image: "view.colour"),
        drawn:   DrawHistogram(histogram: "measure"),
    ),
)"#;

#[test]
fn the_kinds_of_this_crate_keep_the_rules() {
    let registry = Registry::new(vec![
        KindEntry::of::<DemoScene>(),
        KindEntry::of::<SplatRender>(),
        KindEntry::of::<MeasureHistogram>(),
        KindEntry::of::<DrawHistogram>(),
    ]);
    let folder = tempfile::tempdir().unwrap();
    let table = Table::new(registry, FIXTURE, folder.path()).only(&["measure-histogram", "draw-histogram"]);
    assert_eq!(table.problems(), [""; 0]);
}
