//! The tests of every kind and parameter, on the kind of this crate.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use engine::{KindEntry, Registry};
use kind_tests::Table;
use nodes::kinds::demo_scene::DemoScene;
use nodes::kinds::splat_render::SplatRender;
use video::WriteVideo;

const FIXTURE: &str = r#"Graph(
    version: 1,
    scene: (up: "+z", seed: 5),
    nodes: (
        demo: DemoScene(splats: 3000, width_px: 40, height_px: 24, truth_width_px: 32, capture: 4),
        view: SplatRender(splats: "demo.splats", rig: "demo.rig"),
        film: WriteVideo(frames: ["view.colour", "view.colour", "view.colour"], path: "film.mp4"),
    ),
)"#;

#[test]
fn the_kind_keeps_the_rules() {
    let registry = Registry::new(vec![
        KindEntry::of::<DemoScene>(),
        KindEntry::of::<SplatRender>(),
        KindEntry::of::<WriteVideo>(),
    ]);
    let folder = tempfile::tempdir().unwrap();
    let table = Table::new(registry, FIXTURE, folder.path()).only(&["write-video"]);
    assert_eq!(table.problems(), [""; 0]);
}
