//! The point of capture of a panorama, as it lies to the receiver.
//!
//! One that was written down as the scene's origin, or that lies within the error of the mesh, may be on the floor or
//! under it, whose lower side sees no light.

use glam::{DVec3, Vec3};

use super::probe::Probe;
use crate::geometry::bvh::Ray;
use crate::render::transport::scene::frame::in_scene_frame;
use crate::render::transport::scene::receiver::Receiver;
use crate::types::Camera;

/// How far under the ground a point of capture may lie to be taken over it, in metres: the error of a mesh, or of a
/// point that was written down.
const BURIED: f64 = 0.1;
/// How far over the ground it is taken then, in metres.
const OVER: f64 = 0.01;
/// No camera is nearer to a surface, in metres.
pub(crate) const NEAREST: f64 = 0.02;
/// A point is on a surface that is nearer than this straight above or below it, in metres.
const ON: f64 = 0.005;

/// The camera that stands where a panorama of the place might have been taken: the first that sees fronts of the receiver
/// for the most part, or the first of all. One over a dolls' house without a roof sees backs.
pub(crate) fn stand_in<'a>(receiver: &Receiver, cameras: &'a [Camera], origin: DVec3) -> &'a Camera {
    let inside =
        |camera: &&Camera| Probe::send(receiver, in_scene_frame(camera.eye(), origin)).front_share() > 0.5;
    cameras.iter().find(inside).unwrap_or(&cameras[0])
}

/// A point of capture and what is seen from it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CapturePoint {
    /// Where, in the frame of the scene.
    pub(crate) at: Vec3,
    /// What rays in all directions meet.
    pub(crate) probe: Probe,
}

/// What is wrong with a point of capture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum CaptureFault {
    /// It lay on or under a surface and was moved up by this, in world units.
    Raised(f32),
    /// It sees nothing of the receiver, of which a camera sees this share of its rays.
    SeesNothing(f64),
    /// This share of the surfaces that it sees are back faces, where a camera sees front faces.
    SeesBacks(f64),
    /// It is nearer than [`NEAREST`] to a surface.
    TooNear,
}

/// Whether all but a tenth of what is met shows its back.
fn sees_backs(probe: &Probe) -> bool {
    probe.escaped < probe.rays && probe.front_share() <= 0.1
}

impl CapturePoint {
    /// A point, with what rays from it meet.
    pub(crate) fn at(receiver: &Receiver, at: Vec3) -> Self {
        Self { at, probe: Probe::send(receiver, at) }
    }

    /// The same, or where it lies on or under a surface and `moves`, the point just above that surface; and what is wrong with
    /// it. `camera` is the eye of a camera in the place.
    pub(crate) fn checked(
        self,
        (receiver, camera): (&Receiver, Vec3),
        (up, metres_per_unit): (DVec3, f64),
        moves: bool,
    ) -> (Self, Option<CaptureFault>) {
        let metre = 1.0 / metres_per_unit;
        if moves && let Some((over, raised)) = self.out_of_the_ground((receiver, camera), up, metre) {
            return (over, Some(CaptureFault::Raised(raised)));
        }
        let view = Probe::send(receiver, camera);
        let nothing = self.probe.escaped == self.probe.rays;
        let fault = if nothing && view.held_share() > 0.5 {
            Some(CaptureFault::SeesNothing(view.held_share()))
        } else if sees_backs(&self.probe) && view.front_share() > 0.5 {
            Some(CaptureFault::SeesBacks(1.0 - self.probe.front_share()))
        } else {
            self.is_within(receiver, (NEAREST * metre) as f32).then_some(CaptureFault::TooNear)
        };
        (self, fault)
    }

    /// The point right over the surface that it is on, or that lies above it by no more than [`BURIED`], and how much
    /// higher that is; none where there is no such surface, or it sees no more from there.
    fn out_of_the_ground(
        &self,
        (receiver, camera): (&Receiver, Vec3),
        up: DVec3,
        metre: f64,
    ) -> Option<(Self, f32)> {
        let (up, on) = (up.as_vec3(), (ON * metre) as f32);
        let reach = if sees_backs(&self.probe) { (BURIED * metre) as f32 } else { on };
        let way = Ray { t_max: reach + on, ..Ray::new(self.at - up * on, up) };
        let raised = receiver.bvh.closest(way, |_| true)?.t - on + (OVER * metre) as f32;
        let at = self.at + up * raised;
        let probe = Probe::send(receiver, at);
        // From within a room of which all normals point out, its roof is seen from above so, too; but not the cameras.
        let cameras = self.probe.is_open() || (at - camera).dot(up) < 0.0;
        (probe.front_share() > 0.5 && cameras).then_some((Self { at, probe }, raised))
    }

    /// Whether any surface is nearer than some distance.
    fn is_within(&self, receiver: &Receiver, near: f32) -> bool {
        Probe::rays(self.at).any(|ray| {
            let around = Ray { t_max: 2.0 * near, ..Ray::new(self.at - ray.direction * near, ray.direction) };
            receiver.bvh.any(around, |_| true)
        })
    }
}
