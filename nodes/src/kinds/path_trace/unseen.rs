//! Objects that no view shows.

use engine::{Context, NodeError};
use render::transport::path::integrator::Scene;
use render::transport::picture::accumulator::FinishedView;
use render::transport::picture::camera_rays::CameraRays;
use render::transport::picture::film::{Area, TILE};
use render::transport::picture::first_hit::is_before;
use render::transport::picture::tracing::Tracing;
use scene::types::Camera;

/// Reason why no view shows an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unseen {
    /// The receiver hides the object from every camera.
    Hidden,
    /// The object is outside every view, or only its back faces are visible.
    Outside,
}

/// Reason why no view shows an object, for each object. `None` if a view shows it. Objects are assumed not to hide
/// each other, since they may be transparent.
pub(crate) fn of(tracing: &Tracing<'_>, views: &[FinishedView]) -> Result<Vec<Option<Unseen>>, NodeError> {
    let cameras = tracing.cameras.iter().map(|camera| tracing.camera_rays(camera, 1));
    let pictures: Vec<_> = cameras.zip(views).collect();
    let scene = tracing.scene();
    let count = scene.objects.placed().len();
    (0..count).map(|index| unseen(scene, &pictures, tracing.places(), index, tracing.cx)).collect()
}

/// True if a camera, which shows no object, looks at the backs of faces that are invisible from behind.
pub(crate) fn shows_backs(tracing: &Tracing<'_>, camera: &Camera) -> Result<bool, NodeError> {
    let (scene, camera_rays) = (tracing.scene(), tracing.camera_rays(camera, 1));
    let objects = scene.objects;
    for piece in Area::whole(camera).pieces(TILE) {
        tracing.cx.check()?;
        for pixel in piece.each().filter(|&pixel| camera_rays.may_show(objects, pixel)) {
            let (.., ray) = camera_rays.sample(pixel, 0);
            let back = objects.bvh.closest(ray, |hit| objects.is_hidden_back(hit));
            if back.is_some_and(|hit| is_before(&scene, &camera_rays, ray, &hit, scene.camera_hit(ray))) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// Reason why no view shows an object. `None` if a view shows it.
fn unseen(
    scene: Scene<'_>,
    pictures: &[(CameraRays<'_>, &FinishedView)],
    places: u32,
    index: usize,
    cx: &Context,
) -> Result<Option<Unseen>, NodeError> {
    let objects = scene.objects;
    let mut met = false;
    // Most objects are visible in the first sample of some pixel.
    for places in [0..1, 1..places] {
        for (camera_rays, view) in pictures {
            for piece in Area::whole(camera_rays.camera).pieces(TILE) {
                cx.check()?;
                for pixel in piece.each().filter(|&pixel| camera_rays.may_show(objects, pixel)) {
                    // If a pixel shows no object, one ray decides whether the receiver hides this object.
                    let shows = view.shows_objects_at(pixel);
                    let places = if shows || (!met && places.start == 0) { places.clone() } else { 0..0 };
                    for number in places {
                        let (.., ray) = camera_rays.sample(pixel, number);
                        let own = |triangle| objects.part(triangle).0.placed == index;
                        let hit = objects
                            .bvh
                            .closest(ray, |hit| own(hit.triangle) && objects.coverage(hit, true) > 0.0);
                        let Some(hit) = hit else { continue };
                        met = true;
                        if shows && is_before(&scene, camera_rays, ray, &hit, scene.camera_hit(ray)) {
                            return Ok(None);
                        }
                    }
                }
            }
        }
    }
    Ok(Some(if met { Unseen::Hidden } else { Unseen::Outside }))
}
