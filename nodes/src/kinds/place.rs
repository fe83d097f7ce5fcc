//! `place`: puts an object at a pose.

use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes};
use scene::types::frame::world_from_gltf;
use scene::types::{Object, Placed, Pose};

engine::params! {
    /// Places an object at a pose.
    ///
    /// The coordinates of objects follow glTF: y is up, and the unit is the metre. They are converted to the up
    /// axis and the unit of the world, which `up` and `metres_per_unit` of the scene define.
    pub struct Place {}
}
engine::inputs! {
    /// Object and pose.
    pub struct In {
        /// The object.
        object: Arc<Object>,
        /// Pose at which the object is placed.
        pose: Arc<Pose>,
    }
}
engine::outputs! {
    /// Outputs of [`Place`].
    pub struct Out {
        /// The object and its transform to the world.
        placed: Arc<Placed>,
    }
}

impl Kind for Place {
    const NAME: &'static str = "place";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(_p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let metres = cx.metres_per_unit();
        let world_from_object = inputs.pose.world_from_local * world_from_gltf(cx.up(), metres);
        if !world_from_object.is_finite() {
            return Err(NodeError::new("the object's transform overflows")
                .at("pose")
                .hint("check the scale of the pose and `metres_per_unit`"));
        }
        let placed = Placed { object: inputs.object, world_from_object };
        Ok((Out { placed: Arc::new(placed) }, Notes::none()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, DVec3};

    // The published transform of bench-case: z up, yaw of -20.05 degrees.
    #[test]
    fn agrees_with_the_bench_case() {
        let (c, s) = (0.939_372_718_334_198, -0.342_897_713_184_356_7);
        let local = DMat4::from_cols_array(&[
            c, s, 0.0, 0.0, -s, c, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.4, 0.3, 0.0, 1.0,
        ]);
        let inputs = In { object: Arc::default(), pose: Arc::new(Pose { world_from_local: local }) };
        let cx = testing::context();
        let (out, _) = Place::run(&Place {}, inputs, &cx).unwrap_or_else(|e| panic!("{e}"));
        let m = out.placed.world_from_object;
        assert_eq!(m.transform_point3(DVec3::ZERO), DVec3::new(0.4, 0.3, 0.0));
        assert_eq!(m.transform_vector3(DVec3::Z), DVec3::new(s, -c, 0.0));
        assert_eq!(m.transform_vector3(DVec3::Y), DVec3::Z);
    }
}
