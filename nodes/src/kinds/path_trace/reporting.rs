//! Notes about inputs and results.

use engine::Notes;
use glam::Vec3;
use render::geometry::bvh::Ray;
use render::geometry::support::GroundPlane;
use render::transport::ground::capture_point::{CaptureFault, NEAREST};
use render::transport::ground::embedded::Embedded;
use render::transport::ground::limits::LARGEST;
use render::transport::ground::side::Unsupported;
use render::transport::ground::standing::Standing;
use render::transport::path::visibility::Rules;
use render::transport::picture::accumulator::FinishedView;
use render::transport::picture::accumulator::{ReachedError, TargetError};
use render::transport::picture::film::FIRST;
use render::transport::picture::holes::holes;
use render::transport::picture::prepared::PreparedScene;
use render::transport::scene::aabb::Aabb;
use render::transport::scene::block::Block;
use render::transport::scene::face::margin;
use render::transport::scene::frame::in_scene_frame;
use render::transport::scene::media;
use render::transport::scene::objects::Objects;
use render::transport::scene::receiver::Receiver;
use scene::types::{Camera, Image, Linear, Mesh};

use super::interface::PathTrace;
use super::scale::{short, why_not_seen};
use super::unseen::Unseen;

/// Ray offset, as a share of the size of an object, above which a warning is given.
const COARSE: f32 = 1.0 / 512.0;

/// Maximum share of an object's height that may be below the ground without a warning. A greater depth is unlikely
/// to be intended.
const DEEP: f64 = 0.2;

/// Reports parts of the inputs that were ignored, changed or assumed.
pub(crate) fn report_inputs(mesh: &Mesh, prepared: &PreparedScene<'_>, objects: &Objects, notes: &mut Notes) {
    if mesh.colours.is_empty() && !mesh.triangles.is_empty() {
        notes.decision("grey-receiver", "the receiver mesh has no vertex colours, so its albedo is 0.5");
    }
    let receiver = prepared.receiver();
    let counts = [
        ("clamped-albedo", receiver.clamped, "of the vertex colours had to be clamped to the range 0 to 1"),
        (
            "raised-albedo",
            receiver.raised,
            "of the vertex colours had a channel below 0.01, which was raised to 0.01",
        ),
        (
            "receiver-not-finite",
            receiver.bvh.broken,
            "of the receiver triangles had a position that is not finite and had to be ignored",
        ),
        (
            "receiver-degenerate",
            receiver.bvh.degenerate,
            "of the receiver triangles had no area and had to be ignored",
        ),
        (
            "object-not-finite",
            objects.bvh.broken,
            "of the object triangles had a position that is not finite and had to be ignored",
        ),
        (
            "object-degenerate",
            objects.bvh.degenerate,
            "of the object triangles had no area and had to be ignored",
        ),
        (
            "dark-texels",
            prepared.sky().broken,
            "of the samples of the environment had a negative or non-finite value, which counts as 0",
        ),
    ];
    for (id, n, text) in counts {
        if n > 0 {
            notes.count(id, n, text);
        }
    }
    if let Some(deepest) = objects.nested_too_deep() {
        let text = format!(
            "{deepest} transparent bodies are nested, but a path tracks only the innermost {}",
            media::MOST
        );
        notes.warning(
            "nested-bodies",
            format!("{text}; light that leaves the inner bodies may treat the outer bodies as air; reduce the nesting"),
        );
    }
}

/// Warns of objects whose bounding box cannot be seen from the point of capture, because the panorama does
/// not show the light at their position.
pub(crate) fn report_unseen_places(receiver: &Receiver, eye: Vec3, boxes: &[Aabb], notes: &mut Notes) {
    let hidden = |one: &Aabb| {
        !one.is_empty()
            && (0..27).all(|i| {
                let share = [i % 3, i / 3 % 3, i / 9].map(|k| [0.05, 0.5, 0.95][k]);
                let way = one.low + (one.high - one.low) * Vec3::from_array(share) - eye;
                // Meshes may occlude their own surface.
                let reach = 0.95 * way.length();
                receiver.bvh.any(Ray { t_max: reach, ..Ray::new(eye, way.normalize_or_zero()) }, |_| true)
            })
    };
    let found = boxes.iter().enumerate().filter(|(_, one)| hidden(one));
    let found: Vec<String> = found.map(|(index, _)| index.to_string()).collect();
    if !found.is_empty() {
        let word = if found.len() == 1 { "object" } else { "objects" };
        let text = format!(
            "{word} {} cannot be seen from the point of capture, so the panorama does not show the light there",
            found.join(", ")
        );
        notes.warning("capture-elsewhere", format!("{text}; capture the panorama near the {word}"));
    }
}

/// Reports problems of the point of capture.
pub(crate) fn report_capture(fault: Option<CaptureFault>, metres_per_unit: f64, notes: &mut Notes) {
    let hint = "check that `origin` (or `at` of `cube-rig`) is the point where the panorama was captured, in world units";
    match fault {
        None => {}
        Some(CaptureFault::Raised(raised)) => {
            let millimetres = f64::from(raised) * metres_per_unit * 1e3;
            let text = "the point of capture lies on or under the mesh, where only back faces or no surfaces would be \
                        visible; it was moved up by";
            notes.warning("capture-under-ground", format!("{text} {millimetres:.0} mm"));
        }
        Some(CaptureFault::SeesNothing(held)) => {
            let text = "no part of the mesh is visible from the point of capture, although the mesh surrounds a camera";
            let held = format!("{:.0} % of the rays from the camera hit the mesh", 100.0 * held);
            notes.warning("capture-far-off", format!("{text} ({held}); {hint}"));
        }
        Some(CaptureFault::SeesBacks(backs)) => {
            let text = "of the surfaces visible from the point of capture are back faces, so the point is inside an object, under \
                        the ground or outside the room";
            notes.warning("capture-behind-surfaces", format!("{:.0} % {text}; {hint}", 100.0 * backs));
        }
        Some(CaptureFault::TooNear) => {
            let text = format!("the point of capture is less than {:.0} mm from the mesh", NEAREST * 1e3);
            notes.warning("capture-on-surface", format!("{text}; {hint}"));
        }
    }
}

/// Reports problems of the images.
pub(crate) fn report_views(
    params: &PathTrace,
    cameras: &[Camera],
    prepared: &PreparedScene<'_>,
    rules: &Rules,
    (views, boxes, backs): (&[FinishedView], &[Aabb], &[bool]),
    notes: &mut Notes,
) {
    let most = params.most();
    let broken: u64 = views.iter().map(|view| view.broken).sum();
    if broken > 0 {
        notes.warning("not-finite", format!("samples that were not finite count as black (count: {broken})"));
    }
    report_variance(most, views.iter().map(|view| view.beyond).sum(), notes);
    // A coarse preview may miss small objects.
    let looks = params.coarse_px == 1 && !params.shadow_only;
    for ((camera, view), backs) in cameras.iter().zip(views).zip(backs) {
        if let Some(reached) = &view.reached {
            report_plan(&camera.name, reached, most, notes);
        }
        report_cropped(&camera.name, view.cropped, notes);
        report_cut_paths(&camera.name, view.cut, params.max_bounces, notes);
        report_backs(&camera.name, view.behind, notes);
        if looks && view.shows_objects() {
            let found = holes(&view.depth);
            let share = 100.0 * found as f64 / view.depth.samples.len().max(1) as f64;
            let text = format!(
                "of the pixels of `{}` ({share:.1} %) showed a hole in the receiver mesh",
                camera.name
            );
            notes.count("holes", found, format_args!("{text}, where no shadow can fall"));
        }
        report_darkness(view, &camera.name, prepared.sky().power, rules, notes);
        if !boxes.is_empty() && looks && !view.shows_objects() {
            let eye = in_scene_frame(camera.eye(), prepared.origin);
            notes.warning("objects-not-seen", why_not_seen(&camera.name, eye, boxes, *backs));
        }
    }
}

/// Warns of an image that is all black, with the reason.
fn report_darkness(view: &FinishedView, name: &str, power: [f64; 3], rules: &Rules, notes: &mut Notes) {
    let black = |image: &Image<Linear>| {
        image.samples.chunks_exact(image.channels).all(|pixel| pixel[..3].iter().all(|v| *v == 0.0))
    };
    if view.images.iter().all(black) {
        let why = match rules.block {
            _ if power == [0.0; 3] => "the environment is black",
            Block::Solid if rules.near.is_none() => {
                "the mesh blocks all light of the environment; `surroundings: Room` lets it into a closed mesh, \
                             and `Projected` makes the mesh emit it"
            }
            _ => "no light of the environment reaches the surfaces in view",
        };
        notes.warning("no-light", format!("the image of `{name}` is black: {why}"));
    }
}

/// Warns of objects that are too far from the first camera for single precision, which loses shadows and details
/// that are smaller than the ray offset.
pub(crate) fn report_coarse_coordinates(prepared: &PreparedScene<'_>, objects: &Objects, notes: &mut Notes) {
    for (index, Aabb { low, high }) in objects.boxes().into_iter().enumerate() {
        let (size, distance) = ((high - low).max_element(), ((low + high) * 0.5).length());
        let around = prepared.receiver().margin_within(low - size, high + size);
        let margin = around.max(margin(&[low, high, high]));
        if size > 0.0 && margin > COARSE * size {
            let [size, distance, margin] = [size, distance, margin].map(short);
            let text = format!(
                "object {index} ({size} units across) is {distance} units from the first camera, so single precision loses contact \
                 shadows and detail below {margin} units"
            );
            notes.warning("coarse-coordinates", format!("{text}; move the first camera of the rig closer"));
        }
    }
}

/// Reports how the objects stand, and which of them have no receiver below them.
pub(crate) fn report_standing(
    standing: &Standing,
    (metres_per_unit, contact_metres): (f64, Option<f64>),
    notes: &mut Notes,
) {
    let Standing { ground, sides, carried, tall, unsupported, embedded } = standing;
    report_contact(ground, carried, tall, (metres_per_unit, contact_metres), notes);
    for why in [Unsupported::OverNothing, Unsupported::Buried] {
        report_unsupported(
            (0..unsupported.len()).filter(|index| unsupported[*index] == Some(why)),
            why,
            notes,
        );
    }
    report_sides(sides.iter().map(|sides| &sides[..]), metres_per_unit, notes);
    report_embedded(embedded, metres_per_unit, notes);
}

/// Warns of objects partly embedded in a surface that they do not stand on.
fn report_embedded(embedded: &[Option<Embedded>], metres_per_unit: f64, notes: &mut Notes) {
    for (index, embedded) in embedded.iter().enumerate() {
        let Some(Embedded { share, depth }) = *embedded else { continue };
        let millimetres = (f64::from(depth) * metres_per_unit * 1e3).ceil();
        let text = format!(
            "object {index} is partly embedded in the receiver mesh, which hides {:.0} % of its side facing the first camera",
            100.0 * share
        );
        notes.warning("in-a-surface", format!("{text}; move the object out by {millimetres:.0} mm"));
    }
}

/// Reports how far the mesh is from the bases of the objects on it, and warns of objects that float above the mesh
/// or reach into it. `tall` contains the heights of the objects in world units. Offsets within `contact_metres` are
/// not reported.
fn report_contact(
    measured: &[Option<GroundPlane>],
    carried: &[bool],
    tall: &[f64],
    (metres_per_unit, contact_metres): (f64, Option<f64>),
    notes: &mut Notes,
) {
    // Rounded to a tenth, without negative zero.
    let millimetres = |v: f64| (v * metres_per_unit * 1e4).round() / 10.0 + 0.0;
    let mut on_it = Vec::new();
    for (index, level) in measured.iter().enumerate() {
        let Some(GroundPlane { height, roughness, .. }) = *level else { continue };
        if height.abs() * metres_per_unit <= contact_metres.unwrap_or(0.0).max(LARGEST) {
            let (offset, roughness) = (millimetres(height), millimetres(roughness));
            on_it.push(format!(
                "a roughness of {roughness:.1} mm and an offset of {offset:+.1} mm from the base of object {index}"
            ));
        } else if !carried[index] {
            report_off_the_ground(index, height, tall[index], millimetres(height.abs()), notes);
        }
    }
    if !on_it.is_empty() && contact_metres.is_none() {
        let text = on_it.join(", ");
        notes.decision("contact", format!("the receiver mesh has {text} (positive: into the object)"));
    }
}

/// Reports objects that rest on the receiver by a side other than the foot.
fn report_sides<'a>(sides: impl Iterator<Item = &'a [GroundPlane]>, metres_per_unit: f64, notes: &mut Notes) {
    let millimetres = |v: f64| (v * metres_per_unit * 1e4).round() / 10.0 + 0.0;
    let named: Vec<String> = sides
        .enumerate()
        .flat_map(|(index, sides)| sides.iter().map(move |level| (index, level)))
        .map(|(index, level)| {
            let (rough, over) = (millimetres(level.roughness), millimetres(level.height));
            format!(
                "a roughness of {rough:.1} mm and an offset of {over:+.1} mm from the side of object {index} that rests on it"
            )
        })
        .collect();
    if !named.is_empty() {
        let text = named.join(", ");
        notes.decision("contact-side", format!("the receiver mesh has {text} (positive: into the object)"));
    }
}

/// Warns of objects without any receiver below them.
fn report_unsupported(objects: impl Iterator<Item = usize>, why: Unsupported, notes: &mut Notes) {
    let named: Vec<String> = objects.map(|index| index.to_string()).collect();
    if named.is_empty() {
        return;
    }
    let one = named.len() == 1;
    let (word, stand, lie) = if one { ("object", "stands", "lies") } else { ("objects", "stand", "lie") };
    let named = named.join(", ");
    match why {
        Unsupported::OverNothing => {
            let text = format!("{word} {named} {stand} over a hole or beyond the edge of the receiver mesh");
            let hint = "close the hole in the mesh, or move the object";
            notes.warning("no-ground", format!("{text}, where no shadow can fall; {hint}"));
        }
        Unsupported::Buried => {
            let text = format!("{word} {named} {lie} wholly or partly below the ground");
            notes
                .warning("under-the-ground", format!("{text}; `snap` moves objects near the ground onto it"));
        }
    }
}

/// Warns of an object whose base is far from the ground.
fn report_off_the_ground(index: usize, ground: f64, tall: f64, millimetres: f64, notes: &mut Notes) {
    if ground > 0.0 && ground < tall {
        let text = format!("object {index} reaches {millimetres:.0} mm into the receiver mesh");
        let text = format!("{text}; `snap` moves the object onto the mesh");
        if ground > DEEP * tall {
            notes.warning("in-the-ground", text);
        } else {
            notes.decision("in-the-ground", text);
        }
        return;
    }
    let side = if ground > 0.0 { "below" } else { "above" };
    let text =
        format!("object {index} is {millimetres:.0} mm {side} the receiver mesh, so its shadow is detached");
    let hint = "use `snap`, or set `contact_metres` to the error of the mesh";
    notes.warning("off-the-ground", format!("{text}; {hint}"));
}

/// Warns where `variance` is unavailable or out of range.
fn report_variance(samples: u32, beyond: u64, notes: &mut Notes) {
    if samples == 1 {
        let text = "variance needs at least 2 samples per pixel; with 1, `variance` is 0, no standard errors are computed and \
                    `denoise` does nothing; raise `samples`";
        notes.warning("no-variance", text);
    }
    if beyond > 0 {
        let text = "values of `variance` were clamped to the range of single precision";
        let hint = "scale the environment to a radiance closer to 1";
        notes.warning("variance-range", format!("{text} (count: {beyond}); {hint}"));
    }
}

/// Reports that `max_error` needs more samples than `samples`.
pub(crate) fn report_first_samples(samples: u32, most: u32, notes: &mut Notes) {
    if most > samples {
        let text = format!(
            "`samples` is {samples}, but {most} samples are taken, since `max_error` estimates the error from the first {most}"
        );
        notes.decision("first-samples", text);
    }
}

/// Reports the number of samples that were taken to reach the target error, and the error that was reached.
pub(crate) fn report_plan(view: &str, reached: &ReachedError, most: u32, notes: &mut Notes) {
    let ReachedError { asked, worst, blocks: [all, more, short], samples, .. } = *reached;
    let TargetError { error: asked, required } = asked;
    let name = if required { "max_error" } else { "noise_threshold" };
    let text = format!(
        "`{view}`: {more} of {all} blocks of pixels took more samples than the first {FIRST}; the average is {samples:.1} samples per pixel"
    );
    notes.decision("sample-plan", format!("{text}; the largest error is {worst:.4} (`{name}` {asked})"));
    if short > 0 && required {
        let text = format!(
            "`{view}`: after {most} samples per pixel, the standard error is above {asked} in {short} of {all} blocks of \
             pixels; the largest error is {worst:.4}"
        );
        // Errors fall with the square root of the samples.
        let ratio = worst / asked;
        let mut hint = match round_up(f64::from(most) * ratio * ratio) {
            needed if needed <= MOST_SAMPLES => format!("set `samples` to about {needed}"),
            _ => "the target error needs more samples than the maximum of `samples`".to_owned(),
        };
        if worst <= LARGEST_ERROR {
            hint.push_str(&format!("; alternatively, set `max_error` to {worst:.2e}"));
        }
        notes.degraded("error-not-reached", format!("{text}; {hint}"));
    }
}

/// Maximum of the range of `max_error`.
const LARGEST_ERROR: f64 = 1.0;
/// Maximum of the range of `samples`.
const MOST_SAMPLES: u64 = 1 << 20;

/// Rounds up a number of samples to two significant digits.
fn round_up(samples: f64) -> u64 {
    let samples = samples.ceil() as u64;
    let mut step = 1_u64;
    while samples / step >= 100 {
        step *= 10;
    }
    samples.div_ceil(step).saturating_mul(step)
}

/// Warns of paths that `max_bounces` ended too early.
fn report_cut_paths(view: &str, share: f64, max_bounces: u32, notes: &mut Notes) {
    if share > 0.01 {
        let text = format!(
            "`{view}`: `max_bounces` = {max_bounces} ends {:.0} % of the paths through objects while they still carry most of their \
             light, so stacked glass, facing mirrors and bright cavities are too dark",
            100.0 * share
        );
        notes.warning("paths-cut", format!("{text}; raise `max_bounces`"));
    }
}

/// Warns of objects that are dark since the camera looks through the backs of their faces.
fn report_backs(view: &str, share: f64, notes: &mut Notes) {
    if share > 0.01 {
        let text = format!(
            "`{view}`: {:.0} % of the samples of objects are dark and lie behind faces that are invisible from behind, since \
             their material is single-sided; the object may be inside out",
            100.0 * share
        );
        let hint = "reverse its faces in the program that made it, or make the material double-sided";
        notes.warning("faces-from-behind", format!("{text}; {hint}"));
    }
}

/// Reports objects that no view shows.
pub(crate) fn report_unseen(unseen: &[Option<Unseen>], notes: &mut Notes) {
    let of = |wanted: Unseen| {
        let found = unseen.iter().enumerate().filter(move |(_, one)| **one == Some(wanted));
        found.map(|(index, _)| index.to_string()).collect::<Vec<_>>()
    };
    let (hidden, outside) = (of(Unseen::Hidden), of(Unseen::Outside));
    let named = |indices: &[String]| {
        let word = if indices.len() == 1 { "object" } else { "objects" };
        format!("{word} {}", indices.join(", "))
    };
    if !hidden.is_empty() {
        let text = format!("the receiver mesh hides {} from every camera", named(&hidden));
        notes.warning(
            "object-hidden",
            format!("{text}; check for a position behind a wall or below the ground (`snap` moves objects onto the mesh)"),
        );
    }
    if !outside.is_empty() {
        let text = format!("no view shows {}", named(&outside));
        notes.decision("object-outside", format!("{text}; shadows and reflected light are still traced"));
    }
}

/// Formats a share as a percentage.
fn percent(share: f64) -> String {
    if share < 0.01 { "less than 1 %".to_owned() } else { format!("{:.0} %", 100.0 * share) }
}

/// Reports the share of the chunks of samples in which the change due to objects was not traced.
fn report_cropped(view: &str, (share, bound): (f64, f64), notes: &mut Notes) {
    if share > 0.0 {
        let text = format!(
            "`{view}`: the change due to objects was not traced in {1} of the chunks of samples, where it is at most {0:.2} % of the light",
            100.0 * bound,
            percent(share)
        );
        notes.decision("cropped", format!("{text}; `crop: 0` traces everywhere"));
    }
}
