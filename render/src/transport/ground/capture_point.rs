//! Position of the point of capture of a panorama relative to the receiver.
//!
//! The given point may lie on or under the floor, either because the user gave the origin of the scene, or because
//! the mesh is inaccurate. From such a point, only back faces would be visible, and no light.

use glam::{DVec3, Vec3};
use scene::types::Camera;

use super::probe::Probe;
use crate::geometry::bvh::Ray;
use crate::transport::scene::frame::in_scene_frame;
use crate::transport::scene::receiver::Receiver;

/// Maximum depth below the ground, in metres, from which a point of capture is moved up. Errors of meshes and of
/// recorded positions are at most about this large.
const BURIED: f64 = 0.1;
/// Height above the ground, in metres, to which a point on or below the ground is moved.
const OVER: f64 = 0.01;
/// Minimum distance of a real camera from a surface, in metres.
pub const NEAREST: f64 = 0.02;
/// Maximum vertical distance to a surface, in metres, at which a point counts as lying on it.
const ON: f64 = 0.005;

/// Camera whose position is used if the point of capture is unknown: the first camera that sees mostly front faces
/// of the receiver, or else the first camera. A camera above a room without a roof sees back faces.
pub fn stand_in<'a>(receiver: &Receiver, cameras: &'a [Camera], origin: DVec3) -> &'a Camera {
    let inside =
        |camera: &&Camera| Probe::send(receiver, in_scene_frame(camera.eye(), origin)).front_share() > 0.5;
    cameras.iter().find(inside).unwrap_or(&cameras[0])
}

/// Point of capture, and the surfaces that are visible from it.
#[derive(Debug, Clone, Copy)]
pub struct CapturePoint {
    /// Position in the frame of the scene.
    pub at: Vec3,
    /// Hits of rays in all directions.
    pub probe: Probe,
}

/// A problem with a point of capture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CaptureFault {
    /// The point lay on or under a surface and was moved up by this distance, in world units.
    Raised(f32),
    /// No part of the receiver is visible from the point, but this share of the probe rays from a camera hits the
    /// receiver.
    SeesNothing(f64),
    /// This share of the visible surfaces are back faces, while a camera sees front faces.
    SeesBacks(f64),
    /// The point is nearer than [`NEAREST`] to a surface.
    TooNear,
}

/// True if at least 90 % of the hits are back faces.
fn sees_backs(probe: &Probe) -> bool {
    probe.escaped < probe.rays && probe.front_share() <= 0.1
}

impl CapturePoint {
    /// Creates a point of capture at `at`, and traces probe rays from this point.
    pub fn at(receiver: &Receiver, at: Vec3) -> Self {
        Self { at, probe: Probe::send(receiver, at) }
    }

    /// Returns the point and its problem, if there is one. If `moves` is true and the point lies on or under a
    /// surface, a point just above that surface is returned instead. `camera` is the position of a camera in the
    /// place.
    pub fn checked(
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

    /// Point just above the surface that this point lies on or under, and its height above this point. The surface
    /// may be at most [`BURIED`] above this point. `None` if there is no such surface, or if mostly back faces are
    /// visible from the new point.
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
        // From inside a room whose normals all point out, the roof would be found too; but the cameras are not
        // above it.
        let cameras = self.probe.is_open() || (at - camera).dot(up) < 0.0;
        (probe.front_share() > 0.5 && cameras).then_some((Self { at, probe }, raised))
    }

    /// True if any surface is closer than `near`.
    fn is_within(&self, receiver: &Receiver, near: f32) -> bool {
        Probe::rays(self.at).any(|ray| {
            let around = Ray { t_max: 2.0 * near, ..Ray::new(self.at - ray.direction * near, ray.direction) };
            receiver.bvh.any(around, |_| true)
        })
    }
}
