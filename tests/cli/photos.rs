//! Tests of the training of splats from photographs.

use crate::Place;

const TRAIN: &str = r#"Graph(
    version: 1,
    scene: (up: "+z", seed: 7),
    nodes: (
        demo:   DemoScene(capture: 12, capture_width_px: 48, splats: 3000, width_px: 48, height_px: 32, truth_width_px: 16),
        shots:  SplatRender(splats: "demo.splats", rig: "demo.capture"),
        photos: LoadPhotos(rig: "demo.capture", image: "shots.colour"),
        train:  TrainSplats(photos: "photos", iterations: 1000, max_splats: 500, start_splats: 300, sh_degree: 1),
        view:   SplatRender(splats: "train.splats", rig: "demo.rig"),
        save:   WriteExr(layers: ["view.colour"], path: "view.exr"),
        report: WriteReport(report: "train.report", path: "training.md"),
    ),
)
"#;

/// A training continues from the stored states of a shorter training, whose splats were also scored and written, and
/// gives the bytes of a training without them. This test fails if a state leaves out the moments of Adam.
#[test]
fn a_longer_training_continues_a_shorter_one() {
    let short = Place::new(TRAIN);
    let log = short.run(&[]).good();
    assert_eq!((log.parts("train", "ran").len(), log.parts("train", "cached").len()), (1, 0));
    let longer = ["--set", "train.iterations=1100"];
    let log = short.run(&longer).good();
    assert_eq!((log.parts("train", "ran").len(), log.parts("train", "cached").len()), (1, 1));
    let whole = Place::new(TRAIN);
    let log = whole.run(&longer).good();
    assert_eq!((log.parts("train", "ran").len(), log.parts("train", "cached").len()), (2, 0));
    assert_eq!(short.outputs(), whole.outputs());
    // Later nodes do not train again.
    let log = short.run(&["--set", "train.iterations=1100", "--set", "view.sort=Distance"]).good();
    assert!(!log.nodes("ran").contains(&"train"));
}
