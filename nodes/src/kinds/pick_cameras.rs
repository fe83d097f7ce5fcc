//! `pick-cameras`: selects cameras of a rig.

use std::sync::Arc;

use engine::{Context, Keep, Kind, NodeError, Notes, SourceRoot, ViewCount};
use scene::types::Rig;
use scene::types::pick::{Pick, chosen, count_of};

engine::params! {
    /// Picks cameras of a rig, for example one camera for each value of an axis.
    ///
    /// With `axes: (frame: Cameras("rig"))` and `pick: [Axis("frame")]`, the nodes that read the picked camera run
    /// once for each camera of the rig. Their memory is bounded by `--memory` whatever the number of cameras, and
    /// the cache keeps the result of each camera separately. The camera file is read only once.
    pub struct PickCameras {
        /// Cameras to pick, in this order. An entry is a name, with the wildcards `*` and `?`; a range of indices
        /// from 0, such as `2..5`, or `0..400..8` for every eighth camera; or a single index. The default is all
        /// cameras.
        pick: Vec<Pick> = Vec::new(), other("[1]");
    }
}
engine::inputs! {
    /// Inputs of [`PickCameras`].
    pub struct In {
        /// The cameras.
        rig: Arc<Rig>,
    }
}
engine::outputs! {
    /// Outputs of [`PickCameras`].
    pub struct Out {
        /// The picked cameras, in the order of `pick`.
        rig: Arc<Rig>,
    }
}

impl Kind for PickCameras {
    const NAME: &'static str = "pick-cameras";
    const VERSION: u32 = 1;
    const STORE: Keep = Keep::Cheap;
    const INSTANT: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(p: &Self, _: &SourceRoot) -> ViewCount {
        match count_of(&p.pick) {
            Some(count) => ViewCount::Known(count),
            None if p.pick.is_empty() => ViewCount::As(&["rig"]),
            None => ViewCount::Unknown,
        }
    }

    fn run(p: &Self, In { rig }: In, _: &Context) -> Result<(Out, Notes), NodeError> {
        let names: Vec<String> = rig.cameras.iter().map(|camera| camera.name.clone()).collect();
        let pictures: Vec<&str> = names.iter().map(String::as_str).collect();
        let chosen = chosen(&p.pick, &names, &pictures).map_err(|error| error.at("pick"))?;
        let cameras = chosen.into_iter().map(|index| rig.cameras[index].clone()).collect();
        Ok((Out { rig: Arc::new(Rig { cameras }) }, Notes::none()))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use glam::DVec3;

    use super::*;
    use scene::types::Camera;
    use testing::context;

    fn rig() -> Arc<Rig> {
        let camera = |i: u32| {
            let axes = [DVec3::X, DVec3::NEG_Z, DVec3::Y];
            Camera::centred(&format!("shot_{i}"), [4 + i, 3], 5.0, axes, DVec3::X * f64::from(i))
        };
        Arc::new(Rig { cameras: (0..5).map(camera).collect() })
    }

    fn picked(pick: &[&str]) -> Result<Vec<String>, String> {
        let p = PickCameras { pick: pick.iter().map(|text| Pick::from(*text)).collect() };
        let run = PickCameras::run(&p, In { rig: rig() }, &context());
        run.map(|(out, _)| out.rig.cameras.iter().map(|camera| camera.name.clone()).collect())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn cameras_are_picked_by_index_name_and_range_in_the_given_order() {
        assert_eq!(picked(&["3..4"]).unwrap(), ["shot_3"]);
        assert_eq!(picked(&["shot_4", "0..4..2"]).unwrap(), ["shot_4", "shot_0", "shot_2"]);
        assert_eq!(picked(&["*_1", "1..3"]).unwrap(), ["shot_1", "shot_2"], "each once");
        assert_eq!(picked(&[]).unwrap().len(), 5);
        assert!(picked(&["5..6"]).unwrap_err().contains("picks none of the cameras (number: 5)"));
    }

    #[test]
    fn the_number_of_cameras_is_known_before_a_run_where_it_can_be() {
        let views = |pick: &[&str]| {
            let pick = pick.iter().map(|text| Pick::from(*text)).collect();
            PickCameras::views(&PickCameras { pick }, &SourceRoot::new("."))
        };
        assert_eq!(views(&["7..8"]), ViewCount::Known(1));
        assert_eq!(views(&["7..8", "2..3"]), ViewCount::Known(2));
        assert_eq!(views(&[]), ViewCount::As(&["rig"]));
        for unknown in [&["7..8", "7..8"][..], &["0..9"], &["shot_*"], &["shot_1"]] {
            assert_eq!(views(unknown), ViewCount::Unknown, "{unknown:?}");
        }
    }
}
