//! The point of capture of a panorama, as it lies to the receiver.
//!
//! One that was written down as the scene's origin, or that lies within the error of the mesh, may be on the floor or
//! under it, whose lower side sees no light.

use engine::Notes;
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
const NEAREST: f64 = 0.02;
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

/// Whether all but a tenth of what is met shows its back.
fn sees_backs(probe: &Probe) -> bool {
    probe.escaped < probe.rays && probe.front_share() <= 0.1
}

impl CapturePoint {
    /// The same, or where it `mends` the point right over a surface that it is on or under, and what is to be known of that:
    /// that it was taken higher, sees nothing or backs of surfaces alone where a camera sees fronts, or lies on one.
    pub(crate) fn checked(
        self,
        (receiver, camera): (&Receiver, Vec3),
        (up, metres_per_unit): (DVec3, f64),
        mends: bool,
        notes: &mut Notes,
    ) -> Self {
        let metre = 1.0 / metres_per_unit;
        if mends && let Some((over, raised)) = self.out_of_the_ground((receiver, camera), up, metre) {
            let millimetres = f64::from(raised) * metres_per_unit * 1e3;
            let text = "the point of capture lies on or under a surface of the receiver, of which it sees the back or \
                        nothing, so it is taken";
            let text = format!("{text} {millimetres:.0} mm higher, where it sees out");
            notes.warning("capture-under-ground", text);
            return over;
        }
        let hint = "is the place that it was captured at (`at` of `cube-rig`, or `origin`) the right one, in units of the world?";
        let view = Probe::send(receiver, camera);
        let nothing = self.probe.escaped == self.probe.rays;
        if nothing && view.held_share() > 0.5 {
            let held = 100.0 * view.held_share();
            let text = format!(
                "the point of capture sees nothing of the receiver, which is {held:.0} % of what is around a camera; {hint}"
            );
            notes.warning("capture-far-off", text);
        } else if sees_backs(&self.probe) && view.front_share() > 0.5 {
            let backs = 100.0 * (1.0 - self.probe.front_share());
            let text = format!(
                "{backs:.0} % of what the point of capture sees are backs of surfaces, of which a camera sees the fronts: \
                 it lies in a body, under the ground or outside of the room; {hint}"
            );
            notes.warning("capture-behind-surfaces", text);
        } else if self.is_within(receiver, (NEAREST * metre) as f32) {
            let text = format!(
                "the point of capture lies less than {:.0} mm off a surface of the receiver; {hint}",
                NEAREST * 1e3
            );
            notes.warning("capture-on-surface", text);
        }
        self
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
