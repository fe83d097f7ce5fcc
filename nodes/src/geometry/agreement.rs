//! Checks whether the splats and the mesh of a place agree, by their depths in a rendered view.

/// Id of the finding that the splats and the mesh are in different frames.
pub const ELSEWHERE: &str = "mesh-elsewhere";

/// The depths of one view. All lists have one number per pixel.
#[derive(Debug, Clone, Copy)]
pub struct Depths<'a> {
    /// Planar depth of the splats, in world units; +inf where there are no splats.
    pub splats: &'a [f32],
    /// Coverage of the splats, 0 to 1.
    pub coverage: &'a [f32],
    /// Planar depth of the nearest surface of an object or the mesh, in world units; +inf where there is no
    /// surface.
    pub surface: &'a [f32],
    /// Coverage of the inserted objects, 0 to 1.
    pub objects: &'a [f32],
}

/// Counts of pixels of a view.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Agreement {
    /// Number of pixels that objects cover.
    pub objects: u64,
    /// Number of object pixels at which solid splats are in front of the object.
    pub before_objects: u64,
    /// Number of pixels with solid splats and without an object.
    pub solid: u64,
    /// Number of pixels counted in `solid` that also show the mesh.
    pub both: u64,
    /// Number of pixels counted in `both` at which the depths agree.
    pub agree: u64,
    /// Median ratio of the depth of the mesh to the depth of the splats, over the pixels counted in `both`; 1 if
    /// there are none.
    pub ratio: f64,
}

/// Minimum coverage of a pixel whose splats count as solid.
const SOLID: f32 = 0.9;
/// Minimum coverage of a pixel at which an object counts as visible.
const DRAWN: f32 = 0.5;
/// Ratio of the depth of the splats to the depth of an object below which the splats count as in front of the
/// object. It is less than 1 because an object touches the ground that it stands on.
const BEFORE: f32 = 0.85;
/// Largest absolute value of the logarithm of the ratio of two depths that agree. A proxy mesh may be off by a
/// tenth.
const AGREE: f64 = 0.2;
/// Splats in front of an object are reported if they cover at least this share of its pixels. A smaller share is
/// normal, because splats are wider than the mesh that they agree with: along the edge of a post in front of an
/// object, they covered 11 % of the object.
const SHARE_BEFORE: f64 = 0.2;
/// If the depths agree at less than this share of the pixels, the splats and the mesh are in different frames.
const SHARE_AGREE: f64 = 0.1;
/// If the mesh is visible at less than this share of the pixels with solid splats, it counts as not visible.
const SHARE_BOTH: f64 = 0.01;
/// Minimum number of pixels for a finding.
const PIXELS: u64 = 40;

impl Agreement {
    /// Compares the depths and counts pixels.
    pub fn of(depths: &Depths<'_>) -> Self {
        let mut found = Self { ratio: 1.0, ..Self::default() };
        let mut logs = Vec::new();
        let mesh = depths.surface.iter().zip(depths.objects);
        let splats = depths.splats.iter().zip(depths.coverage);
        for ((&splat, &coverage), (&surface, &object)) in splats.zip(mesh) {
            let solid = coverage >= SOLID && splat.is_finite() && splat > 0.0;
            if object >= DRAWN && surface.is_finite() {
                found.objects += 1;
                found.before_objects += u64::from(solid && splat < BEFORE * surface);
            } else if object <= 0.0 && solid {
                found.solid += 1;
                if surface.is_finite() && surface > 0.0 {
                    found.both += 1;
                    let log = crate::math::num::f64::ln(f64::from(surface) / f64::from(splat));
                    found.agree += u64::from(log.abs() <= AGREE);
                    logs.push(log);
                }
            }
        }
        if !logs.is_empty() {
            let middle = logs.len() / 2;
            found.ratio = crate::math::num::f64::exp(*logs.select_nth_unstable_by(middle, f64::total_cmp).1);
        }
        found
    }

    /// Findings that follow from the counts, each as an id and a text.
    pub fn findings(&self) -> Vec<(&'static str, String)> {
        let share = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
        let mut list = Vec::new();
        let (known, seen) = (share(self.both, self.solid), share(self.agree, self.both));
        if self.solid >= PIXELS && known < SHARE_BOTH {
            let text = "the mesh of the place is not visible where the splats are: check that both have the same origin, \
                        unit and up axis; if not, transform one of them by `matrix` of `LoadMesh` or `LoadSplats`";
            list.push((ELSEWHERE, text.to_owned()));
        } else if self.both >= PIXELS && seen < SHARE_AGREE {
            let text = format!(
                "the depths of the mesh of the place and of the splats differ at {:.0} % of the pixels that show both \
                 (median ratio {:.3}): they have different units, up axes or origins; transform one of them by `matrix` \
                 of `LoadMesh` or `LoadSplats`",
                100.0 * (1.0 - seen),
                self.ratio
            );
            list.push((ELSEWHERE, text));
        }
        let before = share(self.before_objects, self.objects);
        if list.is_empty() && self.objects >= PIXELS && before >= SHARE_BEFORE {
            let text = format!(
                "splats are in front of the object at {:.0} % of its pixels, but the object is drawn over them, because \
                 the mesh of the place has no surface there. To draw these splats over the object, wire \
                 `path-trace.nearest` to `limit` of a second `SplatRender`, and its picture to `front` of `Composite`",
                100.0 * before
            );
            list.push(("splats-before-object", text));
        }
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = 100;

    fn ids(change: impl Fn(usize) -> [f32; 4]) -> Vec<&'static str> {
        let rows: Vec<[f32; 4]> = (0..N * N).map(change).collect();
        let column = |at: usize| rows.iter().map(|row| row[at]).collect::<Vec<f32>>();
        let [splats, coverage, surface, objects] = [0, 1, 2, 3].map(column);
        let depths = Depths { splats: &splats, coverage: &coverage, surface: &surface, objects: &objects };
        Agreement::of(&depths).findings().into_iter().map(|(id, _)| id).collect()
    }

    /// Depth, at pixel `i`, of a scene that consists of a floor and a wall.
    fn place(i: usize) -> f32 {
        2.0 + (i % N) as f32 * 0.03 + (i / N) as f32 * 0.05
    }

    fn is_object(i: usize) -> bool {
        (40..60).contains(&(i % N)) && (40..60).contains(&(i / N))
    }

    /// Values of pixel `i` if everything agrees: depth and coverage of the splats, depth of the surface, coverage
    /// of the objects.
    fn right(i: usize) -> [f32; 4] {
        if is_object(i) {
            [place(i), 1.0, place(i) * 0.9, 1.0]
        } else {
            [place(i), 1.0, place(i) * 1.03, 0.0]
        }
    }

    /// This test fails if `splat < BEFORE * surface` is replaced by `splat > BEFORE * surface`.
    #[test]
    fn a_place_that_agrees_raises_no_alarm() {
        assert_eq!(ids(right), [""; 0]);
        // If the receiver is a plane, furniture is in front of it, and many pixels show no mesh.
        assert_eq!(ids(|i| if i % 3 == 0 { right(i) } else { [1.0, 1.0, f32::INFINITY, 0.0] }), [""; 0]);
        assert_eq!(
            ids(|i| if i % 4 == 0 { right(i) } else { [0.7 * place(i), 1.0, place(i), 0.0] }),
            [""; 0]
        );
        // Haze before the object.
        assert_eq!(ids(|i| if is_object(i) { [0.5, 0.4, place(i), 1.0] } else { right(i) }), [""; 0]);
        // No splats, no mesh.
        assert_eq!(ids(|i| [f32::INFINITY, 0.0, place(i), 0.0]), [""; 0]);
    }

    #[test]
    fn other_frames_and_missing_posts_are_found() {
        for scale in [0.01, 0.1, 0.5, 2.0, 100.0] {
            assert_eq!(ids(|i| [place(i), 1.0, place(i) * scale, 0.0]), ["mesh-elsewhere"], "{scale}");
        }
        assert_eq!(ids(|i| [place(i), 1.0, f32::INFINITY, 0.0]), ["mesh-elsewhere"]);
        let post = |i: usize| is_object(i) && i % N < 46;
        assert_eq!(
            ids(|i| if post(i) { [1.0, 1.0, place(i), 1.0] } else { right(i) }),
            ["splats-before-object"]
        );
    }
}
