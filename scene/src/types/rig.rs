//! Cameras, and rigs of cameras.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};
use glam::{DMat4, DVec2, DVec3};
use serde::Serialize;

use super::lens::Lens;

/// A camera in the OpenCV convention: x right, y down, z forward; pixel (0, 0) is at the top left, and its centre is
/// at (0.5, 0.5).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Camera {
    /// Name of the view.
    pub name: String,
    /// Width of the image, in pixels.
    pub width_px: u32,
    /// Height of the image, in pixels.
    pub height_px: u32,
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels.
    pub fy: f64,
    /// Principal point, in pixels from the left edge.
    pub cx: f64,
    /// Principal point, in pixels from the top edge.
    pub cy: f64,
    /// Distortion of the lens.
    pub lens: Lens,
    /// Rigid transform from camera to world, column-major as glam stores it.
    pub world_from_camera: [f64; 16],
}

impl Camera {
    /// A camera with square pixels and a centred principal point, given its right, down and forward directions in
    /// the world.
    pub fn centred(
        name: &str,
        [width_px, height_px]: [u32; 2],
        focal_px: f64,
        [right, down, forward]: [DVec3; 3],
        eye: DVec3,
    ) -> Self {
        let world_from_camera =
            DMat4::from_cols(right.extend(0.0), down.extend(0.0), forward.extend(0.0), eye.extend(1.0));
        Self {
            name: name.to_owned(),
            width_px,
            height_px,
            fx: focal_px,
            fy: focal_px,
            cx: 0.5 * f64::from(width_px),
            cy: 0.5 * f64::from(height_px),
            lens: Lens::PINHOLE,
            world_from_camera: world_from_camera.to_cols_array(),
        }
    }

    /// Cameras for the six faces of a cube around a point: four around the axis `up`, then one along it and one
    /// against it. The axes are perpendicular unit vectors.
    pub fn cube(
        name: &str,
        side_px: u32,
        focal_px: f64,
        [right, forward, up]: [DVec3; 3],
        eye: DVec3,
    ) -> [Self; 6] {
        let faces = [
            (right, forward),
            (-forward, right),
            (-right, -forward),
            (forward, -right),
            (right, up),
            (right, -up),
        ];
        faces.map(|(x, z)| Self::centred(name, [side_px; 2], focal_px, [x, z.cross(x), z], eye))
    }

    /// The rigid transform from camera to world.
    pub fn world_from_camera(&self) -> DMat4 {
        DMat4::from_cols_array(&self.world_from_camera)
    }

    /// The rigid transform from world to camera. Its rotation is the transpose of the camera's rotation, which is
    /// its exact inverse.
    pub fn camera_from_world(&self) -> DMat4 {
        let m = self.world_from_camera();
        let r = glam::DMat3::from_mat4(m).transpose();
        let t = -(r * self.eye());
        DMat4::from_cols(r.x_axis.extend(0.0), r.y_axis.extend(0.0), r.z_axis.extend(0.0), t.extend(1.0))
    }

    /// Position of the camera, in world units.
    pub fn eye(&self) -> DVec3 {
        self.world_from_camera().w_axis.truncate()
    }

    /// The same camera without the distortion of its lens, for a view that need not agree with the picture to the
    /// pixel.
    pub fn without_distortion(&self) -> Self {
        Self { lens: Lens::PINHOLE, ..self.clone() }
    }

    /// The vector, in the frame of the camera, from its centre through the point (x, y) of the image, in pixels. Its z
    /// is 1.
    pub fn ray(&self, x: f64, y: f64) -> DVec3 {
        let at = DVec2::new((x - self.cx) / self.fx, (y - self.cy) / self.fy);
        self.lens.undistort(at).extend(1.0)
    }

    /// The point of the image, in pixels, that shows a point in the frame of the camera. `None` if the point is not in
    /// front of the camera, or is beyond the limit of the lens.
    pub fn pixel(&self, local: DVec3) -> Option<[f64; 2]> {
        let slope = local.truncate() / local.z;
        if local.z <= 0.0 || slope.length() > self.lens.limit() {
            return None;
        }
        let DVec2 { x, y } = self.lens.distort(slope);
        Some([self.fx * x + self.cx, self.fy * y + self.cy])
    }

    /// The unit vector, in world coordinates, from the camera through the point (x, y) of the image, in pixels.
    pub fn direction(&self, x: f64, y: f64) -> DVec3 {
        self.world_from_camera().transform_vector3(self.ray(x, y)).normalize()
    }
}

/// Cameras, at least one, each with a unique name.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rig {
    /// The cameras, in order.
    pub cameras: Vec<Camera>,
}

impl Rig {
    /// The first camera whose lens has distortion.
    pub fn distorted(&self) -> Option<&Camera> {
        self.cameras.iter().find(|camera| !camera.lens.is_pinhole())
    }
}

impl Artifact for Rig {
    const TYPE: &'static str = "rig";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.u64(self.cameras.len() as u64);
        for camera in &self.cameras {
            to.str(&camera.name);
            to.u32(camera.width_px);
            to.u32(camera.height_px);
            // The numbers of the lens follow, if it has distortion.
            to.f64s(&[&[camera.fx, camera.fy, camera.cx, camera.cy], &*camera.lens.numbers()].concat());
            to.f64s(&camera.world_from_camera);
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let count = from.length(192)?;
        let mut cameras = Vec::with_capacity(count);
        for _ in 0..count {
            let (name, width_px, height_px) = (from.str()?, from.u32()?, from.u32()?);
            let numbers = from.f64s()?;
            let [fx, fy, cx, cy, lens @ ..] = numbers.as_slice() else {
                return Err(Corrupt(format!("a camera has {} numbers instead of 4 or more", numbers.len())));
            };
            let (fx, fy, cx, cy, lens) = (*fx, *fy, *cx, *cy, Lens::of_numbers(lens)?);
            let world_from_camera = exactly(from.f64s()?)?;
            cameras.push(Camera { name, width_px, height_px, fx, fy, cx, cy, lens, world_from_camera });
        }
        Ok(Self { cameras })
    }

    fn bytes(&self) -> usize {
        self.cameras.len() * 352
    }

    fn size(&self) -> u64 {
        self.cameras.iter().map(|camera| u64::from(camera.width_px) * u64::from(camera.height_px)).sum()
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        let unequal = self.cameras.iter().zip(&other.cameras).filter(|(a, b)| a != b).count();
        let (count, others) = (self.cameras.len(), other.cameras.len());
        Difference::of(if count == others {
            format!("cameras that differ: {unequal} of {count}")
        } else {
            format!(
                "the numbers of cameras differ: {count} and {others}; among the first {}, {unequal} differ",
                count.min(others)
            )
        })
    }
}

pub(crate) fn exactly<const N: usize>(values: Vec<f64>) -> Result<[f64; N], Corrupt> {
    values
        .try_into()
        .map_err(|v: Vec<f64>| Corrupt(format!("a camera has {} numbers instead of {N}", v.len())))
}
