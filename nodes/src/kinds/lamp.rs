//! `lamp`: a lamp at a pose.

use std::f64::consts::PI;
use std::sync::Arc;

use engine::{Context, ContextField, Keep, Kind, NodeError, Notes};
use glam::{DMat3, DMat4, DVec3};
use scene::math::color::luminance;
use scene::math::num;
use scene::types::frame::world_from_gltf;
use scene::types::{Material, Object, Placed, Pose, Primitive};

engine::choices! {
    /// Shape of a lamp.
    pub enum LampShape {
        /// A round disc that shines to one side.
        Disc,
        /// A sphere that shines to all sides.
        Sphere,
        /// A rectangle that shines to one side.
        Panel,
    }
}

engine::params! {
    /// Makes a lamp at a pose, which lights the objects and the place.
    ///
    /// Wire it to `objects` of `path-trace`, next to the other objects. Its light is the same in every direction
    /// (Lambertian), and it is visible in the picture; the housing of a disc or a panel is black. The origin of the
    /// pose is the middle of the shining face, or of the sphere. A disc or a panel shines down, or towards `target`.
    /// The scale of the pose makes a lamp larger.
    pub struct Lamp {
        /// Shape of the lamp.
        shape: LampShape = LampShape::Disc, other("Panel");
        /// Radius of a disc or a sphere.
        radius_metres: f64 = 0.15, range(1e-4, 1000.0), unit("m"), other("0.3");
        /// Size of a panel, along the right and the forward axis of the pose.
        panel_metres: [f64; 2] = [0.6, 0.6], range(1e-4, 1000.0), unit("m"), other("(0.3, 1.2)"), inert("a disc is not a panel");
        /// World point that a disc or a panel faces. `None` faces down.
        target: Option<[f64; 3]> = None, range(-1e12, 1e12), unit("world units"), other("(1.0, 2.0, 0.0)");
        /// Luminance of the shining surface, where 1 is the white of the picture at EV 0.
        radiance: f64 = 10.0, range(0.0, 1e9), other("20.0");
        /// Luminous flux of the whole lamp. Replaces `radiance`, which then follows from the area of the lamp and
        /// from `white_nits`.
        lumens: Option<f64> = None, range(0.0, 1e12), unit("lm"), other("Some(800.0)");
        /// Luminance that the value 1 of the picture stands for, in candela per square metre. A capture does not
        /// state it; white paper in a lit room has about 100, and outdoors 3,000 (overcast) to 30,000 (sun). Used
        /// only with `lumens`.
        white_nits: f64 = 100.0, range(1e-6, 1e9), unit("cd/m2"), other("200.0"), inert("there are no lumens");
        /// Colour of the light, in linear Rec.709. Only the ratios of its components matter.
        colour: [f64; 3] = [1.0, 1.0, 1.0], range(0.0, 1e6), other("(1.0, 0.7, 0.4)");
    }
}
engine::inputs! {
    /// Inputs of [`Lamp`].
    pub struct In {
        /// Position of the lamp, and its rotation.
        pose: Arc<Pose>,
    }
}
engine::outputs! {
    /// Outputs of [`Lamp`].
    pub struct Out {
        /// The lamp as an object, for `objects` of `path-trace`.
        placed: Arc<Placed>,
    }
}

/// Number of corners of a disc. The area of the polygon is 0.04 % below that of the circle, which is taken into
/// account.
const CORNERS: u32 = 128;
/// Number of rings of a sphere from pole to pole.
const RINGS: u32 = 48;
/// Depth of the housing, as a share of the size of the lamp.
const DEPTH: f64 = 0.02;

impl Kind for Lamp {
    const NAME: &'static str = "lamp";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    const INSTANT: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if luminance(p.colour.map(|v| v as f32)) <= 0.0 {
            return Err(NodeError::new("the lamp has no colour: all components of `colour` are 0")
                .at("colour")
                .hint(
                    "the colour of white light is (1.0, 1.0, 1.0); `radiance: 0.0` switches the lamp off",
                ));
        }
        if p.shape == LampShape::Sphere && p.target.is_some() {
            return Err(NodeError::new("a sphere shines to all sides and has no `target`")
                .at("target")
                .hint("use `shape: Disc`, or remove `target`"));
        }
        Ok(())
    }

    fn run(p: &Self, In { pose }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(p)?;
        let metres = cx.metres_per_unit();
        let world_from_object = p.world_from_lamp(&pose, world_from_gltf(cx.up(), metres))?;
        let front = p.front();
        let area = area(&front, &world_from_object) * metres * metres;
        if !area.is_finite() || area <= 0.0 {
            return Err(NodeError::new("the pose is not finite or flattens the lamp").at("pose"));
        }
        // A Lambertian surface of luminance L and area A sheds pi L A lumens.
        let level = match p.lumens {
            Some(lumens) => lumens / (PI * area * p.white_nits),
            None => p.radiance,
        };
        let by = level / f64::from(luminance(p.colour.map(|v| v as f32)));
        let emissive = p.colour.map(|v| (v * by) as f32);
        if !emissive.iter().all(|v| v.is_finite()) {
            return Err(NodeError::new("the light of the lamp overflows").at("lumens"));
        }
        let material = |name: &str, emissive| Material {
            name: name.to_owned(),
            base_colour: [0.0, 0.0, 0.0, 1.0],
            metallic: 0.0,
            ior: 1.0,
            emissive,
            double_sided: true,
            ..Material::default()
        };
        let mut primitives = vec![front];
        primitives.extend(p.housing());
        let materials = vec![material("light", emissive), material("housing", [0.0; 3])];
        let object = Object { primitives, materials, textures: Vec::new() };
        let mut notes = Notes::none();
        let flux = PI * area * level * p.white_nits;
        let text = format!(
            "the lamp has {area:.4} m2 of luminance {level:.4}, which is {flux:.1} lumens if white is {} cd/m2",
            p.white_nits
        );
        notes.decision("lamp", text);
        Ok((Out { placed: Arc::new(Placed { object: Arc::new(object), world_from_object }) }, notes))
    }
}

impl Lamp {
    /// Transform from the frame of the lamp (metres, y up, the front facing -y) to the world.
    fn world_from_lamp(&self, pose: &Pose, world_from_gltf: DMat4) -> Result<DMat4, NodeError> {
        let world = pose.world_from_local * world_from_gltf;
        let Some(target) = self.target else { return Ok(world) };
        let wrong = || {
            NodeError::new("`target` is at the lamp itself")
                .at("target")
                .hint("the target is a point of the world that the lamp faces")
        };
        let towards = (DVec3::from_array(target) - pose.translation()).try_normalize().ok_or_else(wrong)?;
        let axes = DMat3::from_mat4(world);
        // The lamp keeps its right axis as far as it can, and its size along each axis.
        let up = -towards;
        let [x, z] = [axes.x_axis, axes.z_axis];
        let right = [x, z].map(|axis| axis - up * axis.dot(up));
        let right = right.into_iter().find(|axis| axis.length() > 1e-6 * x.length()).ok_or_else(wrong)?;
        let right = right.normalize();
        let size = [x, axes.y_axis, z].map(DVec3::length);
        let columns = DMat3::from_cols(right * size[0], up * size[1], right.cross(up) * size[2]);
        Ok(DMat4::from_mat3_translation(columns, pose.translation()))
    }

    /// The corners of the outline of a disc or a panel in the plane y, counter-clockwise seen from above.
    fn outline(&self, y: f64) -> Vec<[f32; 3]> {
        let corners: Vec<[f64; 2]> = match self.shape {
            LampShape::Panel => {
                let [x, z] = self.panel_metres.map(|side| 0.5 * side);
                vec![[x, z], [x, -z], [-x, -z], [-x, z]]
            }
            _ => {
                let corner = |i: u32| {
                    let (sin, cos) = num::sin_cos(2.0 * PI * f64::from(i) / f64::from(CORNERS));
                    [self.radius_metres * cos, -self.radius_metres * sin]
                };
                (0..CORNERS).map(corner).collect()
            }
        };
        corners.into_iter().map(|[x, z]| [x as f32, y as f32, z as f32]).collect()
    }

    /// The surface that shines.
    fn front(&self) -> Primitive {
        if self.shape == LampShape::Sphere {
            return sphere(self.radius_metres);
        }
        let positions = self.outline(0.0);
        let corners = positions.len() as u32;
        // Clockwise from above, so that the front faces down.
        let triangles = (2..corners).map(|i| [0, i, i - 1]).collect();
        Primitive { positions, triangles, ..Primitive::default() }
    }

    /// The black back and rim of a disc or a panel; `None` for a sphere.
    fn housing(&self) -> Option<Primitive> {
        let size = match self.shape {
            LampShape::Sphere => return None,
            LampShape::Disc => self.radius_metres,
            LampShape::Panel => self.panel_metres[0].min(self.panel_metres[1]),
        };
        let mut positions = self.outline(0.0);
        let corners = positions.len() as u32;
        positions.extend(self.outline(DEPTH * size));
        let mut triangles: Vec<[u32; 3]> =
            (2..corners).map(|i| [corners, corners + i - 1, corners + i]).collect();
        for i in 0..corners {
            let next = (i + 1) % corners;
            triangles.push([i, next, corners + next]);
            triangles.push([i, corners + next, corners + i]);
        }
        Some(Primitive { positions, triangles, material: 1, ..Primitive::default() })
    }
}

/// A sphere of the given radius, as rings from pole to pole.
fn sphere(radius: f64) -> Primitive {
    let columns = 2 * RINGS;
    let mut positions = Vec::new();
    for ring in 0..=RINGS {
        let (sin, cos) = num::sin_cos(PI * f64::from(ring) / f64::from(RINGS));
        for column in 0..columns {
            let (z, x) = num::sin_cos(2.0 * PI * f64::from(column) / f64::from(columns));
            positions.push([sin * x, cos, sin * z].map(|v| (radius * v) as f32));
        }
    }
    let mut triangles = Vec::new();
    for ring in 0..RINGS {
        for column in 0..columns {
            let next = (column + 1) % columns;
            let [a, b, c, d] = [
                ring * columns + column,
                ring * columns + next,
                (ring + 1) * columns + column,
                (ring + 1) * columns + next,
            ];
            if ring > 0 {
                triangles.push([a, b, d]);
            }
            if ring + 1 < RINGS {
                triangles.push([a, d, c]);
            }
        }
    }
    Primitive { positions, triangles, ..Primitive::default() }
}

/// Area of a surface in the world, in square world units.
fn area(surface: &Primitive, world_from_object: &DMat4) -> f64 {
    let corner = |at: u32| {
        let position = surface.positions[at as usize].map(f64::from);
        world_from_object.transform_point3(DVec3::from_array(position))
    };
    let triangle = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(corner);
        0.5 * (b - a).cross(c - a).length()
    };
    surface.triangles.iter().map(triangle).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};

    fn lamp(shape: LampShape) -> Lamp {
        Lamp { shape, ..Lamp::default() }
    }

    fn placed(p: &Lamp, pose: DMat4, metres_per_unit: f64) -> Placed {
        let cx = Context::detached(Scene { up: Up::PlusZ, metres_per_unit, seed: 0, exhaustive: false }, ".");
        let inputs = In { pose: Arc::new(Pose { world_from_local: pose }) };
        let (out, _) = Lamp::run(p, inputs, &cx).unwrap_or_else(|e| panic!("{e}"));
        Arc::unwrap_or_clone(out.placed)
    }

    /// Lumens of a lamp: pi times luminance times area, summed over its triangles in the world.
    fn lumens(placed: &Placed, metres: f64, white: f64) -> f64 {
        let front = &placed.object.primitives[0];
        let light = placed.object.materials[front.material as usize].emissive;
        let area = area(front, &placed.world_from_object) * metres * metres;
        PI * area * white * f64::from(luminance(light))
    }

    /// The flux does not depend on shape, size, colour, the unit of the world or the scale of the pose. This test
    /// fails if the area is taken in the frame of the lamp, or if the colour is not divided by its luminance.
    #[test]
    fn lamps_of_all_shapes_shed_their_lumens() {
        for shape in [LampShape::Disc, LampShape::Sphere, LampShape::Panel] {
            for (metres, scale, colour) in [(1.0, 1.0, [1.0; 3]), (0.25, 3.0, [1.0, 0.4, 0.1])] {
                let p = Lamp { lumens: Some(806.0), white_nits: 130.0, colour, ..lamp(shape) };
                let found = placed(&p, DMat4::from_scale(DVec3::splat(scale)), metres);
                let sum = lumens(&found, metres, 130.0);
                assert!((sum / 806.0 - 1.0).abs() < 1e-5, "{shape:?}, {metres}, {scale}: {sum}");
            }
        }
    }

    /// Areas are those of the shapes, and sides face outwards: the front of a disc and a panel down, a sphere away
    /// from its middle, housings away from the lamp.
    #[test]
    fn shapes_are_closed_and_face_outwards() {
        for (shape, wanted) in [
            (LampShape::Disc, PI * 0.15 * 0.15),
            (LampShape::Sphere, 4.0 * PI * 0.15 * 0.15),
            (LampShape::Panel, 0.36),
        ] {
            let found = placed(&lamp(shape), DMat4::IDENTITY, 1.0);
            let front = area(&found.object.primitives[0], &found.world_from_object);
            assert!((front / wanted - 1.0).abs() < 2e-3, "{shape:?}: {front}, not {wanted}");
            // The volume by the divergence theorem is positive if all sides face outwards.
            let mut volume = 0.0;
            let mut edges = std::collections::BTreeMap::new();
            for part in &found.object.primitives {
                let corner = |at: u32| part.positions[at as usize];
                for triangle in &part.triangles {
                    let [a, b, c] = triangle.map(|at| DVec3::from_array(corner(at).map(f64::from)));
                    volume += a.dot(b.cross(c)) / 6.0;
                    for [from, to] in [[0, 1], [1, 2], [2, 0]] {
                        // The corners at the poles of a sphere differ by rounding.
                        let place = |k: usize| corner(triangle[k]).map(|v| (v * 1e6).round() as i64);
                        let [from, to] = [from, to].map(place);
                        *edges.entry(if from < to { (from, to) } else { (to, from) }).or_insert(0) +=
                            if from < to { 1 } else { -1 };
                    }
                }
            }
            assert!(volume > 0.0, "{shape:?}: {volume}");
            assert!(edges.values().all(|sum| *sum == 0), "{shape:?} is open");
            if shape != LampShape::Sphere {
                let front = &found.object.primitives[0];
                let [a, b, c] = front.triangles[0]
                    .map(|at| DVec3::from_array(front.positions[at as usize].map(f64::from)));
                assert!((b - a).cross(c - a).y < 0.0, "{shape:?} faces up");
            }
        }
    }

    /// The front faces the target, also straight up and down, and the lamp keeps its size.
    #[test]
    fn lamps_face_their_target() {
        let eye = DVec3::new(1.0, 2.0, 3.0);
        for target in [[4.0, -1.0, 0.0], [1.0, 2.0, 9.0], [1.0, 2.0, -9.0], [5.0, 2.0, 3.0]] {
            let p = Lamp { target: Some(target), ..lamp(LampShape::Panel) };
            let pose = DMat4::from_translation(eye) * DMat4::from_rotation_z(0.7);
            let m = placed(&p, pose, 0.5).world_from_object;
            let towards = (DVec3::from_array(target) - eye).normalize();
            assert!(m.transform_vector3(-DVec3::Y).normalize().dot(towards) > 1.0 - 1e-12);
            assert!((m.determinant() - 8.0).abs() < 1e-9, "{target:?}: {}", m.determinant());
            assert_eq!(m.transform_point3(DVec3::ZERO), eye);
        }
        let p = Lamp { target: Some(eye.to_array()), ..lamp(LampShape::Disc) };
        let pose = Arc::new(Pose { world_from_local: DMat4::from_translation(eye) });
        let error = Lamp::run(&p, In { pose }, &testing::context()).err().expect("no direction");
        assert!(error.message().contains("at the lamp itself"), "{error}");
    }

    #[test]
    fn lamps_that_make_no_sense_are_refused() {
        assert!(Lamp::check(&Lamp { colour: [0.0; 3], ..lamp(LampShape::Disc) }).is_err());
        assert!(Lamp::check(&Lamp { target: Some([0.0; 3]), ..lamp(LampShape::Sphere) }).is_err());
        assert!(Lamp::check(&lamp(LampShape::Sphere)).is_ok());
        let flat = Arc::new(Pose { world_from_local: DMat4::from_scale(DVec3::new(0.0, 1.0, 1.0)) });
        let flat = Lamp::run(&lamp(LampShape::Disc), In { pose: flat }, &testing::context());
        assert!(flat.is_err());
    }
}
